"""Files in object storage: only what is read is fetched, and what is missing there stops nothing."""

from collections.abc import Iterator

import pydicom
import pytest
from fastapi.testclient import TestClient

from api.app import create_app
from tests.support.brokers import SilentBroker

from .conftest import Case

VOLUME = "tomosynthesis.dcm"


@pytest.fixture
def in_bucket(settings, make_location, tmp_path) -> Iterator[TestClient]:
    """The application on a machine whose own folder is empty."""
    location = make_location()
    changes = {
        "data_folder": tmp_path / "data",
        "store_url": location.url,
        "store_endpoint": location.endpoint,
        "store_access_key": location.access_key,
        "store_secret_key": location.secret_key,
    }
    chosen = settings.model_copy(update=changes)
    app = create_app(chosen, SilentBroker(), sweep=False)
    with TestClient(app, base_url="http://127.0.0.1", client=("127.0.0.1", 50000)) as http:
        yield http


def post(client: TestClient, folder, remove: str | None = None) -> Case:
    """A case whose files another machine has put into the bucket (all but one of them, if asked)."""
    services = client.app.state.services
    case = Case(client.post("/v1/simulations", json={}).json()["id"])
    services.jobs.claim(case.id, "test")
    files = {}
    for path in sorted(folder.rglob("*.dcm")):
        name = path.relative_to(folder).as_posix()
        case.datasets[name] = pydicom.dcmread(path)
        with services.store.workspace() as space:
            (space / "copy").write_bytes(path.read_bytes())
            ref = services.store.add(space / "copy")
        files[name] = {"sha256": ref.sha256, "size": ref.size}
        local = services.store.root / "objects" / ref.sha256[:2] / ref.sha256
        local.unlink()
        if name == remove:
            assert services.store.remove_object(ref.sha256, float("inf"))
    services.jobs.succeed(case.id, "test", {"files": files, "stages": []})
    return case


def fetched(client: TestClient) -> list:
    return [p for p in (client.app.state.services.store.root / "objects").rglob("*") if p.is_file()]


def test_frames_and_objects_without_a_local_copy(in_bucket, exported):
    case = post(in_bucket, exported())
    frame = in_bucket.get(f"{case.url(VOLUME)}/frames/3", headers={"Accept": "application/octet-stream"})
    assert frame.content == case.datasets[VOLUME].pixel_array[2].tobytes()
    labels = in_bucket.get(f"{case.url('labels.dcm')}/frames/5", headers={"Accept": "application/octet-stream"})
    assert labels.content == case.datasets["labels.dcm"].pixel_array[4].tobytes()
    assert in_bucket.get(f"{case.url(VOLUME)}/metadata").status_code == 200
    assert in_bucket.get(f"{case.url(VOLUME)}/rendered").status_code == 200
    whole = in_bucket.get(case.url(VOLUME), headers={"Accept": "application/dicom", "Range": "bytes=128-131"})
    assert whole.content == b"DICM"
    assert fetched(in_bucket) == []


def test_a_file_that_is_missing_in_the_bucket(in_bucket, exported):
    broken = post(in_bucket, exported(), remove=VOLUME)
    other = post(in_bucket, exported(seed=5, laterality="R"))
    rows = {s["0020000D"]["Value"][0]: s for s in in_bucket.get("/dicomweb/studies").json()}
    assert set(rows) == {broken.study, other.study}
    assert rows[broken.study]["00201208"]["Value"] == [len(broken.datasets) - 1]
