"""The same case in Orthanc's DICOMweb plugin: searches, metadata and pixels are equal."""

from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pydicom
import pytest
from dicomweb_client import DICOMwebClient
from dicomweb_client.session_utils import create_session

from tests.support.orthanc import running

from .conftest import Case

pytestmark = pytest.mark.needs_orthanc

PLUGIN = Path("/usr/share/orthanc/plugins/libOrthancDicomWeb.so")
START_SECONDS = 60
PIXELS = ("PixelData", "FloatPixelData")

# Orthanc answers with these of its own: where it is, when it was asked for, the file as it keeps it.
OF_THE_SERVER = {"RetrieveURL", "InstanceAvailability", "AvailableTransferSyntaxUID", "SpecificCharacterSet"}


@pytest.fixture(scope="module")
def orthanc(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of an Orthanc on a free loopback port."""
    with running(tmp_path_factory.mktemp("orthanc"), DicomServerEnabled=False) as archive:
        yield archive.url


@pytest.fixture(scope="module")
def shared_case(orthanc: str, add_case, exported) -> Case:
    case = add_case(exported(seed=11, lesions=True), "shared")
    for path in case.paths.values():
        assert httpx.post(f"{orthanc}/instances", content=path.read_bytes(), timeout=60).is_success
    return case


@pytest.fixture(scope="module")
def peer(orthanc: str, shared_case: Case) -> DICOMwebClient:
    session = create_session()
    session.headers["Accept-Encoding"] = "identity"
    return DICOMwebClient(f"{orthanc}/dicom-web", session=session)


def by_uid(results: list[dict], tag: str) -> dict[str, pydicom.Dataset]:
    return {item[tag]["Value"][0]: pydicom.Dataset.from_json(item, lambda *_: b"") for item in results}


def same_where_both_have_it(ours: pydicom.Dataset, theirs: pydicom.Dataset) -> int:
    """Asserts that the attributes that both have are equal; how many those are."""
    both = [e.tag for e in ours if e.tag in theirs and e.keyword not in (*OF_THE_SERVER, *PIXELS)]
    for tag in both:
        same_element(ours[tag], theirs[tag])
    return len(both)


def same_element(ours: pydicom.DataElement, theirs: pydicom.DataElement) -> None:
    if ours.VR == "SQ":
        assert len(ours.value) == len(theirs.value), ours
        for a, b in zip(ours.value, theirs.value, strict=True):
            assert {e.tag for e in a} == {e.tag for e in b}, ours
            same_where_both_have_it(a, b)
    elif ours.VR in ("DS", "FD", "FL"):
        assert np.allclose(np.float64(ours.value), np.float64(theirs.value), rtol=1e-6, atol=1e-9), (ours, theirs)
    else:
        assert str(ours.value) == str(theirs.value), (ours, theirs)


def test_searches(web, peer, shared_case):
    only = {"StudyInstanceUID": shared_case.study}
    study = shared_case.study
    for tag, ours, theirs, least in (
        ("0020000D", web.search_for_studies(search_filters=only), peer.search_for_studies(search_filters=only), 10),
        ("0020000E", web.search_for_series(study), peer.search_for_series(study), 4),
        ("00080018", web.search_for_instances(study), peer.search_for_instances(study), 6),
    ):
        mine, expected = by_uid(ours, tag), by_uid(theirs, tag)
        assert mine.keys() == expected.keys()
        for uid in mine:
            assert same_where_both_have_it(mine[uid], expected[uid]) >= least


def test_metadata(web, peer, shared_case):
    mine = by_uid(web.retrieve_study_metadata(shared_case.study), "00080018")
    expected = by_uid(peer.retrieve_study_metadata(shared_case.study), "00080018")
    assert mine.keys() == expected.keys()
    for uid, ours in mine.items():
        missing = {e.keyword for e in expected[uid] if e.tag not in ours} - OF_THE_SERVER
        assert not missing
        assert same_where_both_have_it(ours, expected[uid]) > 60


def test_pixels(web, peer, shared_case):
    for name, dataset in shared_case.datasets.items():
        if "PixelData" not in dataset:
            continue
        uids = shared_case.uids(name)
        ours, theirs = web.retrieve_instance(*uids), peer.retrieve_instance(*uids)
        assert np.array_equal(ours.pixel_array, theirs.pixel_array), name
        assert np.array_equal(ours.pixel_array, dataset.pixel_array), name
        if dataset.BitsAllocated == 1:
            continue  # Orthanc sends such frames only where they begin with a byte
        numbers = [1, int(dataset.NumberOfFrames)] if int(dataset.get("NumberOfFrames", 1)) > 1 else [1]
        kinds = ("application/octet-stream",)
        assert web.retrieve_instance_frames(*uids, numbers, media_types=kinds) == peer.retrieve_instance_frames(
            *uids, numbers, media_types=kinds
        ), name
