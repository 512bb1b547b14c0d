"""Searches: what matches, what comes along, page by page."""

import fnmatch
import re
from pathlib import Path

import pydicom
import pytest
from hypothesis import given
from hypothesis import strategies as st

from api.dicomweb import query
from api.dicomweb.metadata import BULK_BYTES
from api.dicomweb.rendered import MOST_PICTURES, THUMBNAIL
from worker.dicom_index.index import Condition
from worker.dicom_index.indexer import MAX_ATTRIBUTE_CHARACTERS, Indexer
from worker.records.dicom import KEYS

VOLUME = "tomosynthesis.dcm"
LABELS = "labels.dcm"
NOBODY = "1.2.3"


@pytest.fixture(scope="module")
def other(add_case, exported):
    return add_case(exported(laterality="R", seed=5), "other")


@pytest.fixture(scope="module")
def search(client, case, other):
    """Searches; the study, series or instance identifiers that were found."""

    def run(path, **parameters):
        answer = client.get(f"/dicomweb/{path}", params=parameters)
        assert answer.status_code == 200, answer.text
        assert answer.headers["content-type"] == "application/dicom+json"
        tag = {"studies": "0020000D", "series": "0020000E", "instances": "00080018"}[path.split("/")[-1]]
        return [item[tag]["Value"][0] for item in answer.json()]

    return run


def test_the_newest_study_comes_first(search, case, other):
    assert search("studies") == [other.study, case.study]


def test_matching_of_studies(search, case, other):
    both, patient = {case.study, other.study}, case.datasets[VOLUME].PatientID
    assert search("studies", StudyInstanceUID=case.study) == [case.study]
    assert set(search("studies", StudyInstanceUID=f"{case.study},{other.study},1.2")) == both
    assert set(search("studies", PatientID=patient)) == both  # the same phantom
    assert search("studies", PatientID=patient[:-1]) == []
    assert set(search("studies", PatientID=f"{patient[:-1]}?")) == both
    assert set(search("studies", PatientName="synthetic*")) == both
    assert set(search("studies", PatientName="*^SIM*")) == both
    assert search("studies", PatientName="%") == []
    assert search("studies", PatientName="SYNTHETIC_SIM*") == []
    assert set(search("studies", StudyDate="20260101")) == both
    assert set(search("studies", StudyDate="20251231-20260102")) == both
    assert search("studies", StudyDate="20260102-") == []
    assert set(search("studies", StudyTime="12")) == both
    assert search("studies", StudyTime="1201-") == []
    assert search("studies", PatientBirthDate="-19000101") == []
    assert set(search("studies", AccessionNumber="*")) == both
    assert set(search("studies", ModalitiesInStudy="SEG,CT")) == both
    assert search("studies", ModalitiesInStudy="CT") == []
    assert search("studies", StudyInstanceUID=case.study, ModalitiesInStudy="CT") == []


def test_matching_of_series_and_instances(search, case, other):
    volume, labels = case.datasets[VOLUME], case.datasets[LABELS]
    assert search("series", SeriesInstanceUID=volume.SeriesInstanceUID) == [volume.SeriesInstanceUID]
    assert labels.SeriesInstanceUID in search("series", Modality="SEG", StudyInstanceUID=case.study)
    assert search("series", StudyInstanceUID=case.study, SeriesNumber=volume.SeriesNumber) == [volume.SeriesInstanceUID]
    assert search("instances", SOPInstanceUID=f"{volume.SOPInstanceUID},{labels.SOPInstanceUID}").count(
        volume.SOPInstanceUID
    )
    assert search("instances", SOPClassUID=volume.SOPClassUID, StudyInstanceUID=other.study) == [
        other.datasets[VOLUME].SOPInstanceUID
    ]
    study, series, _ = case.uids("projections/0002.dcm")
    views = search(f"studies/{study}/series/{series}/instances")
    assert views == [case.datasets[f"projections/{n:04d}.dcm"].SOPInstanceUID for n in range(1, 6)]
    assert search(f"studies/{study}/series/{series}/instances", InstanceNumber=2) == [views[1]]
    assert search(f"studies/{study}/instances", PatientID="nobody") == []
    assert search(f"studies/{NOBODY}/series") == []


@pytest.fixture(scope="module")
def index(client, case, other) -> Indexer:
    client.get("/dicomweb/studies")
    return client.app.state.dicom_indexer.index


@given(st.text(alphabet="*?SYNTHEICabc^%_\\[]-.", max_size=14))
def test_wildcards_match_as_in_a_shell(index, case, pattern):
    pattern = re.sub(r"\*+", "*", pattern)
    rows, _ = index.search("study", [Condition("PatientName", (pattern,))], 10, 0)
    shell = pattern.lower().replace("[", "[[]")
    name = str(case.datasets[VOLUME].PatientName).lower()
    assert bool(rows) == fnmatch.fnmatchcase(name, shell)


def test_attributes_of_results(client, case, other):
    study = client.get("/dicomweb/studies", params={"StudyInstanceUID": case.study}).json()[0]
    assert study["00081190"] == {"vr": "UR", "Value": [f"http://127.0.0.1/dicomweb/studies/{case.study}"]}
    assert study["00080056"]["Value"] == ["ONLINE"]
    assert study["00201206"]["Value"] == [len({d.SeriesInstanceUID for d in case.datasets.values()})]
    assert study["00100010"] == {"vr": "PN", "Value": [{"Alphabetic": str(case.datasets[VOLUME].PatientName)}]}
    assert list(study) == sorted(study)
    assert "00101010" not in study
    wider = client.get("/dicomweb/studies", params={"includefield": "PatientAge,00180060"}).json()[0]
    assert wider["00101010"]["Value"] == ["050Y"]
    everything = client.get(f"/dicomweb/studies/{case.study}/instances", params={"includefield": "all"}).json()
    assert all("00181405" in i or "00080008" in i for i in everything)
    assert all("7FE00010" not in i and "52009230" not in i for i in everything)
    # Above the level of the path, the attributes of the levels that the path leaves open come along.
    assert "00100020" in client.get("/dicomweb/instances").json()[0]
    assert "00100020" not in client.get(f"/dicomweb/studies/{case.study}/instances").json()[0]


def test_pages(client, case, other):
    total = len(case.datasets) + len(other.datasets)
    path, seen = "/dicomweb/instances?limit=7", []
    while path:
        answer = client.get(path)
        seen += [item["00080018"]["Value"][0] for item in answer.json()]
        remaining = total - len(seen)
        if remaining:
            assert f"There are {remaining} additional results" in answer.headers["warning"]
            path = re.fullmatch(r'<(.+)>; rel="next"', answer.headers["link"])[1]
        else:
            assert "warning" not in answer.headers
            assert "link" not in answer.headers
            path = None
    assert len(set(seen)) == len(seen) == total
    assert client.get("/dicomweb/instances?offset=500").json() == []
    assert len(client.get("/dicomweb/instances?limit=7&PatientID=nobody").json()) == 0


def test_warnings(client, case, other):
    answer = client.get("/dicomweb/studies?fuzzymatching=true&KVP=20")
    texts = answer.headers.get_list("warning")
    assert texts[0] == (
        "299 http://127.0.0.1/dicomweb: The fuzzymatching parameter is not supported. "
        "Only literal matching has been performed."
    )
    assert "KVP" in texts[1]
    assert len(answer.json()) == 2


def test_no_file_is_opened_for_a_search(client, case, other, served, monkeypatch):
    client.get("/dicomweb/studies")
    monkeypatch.setattr(type(served.store), "stream", None)
    monkeypatch.setattr(type(served.store), "path", None)
    assert len(client.get("/dicomweb/instances?includefield=all").json()) > 10


def test_a_study_without_a_date_lies_in_no_range(client, add_case, exported, served, tmp_path):
    dataset = pydicom.dcmread(exported() / VOLUME)
    dataset.StudyInstanceUID, dataset.StudyDate = "1.2.4", ""
    dataset.save_as(tmp_path / VOLUME)
    case = add_case(tmp_path, "undated")
    pages = [
        client.get("/dicomweb/studies", params={"StudyInstanceUID": "1.2.4", "StudyDate": date}).json()
        for date in ("", "-20991231", "19000101-")
    ]
    assert [len(studies) for studies in pages] == [1, 0, 0]
    served.jobs.delete(case.id)


def test_the_page_names_what_is_searched_and_the_limits():
    page = (Path(__file__).parents[3] / "docs" / "dicomweb.md").read_text()
    for level in ("study", "series", "instance"):
        row = re.search(rf"^\| {level} \| (.+) \|$", page, re.MULTILINE)[1]
        assert set(re.findall(r"`(\w+)`", row)) == {name for name, key in KEYS.items() if key.level == level}
    assert f"at most {query.MAX_RESULTS} an answer" in page
    assert f"more than {BULK_BYTES} bytes" in page
    assert f"more than {MAX_ATTRIBUTE_CHARACTERS} characters" in page
    assert f"{THUMBNAIL.width} pixels" in page
    assert f"at most {MOST_PICTURES}) as multipart" in page
