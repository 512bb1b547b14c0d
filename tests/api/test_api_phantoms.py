"""Label volumes of one's own: posted, listed, used in a case, refused."""

import gzip
import hashlib
import json

import numpy as np
import pytest
from fastapi.testclient import TestClient

from api.http.deps import Services
from simcore.phantom.upload import registry

URL = "http://127.0.0.1"
LOOPBACK = ("127.0.0.1", 50000)
PATH = "/v1/phantoms"
BINARY = {"Content-Type": "application/octet-stream"}


def breast() -> np.ndarray:
    z, y, x = np.meshgrid(np.arange(-10, 11), np.arange(-12, 13), np.arange(20), indexing="ij")
    return np.where((x / 18) ** 2 + (y / 11) ** 2 + (z / 9) ** 2 <= 1, 1, 0).astype("u1")


LABELS = breast()


def nrrd(labels: np.ndarray = LABELS, sizes: str | None = None) -> bytes:
    sizes = sizes or " ".join(map(str, reversed(labels.shape)))
    head = f"NRRD0004\ntype: uchar\ndimension: 3\nsizes: {sizes}\nencoding: gzip\nspacings: 2 2 2\n\n"
    return head.encode() + gzip.compress(labels.tobytes(), mtime=0)


@pytest.fixture
def uploaded(client: TestClient) -> dict:
    response = client.post(PATH, params={"name": "my breast.nrrd"}, content=nrrd(), headers=BINARY)
    assert response.status_code == 201, response.text
    return {"location": response.headers["location"], **response.json()}


def test_a_label_volume_is_stored_as_it_came(uploaded: dict, client: TestClient, served: Services):
    digest = hashlib.sha256(nrrd()).hexdigest()
    assert uploaded["sha256"] == digest
    assert uploaded["location"] == f"http://127.0.0.1{PATH}/{digest}"
    assert (uploaded["name"], uploaded["format"], uploaded["size"]) == ("my breast.nrrd", "nrrd", len(nrrd()))
    assert uploaded["values"] == {"0": int(np.sum(LABELS == 0)), "1": int(np.sum(LABELS == 1))}
    stored = registry.get(served.store, digest)
    assert served.store.path(stored.ref).read_bytes() == nrrd()
    assert client.get(uploaded["links"]["self"]).json() == {k: v for k, v in uploaded.items() if k != "location"}
    assert [item["sha256"] for item in client.get(PATH).json()["items"]] == [digest]
    assert not list((served.store.root / "tmp").iterdir())


def test_its_specification_can_be_posted(uploaded: dict, client: TestClient):
    specification = {**uploaded["specification"], "mesh": {"kind": "lattice"}}
    response = client.post("/v1/simulations", json=specification)
    assert response.status_code == 202, response.text
    assert response.json()["estimate"]["voxels"] == LABELS.size


def test_tissues_volumes_and_doubts_are_told(uploaded: dict, client: TestClient, is_problem):
    tissue = int(np.sum(LABELS == 1))
    assert uploaded["contents"] == [
        {"value": 0, "tissue": "air", "voxels": int(np.sum(LABELS == 0)), "share": None, "ml": pytest.approx(
            np.sum(LABELS == 0) * 8e-3)},
        {"value": 1, "tissue": "adipose", "voxels": tissue, "ml": pytest.approx(tissue * 8e-3), "share": 1.0},
    ]  # fmt: skip
    assert uploaded["remarks"] == ["doubtful: no value is gland", "no value is skin"]
    muscle = {"reading": json.dumps({"tissues": {"0": "air", "1": "muscle"}})}
    problem = is_problem(client.post(PATH, params=muscle, content=nrrd(), headers=BINARY), 422, "invalid-request")
    assert problem["reason"] == "upload-doubtful-tissues"
    assert "it has no fat and no gland" in problem["detail"]
    confirmed = {"reading": json.dumps({"tissues": {"0": "air", "1": "muscle"}, "confirm_tissues": True})}
    assert client.post(PATH, params=confirmed, content=nrrd(), headers=BINARY).status_code == 201


def test_a_compression_of_a_compressed_phantom_is_refused_at_once(client: TestClient, is_problem):
    reading = {"reading": json.dumps({"compressed": True})}
    part = client.post(PATH, params=reading, content=nrrd(), headers=BINARY).json()["specification"]["phantom"]
    for path in ("/v1/simulations", "/v1/simulations/estimate"):
        body = {"phantom": part, "compression": {"thickness_mm": 20.0}}
        problem = is_problem(client.post(path, json=body), 422, "invalid-request")
        assert problem["reason"] == "setting-not-used"
        assert problem["errors"][0]["pointer"] == "/compression/thickness_mm"
        thin = {"phantom": {**part, "thickness_mm": 10.0}}
        problem = is_problem(client.post(path, json=thin), 422, "invalid-request")
        assert problem["errors"][0]["pointer"] == "/phantom/thickness_mm"
        turned = {"phantom": {**part, "axes": ["+z", "+y", "-x"]}}
        problem = is_problem(client.post(path, json=turned), 422, "invalid-request")
        assert "axes = +z,-y,+x" in problem["detail"]
    assert client.post("/v1/simulations", json={"phantom": part}).status_code == 202


def test_raw_voxels_come_with_a_header(client: TestClient, is_problem):
    header = {"shape": list(LABELS.shape), "spacing_mm": [2.0, 2.0, 2.0]}
    reading = json.dumps({"raw": header, "tissues": {"0": "air", "1": "gland"}, "compressed": True})
    for data in (LABELS.tobytes(), gzip.compress(LABELS.tobytes())):
        response = client.post(PATH, params={"reading": reading}, content=data, headers=BINARY)
        assert response.status_code == 201, response.text
        part = response.json()["specification"]["phantom"]
        assert (part["shape"], part["compressed"], part["tissues"]["1"]) == (list(LABELS.shape), True, "gland")
    is_problem(client.post(PATH, content=LABELS.tobytes(), headers=BINARY), 422, "invalid-request")


def test_a_breast_of_an_unlikely_size_is_to_be_confirmed(client: TestClient, is_problem):
    small = nrrd().replace(b"spacings: 2 2 2", b"spacings: .2 .2 .2")
    problem = is_problem(client.post(PATH, content=small, headers=BINARY), 422, "invalid-request")
    assert problem["reason"] == "upload-unlikely-size"
    assert problem["errors"][0]["pointer"] == "/spacing_mm"
    assert "confirm_size = true" in problem["detail"]
    confirmed = client.post(PATH, params={"reading": '{"confirm_size": true}'}, content=small, headers=BINARY)
    assert confirmed.status_code == 201, confirmed.text
    said = client.post(PATH, params={"reading": '{"spacing_mm": [2, 2, 2]}'}, content=small, headers=BINARY)
    assert said.json()["specification"]["phantom"]["spacing_mm"] == [2.0, 2.0, 2.0]
    assert "voxels of 2 x 2 x 2 mm as given, not 0.2 x 0.2 x 0.2 as in the file" in said.json()["remarks"]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "no NRRD, MetaImage or NIfTI"),
        (nrrd()[:-20], "cut short"),
        (nrrd(sizes="20 25 22"), "ends after"),
        (nrrd(sizes="20 25 20"), "holds more than"),
        (nrrd(np.full((3, 3, 3), 77, "u1")), "no tissue for 77"),
    ],
)
def test_what_cannot_be_used_is_refused_and_leaves_nothing(content, said, client, served, is_problem):
    problem = is_problem(client.post(PATH, content=content, headers=BINARY), 422, "invalid-request")
    assert said in problem["detail"]
    assert client.get(PATH).json() == {"items": []}
    assert not [p for p in (served.store.root / "objects").rglob("*") if p.is_file()]
    assert not list((served.store.root / "tmp").iterdir())


def test_a_wrong_reading_is_refused_by_field(client: TestClient, is_problem):
    response = client.post(PATH, params={"reading": '{"axes": ["+x"]}'}, content=nrrd(), headers=BINARY)
    problem = is_problem(response, 422, "invalid-request")
    assert any(e["pointer"].startswith("/axes") for e in problem["errors"])
    is_problem(client.post(PATH, params={"name": "n" * 201}, content=nrrd(), headers=BINARY), 422, "invalid-request")


def test_another_media_type_is_refused(client: TestClient, is_problem):
    is_problem(client.post(PATH, content=nrrd(), headers={"Content-Type": "text/plain"}), 415, "unsupported-media-type")
    is_problem(client.post(PATH, content=nrrd()), 415, "unsupported-media-type")


def test_more_than_the_limit_is_refused_whether_announced_or_not(settings, broker, is_problem):
    from api.app import create_app

    small = settings.model_copy(update={"upload_limit_bytes": 300})
    with TestClient(create_app(small, broker, sweep=False), base_url=URL, client=LOOPBACK) as client:
        is_problem(client.post(PATH, content=bytes(301), headers=BINARY), 413, "too-large")
        is_problem(client.post(PATH, content=iter([bytes(200)] * 2), headers=BINARY), 413, "too-large")
        store = client.app.state.services.store
        assert not list((store.root / "tmp").iterdir())
        assert client.get("/v1/service-info").json()["limits"]["upload_bytes"] == 300


@pytest.mark.parametrize("name", ["0" * 64, "nothing", "..%2F..%2Fetc", "%00"])
def test_an_unknown_digest_is_not_found(name: str, client: TestClient, is_problem):
    response = client.get(f"{PATH}/{name}")
    assert response.status_code == 404
    if "%" not in name:
        is_problem(response, 404, "phantom-not-found")


def test_a_case_with_a_phantom_that_was_never_added_is_refused_at_once(uploaded: dict, client: TestClient, is_problem):
    part = uploaded["specification"]["phantom"]
    for path in ("/v1/simulations", "/v1/simulations/estimate"):
        missing = {"phantom": {**part, "sha256": "0" * 64}}
        problem = is_problem(client.post(path, json=missing), 422, "invalid-request")
        assert problem["reason"] == "upload-not-found"
        assert problem["errors"][0]["pointer"] == "/phantom/sha256"
        other = {"phantom": {**part, "shape": [1, 2, 3]}}
        assert is_problem(client.post(path, json=other), 422, "invalid-request")["reason"] == "upload-mismatch"
