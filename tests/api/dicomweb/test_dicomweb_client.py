"""An independent client (dicomweb-client) against the real application on a loopback port: every kind of object."""

import io

import numpy as np
import pydicom
import pytest
from PIL import Image
from pydicom.encaps import generate_frames

PIXELS = ("PixelData", "FloatPixelData", "DoubleFloatPixelData")
EXPLICIT = "1.2.840.10008.1.2.1"
MEDIA_TYPES = {"1.2.840.10008.1.2.5": "image/dicom-rle", "1.2.840.10008.1.2.4.80": "image/jls"}


def pixel_keyword(dataset):
    """The keyword of the pixel data; None where there is none."""
    return next((keyword for keyword in PIXELS if keyword in dataset), None)


def images(case):
    return {name: d for name, d in case.datasets.items() if pixel_keyword(d)}


def frames_of(dataset):
    array = dataset.pixel_array
    return array if int(dataset.get("NumberOfFrames", 1)) > 1 or array.ndim == 3 else array[None]


def same_attributes(got, dataset):
    for element in dataset:
        if element.keyword not in PIXELS:
            assert got[element.tag] == element, element


def read_frame(content, dataset):
    """A frame as it is sent uncompressed."""
    if dataset.BitsAllocated == 1:
        bits = np.unpackbits(np.frombuffer(content, np.uint8), bitorder="little")
        return bits[: dataset.Rows * dataset.Columns].reshape(dataset.Rows, dataset.Columns)
    kind = "<f4" if "FloatPixelData" in dataset else f"<u{dataset.BitsAllocated // 8}"
    return np.frombuffer(content, kind).reshape(dataset.Rows, dataset.Columns)


def test_search_at_three_levels(web, full_case):
    (study,) = web.search_for_studies(search_filters={"StudyInstanceUID": full_case.study})
    assert study["00201208"]["Value"] == [len(full_case.datasets)]
    assert set(study["00080061"]["Value"]) == {d.Modality for d in full_case.datasets.values()}
    series = web.search_for_series(full_case.study)
    expected = {str(d.SeriesInstanceUID) for d in full_case.datasets.values()}
    assert {s["0020000E"]["Value"][0] for s in series} == expected
    assert sum(s["00201209"]["Value"][0] for s in series) == len(full_case.datasets)
    instances = web.search_for_instances(full_case.study)
    assert {i["00080018"]["Value"][0] for i in instances} == {
        str(d.SOPInstanceUID) for d in full_case.datasets.values()
    }
    assert web.search_for_studies(search_filters={"PatientID": "nobody"}) == []


def test_get_remaining_ends(web, full_case):
    assert len(web.search_for_instances(full_case.study, get_remaining=True, limit=7)) == len(full_case.datasets)


def test_metadata_are_the_attributes_of_the_file(web, full_case):
    for name, dataset in full_case.datasets.items():
        model = web.retrieve_instance_metadata(*full_case.uids(name))
        same_attributes(pydicom.Dataset.from_json(model, lambda *_: b""), dataset)
        assert model["00083002"]["Value"] == [dataset.file_meta.TransferSyntaxUID]
        keyword = pixel_keyword(dataset)
        if keyword:
            tag = f"{dataset[keyword].tag:08X}"
            assert model[tag]["BulkDataURI"].endswith(f"{full_case.uids(name)[2]}/bulkdata/{tag}")
    assert len(web.retrieve_study_metadata(full_case.study)) == len(full_case.datasets)
    study, series, _ = full_case.uids("projections/0001.dcm")
    assert len(web.retrieve_series_metadata(study, series)) == 5


@pytest.mark.parametrize("syntax", ["*", EXPLICIT])
def test_retrieve_instances(web, full_case, syntax):
    for name, dataset in full_case.datasets.items():
        got = web.retrieve_instance(*full_case.uids(name), media_types=(("application/dicom", syntax),))
        assert got.file_meta.TransferSyntaxUID == (dataset.file_meta.TransferSyntaxUID if syntax == "*" else syntax)
        same_attributes(got, dataset)
        if pixel_keyword(dataset):
            assert np.array_equal(got.pixel_array, dataset.pixel_array), name


def test_retrieve_series_and_study(web, full_case):
    study, series, _ = full_case.uids("projections/0001.dcm")
    got = web.retrieve_series(study, series)
    assert [int(d.InstanceNumber) for d in got] == [1, 2, 3, 4, 5]
    got = web.retrieve_study(study)
    assert {d.SOPInstanceUID for d in got} == {d.SOPInstanceUID for d in full_case.datasets.values()}


@pytest.mark.parametrize("media_types", [None, ("application/octet-stream",)])
def test_frames_uncompressed(web, full_case, media_types):
    for name, dataset in images(full_case).items():
        expected = frames_of(dataset)
        numbers = [1] if len(expected) == 1 else [len(expected), 1, 2]
        got = web.retrieve_instance_frames(*full_case.uids(name), numbers, media_types=media_types)
        for number, content in zip(numbers, got, strict=True):
            assert np.array_equal(read_frame(content, dataset), expected[number - 1]), (name, number)


def test_frames_as_stored(web, full_case):
    compressed = 0
    for name, dataset in images(full_case).items():
        syntax = dataset.file_meta.TransferSyntaxUID
        if syntax not in MEDIA_TYPES:
            continue
        compressed += 1
        count = int(dataset.get("NumberOfFrames", 1))
        stored = list(generate_frames(dataset.PixelData, number_of_frames=count))
        numbers = [1] if count == 1 else [2, 1]
        got = web.retrieve_instance_frames(
            *full_case.uids(name), numbers, media_types=((MEDIA_TYPES[syntax], str(syntax)),)
        )
        assert got == [stored[number - 1] for number in numbers], name
    assert compressed > 0  # labels are always compressed


def test_bulk_data_by_its_address(web, full_case):
    for name, dataset in images(full_case).items():
        keyword = pixel_keyword(dataset)
        model = web.retrieve_instance_metadata(*full_case.uids(name))
        address = model[f"{dataset[keyword].tag:08X}"]["BulkDataURI"]
        (content,) = web.retrieve_bulkdata(address, media_types=("application/octet-stream",))
        if dataset.file_meta.TransferSyntaxUID == EXPLICIT:
            assert content == dataset[keyword].value
        else:
            expected = frames_of(dataset).tobytes()
            assert content == expected + b"\0" * (len(expected) % 2)


def test_rendered(web, full_case):
    for name, dataset in images(full_case).items():
        content = web.retrieve_instance_rendered(*full_case.uids(name), media_types=("image/png",))
        image = Image.open(io.BytesIO(content))
        assert (image.format, image.mode, image.size) == ("PNG", "L", (dataset.Columns, dataset.Rows))
        content = web.retrieve_instance_frames_rendered(*full_case.uids(name), [1], media_types=("image/jpeg",))
        assert Image.open(io.BytesIO(content)).format == "JPEG"
