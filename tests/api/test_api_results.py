"""Files over HTTP: ranges, entity tags, digests, archive, manifest."""

import base64
import hashlib
import io
import json
import time
import zipfile

import pytest

from api.http.files import byte_range

FILES = {"projections/0001.dcm", "volume.dcm", "preview/phantom.png"}


@pytest.fixture
def volume(done):
    return f"{done}/artifacts/volume.dcm"


@pytest.fixture
def content(client, volume):
    return client.get(volume).content


def test_list(client, done):
    body = client.get(f"{done}/artifacts").json()
    items = {item["name"]: item for item in body["items"]}
    assert set(items) == FILES
    assert (items["volume.dcm"]["media_type"], items["volume.dcm"]["stage"]) == ("application/dicom", "dicom")
    assert (items["preview/phantom.png"]["media_type"], items["preview/phantom.png"]["stage"]) == (
        "image/png",
        "preview",
    )
    for item in items.values():
        data = client.get(item["href"]).content
        assert (len(data), hashlib.sha256(data).hexdigest()) == (item["size"], item["sha256"])


def test_headers_of_a_file(client, done):
    response = client.get(f"{done}/artifacts/projections/0001.dcm")
    digest = hashlib.sha256(response.content)
    assert response.status_code == 200
    assert response.headers["etag"] == f'"{digest.hexdigest()}"'
    assert response.headers["repr-digest"] == f"sha-256=:{base64.b64encode(digest.digest()).decode()}:"
    assert response.headers["content-disposition"] == 'attachment; filename="0001.dcm"'
    assert response.headers["accept-ranges"] == "bytes"
    assert response.headers["content-type"] == "application/dicom"
    assert response.headers["content-length"] == str(len(response.content))
    assert response.headers["x-content-type-options"] == "nosniff"
    picture = client.get(f"{done}/artifacts/preview/phantom.png")
    assert picture.headers["content-disposition"].startswith("inline")


def test_head(client, volume):
    get, head = client.get(volume), client.head(volume)
    assert (head.status_code, head.content) == (200, b"")
    for name in ("etag", "repr-digest", "content-length", "content-type", "accept-ranges", "content-disposition"):
        assert head.headers[name] == get.headers[name]


@pytest.mark.parametrize(
    ("header", "first", "last"),
    [
        ("bytes=0-0", 0, 0),
        ("bytes=10-19", 10, 19),
        ("bytes=-7", -7, None),
        ("bytes=5990-", 5990, None),
        ("bytes=0-999999", 0, None),
    ],
)
def test_range(client, volume, content, header, first, last):
    expected = content[first:] if last is None else content[first : last + 1]
    start = first if first >= 0 else len(content) + first
    for method in ("GET", "HEAD"):
        response = client.request(method, volume, headers={"Range": header})
        assert response.status_code == 206
        assert response.headers["content-range"] == f"bytes {start}-{start + len(expected) - 1}/{len(content)}"
        assert response.headers["content-length"] == str(len(expected))
        assert response.content == (expected if method == "GET" else b"")


@pytest.mark.parametrize("header", ["bytes=6001-", "bytes=99999-100000", "bytes=-0"])
def test_range_outside(client, volume, content, header, is_problem):
    response = client.get(volume, headers={"Range": header})
    is_problem(response, 416, "range-not-satisfiable")
    assert response.headers["content-range"] == f"bytes */{len(content)}"


@pytest.mark.parametrize(
    "header", ["lines=1-2", "bytes=", "bytes=-", "bytes=b-c", "bytes=9-3", "bytes=0-1,4-5", "x", f"bytes={'9' * 5000}-"]
)
def test_what_is_no_range_is_ignored(client, volume, content, header):
    response = client.get(volume, headers={"Range": header})
    assert (response.status_code, response.content) == (200, content)


def test_if_none_match(client, volume):
    tag = client.get(volume).headers["etag"]
    for header in (tag, f"W/{tag}", "*", f'"x", {tag}'):
        for method in ("GET", "HEAD"):
            response = client.request(method, volume, headers={"If-None-Match": header, "Range": "bytes=0-3"})
            assert (response.status_code, response.content, response.headers["etag"]) == (304, b"", tag)
    assert client.get(volume, headers={"If-None-Match": '"other"'}).status_code == 200


def test_if_range(client, volume):
    tag = client.get(volume).headers["etag"]
    assert client.get(volume, headers={"Range": "bytes=0-3", "If-Range": tag}).status_code == 206
    assert client.get(volume, headers={"Range": "bytes=0-3", "If-Range": '"older"'}).status_code == 200


def test_byte_range_of_an_empty_file(is_problem):
    from api.http.errors import ApiError

    assert byte_range(None, 0) is None
    with pytest.raises(ApiError):
        byte_range("bytes=0-0", 0)


@pytest.mark.parametrize(
    "name", ["nothing.dcm", "../tomosim.db", "..%2f..%2ftomosim.db", "volume.dcm/", "/etc/passwd", "%00"]
)
def test_no_such_file(client, done, name, is_problem):
    assert client.get(f"{done}/artifacts/{name}").status_code == 404


@pytest.mark.parametrize("path", ["artifacts", "artifacts/volume.dcm", "archive", "manifest"])
def test_too_early(client, post, path, is_problem):
    is_problem(client.get(f"{post()['links']['self']}/{path}"), 409, "not-finished")


def test_files_that_are_gone(client, done, served, is_problem):
    item = next(i for i in client.get(f"{done}/artifacts").json()["items"] if i["name"] == "volume.dcm")
    assert served.store.remove_object(item["sha256"], unused_since=time.time() + 60)
    is_problem(client.get(f"{done}/artifacts/volume.dcm"), 410, "expired")
    is_problem(client.get(f"{done}/archive"), 410, "expired")


def test_manifest(client, done):
    manifest = client.get(f"{done}/manifest").json()
    assert set(manifest["files"]) == FILES


@pytest.mark.parametrize(
    ("query", "expected"),
    [
        ("", FILES),
        ("?only=dicom", {"projections/0001.dcm", "volume.dcm"}),
        ("?only=preview", {"preview/phantom.png"}),
    ],
)
def test_archive(client, done, query, expected):
    response = client.get(f"{done}/archive{query}")
    assert response.headers["content-type"] == "application/zip"
    assert ".zip" in response.headers["content-disposition"]
    with zipfile.ZipFile(io.BytesIO(response.content)) as archive:
        assert archive.testzip() is None
        assert set(archive.namelist()) == {"manifest.json", *expected}
        assert all(member.compress_type == zipfile.ZIP_STORED for member in archive.infolist())
        manifest = json.loads(archive.read("manifest.json"))
        for name in expected:
            assert hashlib.sha256(archive.read(name)).hexdigest() == manifest["files"][name]["sha256"]


def test_archive_of_an_unknown_kind(client, done, is_problem):
    is_problem(client.get(f"{done}/archive?only=everything"), 422, "invalid-request")
