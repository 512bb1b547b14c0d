"""An independent client (dicomweb-client) against the real application on a loopback port."""

import io

import numpy as np
import pydicom
import pytest
from PIL import Image

VOLUME = "tomosynthesis.dcm"
LABELS = "labels.dcm"


def test_search_at_three_levels(web, case):
    (study,) = web.search_for_studies()
    assert study["0020000D"]["Value"] == [case.study]
    assert study["00201208"]["Value"] == [len(case.datasets)]
    series = web.search_for_series(case.study)
    assert {s["0020000E"]["Value"][0] for s in series} == {str(d.SeriesInstanceUID) for d in case.datasets.values()}
    assert sum(s["00201209"]["Value"][0] for s in series) == len(case.datasets)
    instances = web.search_for_instances(case.study)
    assert {i["00080018"]["Value"][0] for i in instances} == {str(d.SOPInstanceUID) for d in case.datasets.values()}
    assert len(web.search_for_instances()) == len(case.datasets)
    assert len(web.search_for_series()) == len(series)
    assert web.search_for_studies(search_filters={"PatientID": "nobody"}) == []


def test_get_remaining_ends(web, case):
    assert len(web.search_for_instances(get_remaining=True, limit=2)) == len(case.datasets)


def test_metadata_are_the_attributes_of_the_file(web, case):
    for name, dataset in case.datasets.items():
        (model,) = [web.retrieve_instance_metadata(*case.uids(name))]
        read = pydicom.Dataset.from_json(model, lambda *_: b"")
        assert model["7FE00010"]["BulkDataURI"].endswith(f"{case.uids(name)[2]}/bulkdata/7FE00010")
        for element in dataset:
            if element.tag != 0x7FE00010:
                assert read[element.tag] == element, element
    assert len(web.retrieve_study_metadata(case.study)) == len(case.datasets)
    study, series, _ = case.uids("projections/0001.dcm")
    assert len(web.retrieve_series_metadata(study, series)) == 5


@pytest.mark.parametrize("syntax", ["*", "1.2.840.10008.1.2.1"])
def test_retrieve_instances(web, case, syntax):
    for name, dataset in case.datasets.items():
        got = web.retrieve_instance(*case.uids(name), media_types=(("application/dicom", syntax),))
        assert np.array_equal(got.pixel_array, dataset.pixel_array)
        expected = dataset.file_meta.TransferSyntaxUID if syntax == "*" else syntax
        assert got.file_meta.TransferSyntaxUID == expected
        for element in dataset:
            if element.tag != 0x7FE00010:
                assert got[element.tag] == element


def test_retrieve_series_and_study(web, case):
    study, series, _ = case.uids("projections/0001.dcm")
    got = web.retrieve_series(study, series)
    assert [int(d.InstanceNumber) for d in got] == [1, 2, 3, 4, 5]
    got = web.retrieve_study(study)
    assert {d.SOPInstanceUID for d in got} == {d.SOPInstanceUID for d in case.datasets.values()}


@pytest.mark.parametrize("name", [VOLUME, LABELS, "projections/0003.dcm", "projections.dcm"])
def test_frames(web, case, name):
    expected = np.atleast_3d(case.datasets[name].pixel_array)
    expected = case.datasets[name].pixel_array
    expected = expected if expected.ndim == 3 else expected[None]
    numbers = [1] if len(expected) == 1 else [1, len(expected), 2]
    kind = "<u1" if case.datasets[name].BitsAllocated == 8 else "<u2"
    for media_types in (None, ("application/octet-stream",)):
        got = web.retrieve_instance_frames(*case.uids(name), numbers, media_types=media_types)
        for number, content in zip(numbers, got, strict=True):
            array = np.frombuffer(content, kind).reshape(expected.shape[1:])
            assert np.array_equal(array, expected[number - 1])


def test_compressed_frames_as_stored(web, case):
    dataset = case.datasets[LABELS]
    stored = list(pydicom.encaps.generate_frames(dataset.PixelData, number_of_frames=int(dataset.NumberOfFrames)))
    got = web.retrieve_instance_frames(
        *case.uids(LABELS), [2, 1], media_types=(("image/dicom-rle", "1.2.840.10008.1.2.5"),)
    )
    assert got == [stored[1], stored[0]]


def test_bulk_data_by_its_address(web, case):
    for name in (VOLUME, LABELS):
        address = web.retrieve_instance_metadata(*case.uids(name))["7FE00010"]["BulkDataURI"]
        (content,) = web.retrieve_bulkdata(address, media_types=("application/octet-stream",))
        expected = case.datasets[name].pixel_array.tobytes()
        assert content[: len(expected)] == expected
        assert len(content) - len(expected) in (0, 1)


def test_rendered(web, case):
    content = web.retrieve_instance_rendered(*case.uids(VOLUME), media_types=("image/png",))
    image = Image.open(io.BytesIO(content))
    assert (image.format, image.mode) == ("PNG", "L")
    assert image.size == (case.datasets[VOLUME].Columns, case.datasets[VOLUME].Rows)
    content = web.retrieve_instance_frames_rendered(*case.uids(VOLUME), [2], media_types=("image/jpeg",))
    assert Image.open(io.BytesIO(content)).format == "JPEG"
