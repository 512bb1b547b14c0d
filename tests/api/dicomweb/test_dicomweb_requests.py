"""Ranges, entity tags, addresses, errors and pictures, request by request."""

import re

import httpx
import pytest

from api.dicomweb import rendered

VOLUME = "tomosynthesis.dcm"
LABELS = "labels.dcm"
NOBODY = "1.2.3"


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
