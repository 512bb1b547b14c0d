"""Searches, ranges, entity tags, errors, duplicates and deletion, request by request."""

import fnmatch
import re
from dataclasses import asdict
from pathlib import Path

import httpx
import pydicom
import pytest
from hypothesis import given
from hypothesis import strategies as st

from api.dicomweb import query, rendered
from api.dicomweb.metadata import BULK_BYTES
from api.dicomweb.rendered import MOST_PICTURES, THUMBNAIL
from simcore.core.errors import StoreError
from worker.dicom_index.index import Condition
from worker.dicom_index.indexer import MAX_ATTRIBUTE_CHARACTERS, Indexer
from worker.records.database import simulations
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


def test_range_of_an_object(client, case):
    url = case.url(VOLUME)
    content = case.paths[VOLUME].read_bytes()
    plain = {"Accept": "application/dicom"}
    whole = client.get(url, headers=plain)
    assert whole.content == content
    assert whole.headers["content-type"] == "application/dicom; transfer-syntax=1.2.840.10008.1.2.1"
    part = client.get(url, headers={**plain, "Range": "bytes=100-299"})
    assert (part.status_code, part.content) == (206, content[100:300])
    assert part.headers["content-range"] == f"bytes 100-299/{len(content)}"
    assert client.get(url, headers={**plain, "Range": f"bytes={len(content)}-"}).status_code == 416
    head = client.head(url, headers=plain)
    assert (head.content, head.headers["content-length"]) == (b"", str(len(content)))
    tag = whole.headers["etag"]
    assert client.get(url, headers={**plain, "If-None-Match": tag}).status_code == 304
    assert client.get(url, headers={"If-None-Match": tag}).status_code == 200  # multipart is another content


def test_range_of_an_object_that_is_decompressed_on_the_way(client, case):
    url, plain = case.url(LABELS), {"Accept": "application/dicom"}
    content = client.get(url, headers=plain).content
    assert len(content) == int(client.head(url, headers=plain).headers["content-length"])
    frame = case.datasets[LABELS].Rows * case.datasets[LABELS].Columns
    for first, last in ((0, 9), (100, len(content) - 1), (len(content) - frame - 5, len(content) - frame + 5)):
        part = client.get(url, headers={**plain, "Range": f"bytes={first}-{last}"})
        assert (part.status_code, part.content) == (206, content[first : last + 1])


def test_multipart_has_the_length_it_announces(client, case):
    for url in (case.url(VOLUME), f"{case.url(VOLUME)}/frames/1,3", f"/dicomweb/studies/{case.study}"):
        answer = client.get(url)
        assert len(answer.content) == int(answer.headers["content-length"])
        assert answer.headers["vary"] == "Accept"
        boundary = re.search("boundary=(.+)$", answer.headers["content-type"])[1]
        assert answer.content.startswith(f"--{boundary}\r\nContent-Type: application/".encode())
        assert answer.content.endswith(f"\r\n--{boundary}--\r\n".encode())


def test_the_way_ohif_asks(client, case):
    frame = client.get(
        f"{case.url(VOLUME)}/frames/2",
        headers={"Accept": "multipart/related; type=application/octet-stream; transfer-syntax=*"},
    )
    head, _, rest = frame.content.partition(b"\r\n\r\n")
    assert b"Content-Type: application/octet-stream; transfer-syntax=1.2.840.10008.1.2.1" in head
    expected = case.datasets[VOLUME].pixel_array[1].tobytes()
    assert rest[: len(expected)] == expected
    studies = client.get(
        "/dicomweb/studies?limit=101&offset=0&fuzzymatching=false&includefield=00081030%2C00080060%2C00080090%2C00100030"
        "&PatientName=*syn*&00100020=*sim*&StudyDescription=*tomo*&ModalitiesInStudy=MG&StudyDate=19700102-20991231"
    ).json()
    assert case.study in [s["0020000D"]["Value"][0] for s in studies]


def test_absolute_addresses_where_the_client_leaves_out_the_port(web, case):
    address = web.retrieve_instance_metadata(*case.uids(VOLUME))["7FE00010"]["BulkDataURI"]
    assert address.startswith(f"{web.base_url}/studies/")
    page = httpx.get(f"{web.base_url}/instances?limit=1", headers={"Host": "127.0.0.1"})
    assert page.links["next"]["url"].startswith(f"{web.base_url}/instances?")
    assert httpx.get(page.links["next"]["url"]).json() != page.json()


def test_addresses_behind_a_proxy(client, case):
    model = client.get(f"{case.url(VOLUME)}/metadata", headers={"Host": "localhost", "X-Forwarded-For": "10.0.0.1"})
    assert model.json()[0]["7FE00010"]["BulkDataURI"].startswith("http://localhost/dicomweb/")


@pytest.mark.parametrize(
    ("path", "status", "code"),
    [
        ("/dicomweb/studies?limit=x", 400, "bad-query"),
        ("/dicomweb/studies?Nothing=1", 400, "unknown-attribute"),
        (f"/dicomweb/studies/{NOBODY}", 404, "study-not-found"),
        (f"/dicomweb/studies/{NOBODY}/metadata", 404, "study-not-found"),
        (f"/dicomweb/studies/{NOBODY}/thumbnail", 404, "study-not-found"),
        ("/dicomweb/studies/{study}/series/1.2", 404, "series-not-found"),
        ("/dicomweb/studies/{study}/series/{series}/instances/1.2", 404, "instance-not-found"),
        ("/dicomweb/studies/1.2/series/{series}/instances/{instance}", 404, "instance-not-found"),
        ("/dicomweb/studies/x", 400, "bad-uid"),
        ("/dicomweb/studies/..%2f..%2fetc", 404, "not-found"),
        ("/dicomweb/studies/%00", 400, "bad-uid"),
        ("/dicomweb/studies/" + "1" * 65, 400, "bad-uid"),
        ("{url}/frames/0", 404, "frame-not-found"),
        ("{url}/frames/99", 404, "frame-not-found"),
        ("{url}/frames/one", 400, "bad-frames"),
        ("{url}/frames/1,1", 400, "bad-frames"),
        ("{url}/frames/1,2/rendered", 406, "not-acceptable"),
        ("{url}/rendered?window=1", 400, "bad-query"),
        ("{url}/rendered?viewport=10,10,40,0,40,10", 400, "bad-query"),
        ("{url}/rendered?accept=image/gif", 406, "not-acceptable"),
        ("{url}/bulkdata/00100010", 404, "bulk-data-not-found"),
        ("{url}/bulkdata/..%2f..%2f..%2ftomosim.db", 404, "bulk-data-not-found"),
        ("{url}?accept=text/html", 406, "not-acceptable"),
        ("{url}/metadata?accept=application/dicom%2Bxml", 406, "not-acceptable"),
        ("{url}/pixeldata", 404, "not-found"),
    ],
)
def test_errors(client, case, is_problem, path, status, code):
    study, series, instance = case.uids(VOLUME)
    is_problem(
        client.get(path.format(study=study, series=series, instance=instance, url=case.url(VOLUME))), status, code
    )


@pytest.mark.parametrize("method", ["POST", "PUT", "PATCH", "DELETE"])
def test_read_only(client, case, is_problem, method):
    for path in ("/dicomweb/studies", f"/dicomweb/studies/{case.study}", case.url(VOLUME)):
        answer = client.request(method, path, headers={"Content-Type": "application/dicom"}, content=b"x")
        is_problem(answer, 405, "method-not-allowed")
        assert "GET" in answer.headers["allow"]


def test_keys(client, case, served, is_problem):
    secrets = {scope: served.keys.create(scope, [scope]) for scope in ("read", "deliver")}
    try:
        is_problem(client.get("/dicomweb/studies"), 401, "unauthorized")
        is_problem(client.get(case.url(VOLUME) + "/rendered"), 401, "unauthorized")
        for scope, status in (("read", 200), ("deliver", 403)):
            secret = secrets[scope][1]
            bearer = {"Authorization": f"Bearer {secret}"}
            assert client.get("/dicomweb/studies", headers=bearer).status_code == status
            assert client.get("/dicomweb/studies", auth=("anybody", secret)).status_code == status
    finally:
        with served.jobs.engine.begin() as connection:
            connection.exec_driver_sql("DELETE FROM api_keys")


def test_two_cases_with_the_same_study(client, add_case, exported, served):
    first, second = add_case(exported(seed=7), "first"), add_case(exported(seed=7), "second")
    params = {"StudyInstanceUID": first.study}
    between = add_case(exported(seed=5, laterality="R"), "between")
    third = add_case(exported(seed=7), "third")
    newest = [item["0020000D"]["Value"][0] for item in client.get("/dicomweb/studies?limit=2").json()]
    assert newest == [first.study, between.study]
    served.jobs.delete(between.id)
    for case in (third, second, first):
        (study,) = client.get("/dicomweb/studies", params=params).json()
        assert study["00201208"]["Value"] == [len(first.datasets)]
        assert len(client.get("/dicomweb/instances", params=params).json()) == len(first.datasets)
        assert client.get(first.url(VOLUME), headers={"Accept": "application/dicom"}).status_code == 200
        served.jobs.delete(case.id)  # the other one shows now
    assert client.get("/dicomweb/studies", params=params).json() == []
    assert client.get("/dicomweb/instances", params=params).json() == []
    assert client.get(first.url(VOLUME)).status_code == 404


def test_a_case_whose_files_are_gone(client, add_case, exported, served, is_problem, lose):
    case = add_case(exported(seed=8), "gone")
    client.get("/dicomweb/studies")
    manifest = served.jobs.manifest(case.id)
    sha256 = manifest["files"][VOLUME]["sha256"]
    lose(served.store, sha256)
    for what in ("", "/metadata", "/frames/1", "/rendered", "/thumbnail", "/bulkdata/7FE00010"):
        is_problem(client.get(case.url(VOLUME) + what), 410, "expired")
    is_problem(client.get(f"/dicomweb/studies/{case.study}"), 410, "expired")
    assert client.get(f"{case.url(LABELS)}/metadata").status_code == 200
    served.jobs.delete(case.id)


def test_a_case_that_has_expired(client, add_case, exported, served, is_problem):
    def expire(case):
        with served.jobs.engine.begin() as connection:
            connection.execute(simulations.update().where(simulations.c.id == case.id).values(expires_at=1.0))

    first, second = add_case(exported(seed=9), "first"), add_case(exported(seed=9), "second")
    params = {"StudyInstanceUID": first.study}
    assert len(client.get("/dicomweb/studies", params=params).json()) == 1
    expire(second)
    assert len(client.get("/dicomweb/studies", params=params).json()) == 1  # of the first one
    assert client.get(f"{first.url(VOLUME)}/metadata").status_code == 200
    expire(first)
    assert client.get("/dicomweb/studies", params=params).json() == []
    assert client.get("/dicomweb/instances", params=params).json() == []
    is_problem(client.get(f"{first.url(VOLUME)}/metadata"), 410, "expired")
    is_problem(client.get(f"/dicomweb/studies/{first.study}"), 410, "expired")
    third = add_case(exported(seed=9), "third")  # posted again: found without a search before
    assert client.get(f"{first.url(VOLUME)}/metadata").status_code == 200
    for case in (first, second, third):
        served.jobs.delete(case.id)


def test_the_store_does_not_answer(client, case, add_case, exported, served, monkeypatch):
    late = add_case(exported(seed=10), "late")

    def refuse(*_):
        raise StoreError("the bucket does not answer")

    with monkeypatch.context() as patch:
        patch.setattr(type(served.store), "stream", refuse)
        known = [item["0020000D"]["Value"][0] for item in client.get("/dicomweb/studies").json()]
    assert case.study in known
    assert late.study not in known
    assert len(client.get("/dicomweb/studies", params={"StudyInstanceUID": late.study}).json()) == 1
    served.jobs.delete(late.id)


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


def test_files_that_are_no_dicom(client, served, tmp_path):
    (tmp_path / "broken.dcm").write_bytes(b"\0" * 128 + b"DICM" + b"nonsense" * 40)
    (tmp_path / "text.dcm").write_text("text")
    posted = client.post("/v1/simulations", json={"name": "broken"}).json()
    files = {path.name: asdict(served.store.add(path)) for path in list(tmp_path.iterdir())}
    assert served.jobs.claim(posted["id"], "test")
    served.jobs.succeed(posted["id"], "test", {"files": files, "stages": []})
    before = len(client.get("/dicomweb/studies").json())
    assert len(client.get("/dicomweb/studies").json()) == before
    assert client.app.state.dicom_indexer.index.missing() is None


def test_thumbnails(client, case):
    study, series, _ = case.uids(VOLUME)
    for path in (f"studies/{study}", f"studies/{study}/series/{series}"):
        answer = client.get(f"/dicomweb/{path}/thumbnail")
        assert answer.headers["content-type"] == "image/jpeg"
    for path in ("/thumbnail", "/frames/2/thumbnail"):
        assert client.get(case.url(VOLUME) + path).headers["content-type"] == "image/jpeg"
    several = client.get(
        f"{case.url(VOLUME)}/frames/1,2/rendered", headers={"Accept": "multipart/related; type=image/png"}
    )
    assert several.content.count(b"\x89PNG") == 2


def test_many_pictures_at_once(client, case, is_problem, monkeypatch):
    monkeypatch.setattr(rendered, "MOST_PICTURES", 2)
    several = {"Accept": "multipart/related; type=image/png"}
    assert client.get(f"{case.url(VOLUME)}/frames/1,2/rendered", headers=several).status_code == 200
    is_problem(client.get(f"{case.url(VOLUME)}/frames/1,2,3/rendered", headers=several), 400, "bad-frames")


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
