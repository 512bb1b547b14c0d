"""The client against the real API in this process, and against a service that misbehaves."""

import json
import os
import queue
import subprocess
import sys
import threading
import zipfile
from collections.abc import Callable
from pathlib import Path

import anyio
import httpx
import pytest

from api.app import create_app
from simcore import presets
from simcore.spec import SimulationSpec
from tests.support.brokers import SilentBroker
from tests.support.servers import served
from tomosim import client as clients
from tomosim.client import AsyncClient, Client, Retrying, ServiceError, twin
from tomosim.client.files import Partial
from tomosim_contract.destination import Destination
from worker.compute.supervisor import Slot
from worker.settings import Settings

AT_ONCE = Retrying(first_seconds=0.0, longest_seconds=0.0)


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory, module_backend: dict[str, object]):
    with pytest.MonkeyPatch.context() as patch:
        for name in [n for n in os.environ if n.startswith("TOMOSIM_")]:
            patch.delenv(name)
        yield Settings.load(
            data_folder=tmp_path_factory.mktemp("data"),
            pipeline="tests.support.fake_pipeline:run",
            webhook_private_hosts="127.0.0.1",
            memory_limit_bytes=3_000_000_000,
            **module_backend,
        )


@pytest.fixture(scope="module")
def service(settings: Settings):
    """(address, application) of a running API."""
    app = create_app(settings, SilentBroker(), sweep=False)
    with served(app) as address:
        yield address, app


@pytest.fixture
def client(service):
    with Client(service[0], retrying=AT_ONCE) as http:
        yield http


@pytest.fixture(scope="module")
def run(settings: Settings, service) -> Callable[[str], None]:
    """Runs queued cases on a worker slot, one after the other."""
    slot = Slot("test", settings, service[1].state.services.jobs, threading.Event())
    waiting: queue.SimpleQueue[str | None] = queue.SimpleQueue()

    def work():
        while identifier := waiting.get():
            slot.run(identifier)
        slot.kill()

    thread = threading.Thread(target=work)
    thread.start()
    yield waiting.put
    waiting.put(None)
    thread.join(30)


@pytest.fixture(scope="module")
def done(service, run) -> str:
    """A case that has succeeded."""
    with Client(service[0]) as client:
        case = client.submit(SimulationSpec(name="fine", seed=3))
        run(case.id)
        assert client.wait(case.id).state == "succeeded"
    return case.id


def test_a_case_from_submission_to_files(client, run, tmp_path: Path):
    case = client.submit(SimulationSpec(name="slow", seed=11))
    assert case.state == "queued"
    run(case.id)
    seen = []
    case = client.wait(case.id, seen.append)
    assert (case.state, case.name) == ("succeeded", "slow")
    assert seen[0].data["state"] == "queued"
    assert {e.kind for e in seen} == {"state", "progress"}
    assert [e.sequence for e in seen] == sorted(e.sequence for e in seen)
    files = {f.name: f for f in client.download(case.id, tmp_path)}
    assert set(files) == {"projections/0001.dcm", "volume.dcm", "preview/phantom.png", "manifest.json"}
    assert (tmp_path / "volume.dcm").stat().st_size == files["volume.dcm"].size
    assert json.loads((tmp_path / "manifest.json").read_bytes()) == client.manifest(case.id)
    assert all(f.kept for f in client.download(case.id, tmp_path) if f.name != "manifest.json")
    client.delete(case.id)
    with pytest.raises(clients.NotFoundError) as missing:
        client.get(case.id)
    assert (missing.value.code, missing.value.status) == ("simulation-not-found", 404)


def test_the_same_from_asynchronous_programs(service, run, tmp_path: Path):
    async def main():
        async with AsyncClient(service[0]) as client:
            cases = [await client.submit({"name": "fine", "seed": seed}) for seed in (21, 22)]
            for case in cases:
                run(case.id)
            async with anyio.create_task_group() as group:
                for case in cases:
                    group.start_soon(client.wait, case.id)
            files = [f.name async for f in client.download(cases[0].id, tmp_path)]
            states = {c.id: c.state async for c in client.simulations(page_size=1)}
            with pytest.raises(clients.ConflictError):
                await client.cancel(cases[0].id)
            with pytest.raises(TimeoutError):
                await client.wait((await client.submit({})).id, timeout_seconds=0.1)
            return files, [states[c.id] for c in cases]

    files, states = anyio.run(main)
    assert sorted(files) == ["manifest.json", "preview/phantom.png", "projections/0001.dcm", "volume.dcm"]
    assert states == ["succeeded", "succeeded"]


def test_pages_are_turned(client):
    identifiers = {client.submit({"seed": seed}).id for seed in range(5)}
    listed = [case.id for case in client.simulations(page_size=2)]
    assert identifiers <= set(listed)
    assert len(listed) == len(set(listed))
    assert {case.state for case in client.simulations("queued")} == {"queued"}


def test_what_can_be_asked_for(client):
    assert "tiny" in {p.name for p in client.presets()}
    assert client.preset("tiny") == presets.get("tiny")
    assert client.service_info().api_version == "v1"
    assert client.estimate(presets.get("tiny")).memory_bytes > 0


def test_errors_are_typed_and_tell_the_field(client, done: str):
    with pytest.raises(clients.InvalidRequestError, match="views") as refused:
        client.submit({"acquisition": {"views": "many"}})
    assert (refused.value.status, refused.value.code, refused.value.kind) == (422, "invalid-request", "user")
    assert refused.value.problem["errors"][0]["pointer"].startswith("/acquisition")
    with pytest.raises(clients.ConflictError) as late:
        client.cancel(done)
    assert late.value.code == "already-finished"
    with pytest.raises(clients.NotFoundError):
        client.get("../phantoms")


def test_phantoms_go_up_in_a_stream(client, tmp_path: Path):
    raw = tmp_path / "labels.raw"
    raw.write_bytes(bytes([1, 2, 1, 1] * 2000))
    reading = {
        "raw": {"shape": [20, 20, 20], "spacing_mm": [1.0, 1.0, 1.0]},
        "tissues": "tomosim",
        "confirm_size": True,
    }
    sent = client.upload_phantom(raw, reading=reading)
    with open(raw, "rb") as stream:
        assert client.upload_phantom(stream, name="labels.raw", reading=reading).sha256 == sent.sha256

    async def again():
        async with AsyncClient(client.url) as other:
            return await other.upload_phantom(raw, reading=reading)

    assert anyio.run(again) == sent == client.phantom(sent.sha256)
    assert sent in client.phantoms()
    with pytest.raises(clients.InvalidRequestError):
        client.upload_phantom(raw, reading={"raw": {}})


def test_webhooks(client):
    hook = client.create_webhook("http://127.0.0.1:9/hook", ("simulation.failed",), "ours")
    assert hook.secret.startswith("whsec_")
    assert [h.id for h in client.webhooks()] == [hook.id]
    sent = client.test_webhook(hook.id)
    assert [m.id for m in client.webhook_messages(hook.id)] == [sent.id]
    assert client.webhook_message(hook.id, sent.id).log == []
    with pytest.raises(clients.ConflictError):
        client.replay_message(hook.id, sent.id)
    assert client.enable_webhook(hook.id).state == client.webhook(hook.id).state == "active"
    client.delete_webhook(hook.id)
    assert client.webhooks() == []


def test_a_study_from_submission_to_archive(client, run, tmp_path: Path):
    study = {
        "name": "pair",
        "base": {"name": "fine"},
        "axes": [{"kind": "grid", "field": "seed", "values": [31, 32]}],
    }
    assert client.estimate_study(study).cases == 2
    resource = client.submit_study(study)
    assert (resource.cases, resource.state) == (2, "queued")
    assert resource.id in [s.id for s in client.studies(page_size=1)]
    cases = list(client.study_cases(resource.id, page_size=1))
    assert [c.coordinates["seed"] for c in cases] == [31, 32]
    assert {c.id for c in client.simulations(study_id=resource.id)} == {c.id for c in cases}
    run(cases[0].id)
    client.wait(cases[0].id)
    assert client.cancel_study(resource.id).counts["cancelled"] == 1
    looks = []
    assert client.wait_for_study(resource.id, looks.append, timeout_seconds=30).state == "partial"
    assert looks[-1].finished_cases == 2
    assert client.retry_study(resource.id, cancelled=True).counts["queued"] == 1
    with pytest.raises(TimeoutError):
        client.wait_for_study(resource.id, timeout_seconds=0)
    run(cases[1].id)
    assert client.wait_for_study(resource.id).state == "succeeded"
    assert [c["number"] for c in client.study_manifest(resource.id)["cases"]] == [1, 2]
    for get, identifier in ((client.download_study_archive, resource.id), (client.download_archive, cases[0].id)):
        target = tmp_path / identifier / "files.zip"
        assert get(identifier, target) == target.stat().st_size
        assert zipfile.ZipFile(target).testzip() is None
        assert list(target.parent.iterdir()) == [target]
    client.delete_study(resource.id)
    with pytest.raises(clients.NotFoundError):
        client.study(resource.id)


def test_destinations_and_deliveries(client, done: str, free_port: int):
    definition = Destination(name="archive", host="127.0.0.1", port=free_port, called_aet="ARCHIVE")
    resource = client.create_destination(definition)
    assert [d.id for d in client.destinations()] == [resource.id]
    assert client.change_destination(resource.id, called_aet="OTHER").called_aet == "OTHER"
    assert client.destination(resource.id).revision == resource.revision + 1
    assert not client.echo(resource.id).reachable
    sent = client.deliver("archive", simulation_id=done, files=["volume.dcm"])
    assert (sent.state, sent.instances_total) == ("queued", 1)
    assert [d.id for d in client.deliveries(simulation_id=done, page_size=1)] == [sent.id]
    assert [i.name for i in client.delivery_instances(sent.id, "waiting")] == ["volume.dcm"]
    with pytest.raises(TimeoutError):
        client.wait_for_delivery(sent.id, timeout_seconds=0)
    assert client.cancel_delivery(sent.id).state == "cancelled"
    assert client.wait_for_delivery(sent.id) == client.delivery(sent.id)
    assert client.retry_delivery(sent.id).state == "queued"
    client.cancel_delivery(sent.id)
    client.delete_destination(resource.id)
    with pytest.raises(clients.InvalidRequestError):
        client.submit({"name": "fine"}, deliver=["nowhere"])


def test_a_broken_download_goes_on_where_it_broke(client, done: str, tmp_path: Path):
    item = next(a for a in client.artifacts(done) if a.name == "volume.dcm")
    whole = httpx.get(client.url + item.href).content
    ranges = []

    class Breaks(httpx.HTTPTransport):
        """Loses the connection in the middle of the first answer."""

        def handle_request(self, request):
            response = super().handle_request(request)
            if request.url.path == item.href:
                ranges.append(request.headers.get("range"))
                if len(ranges) == 1:
                    response.stream = Broken(response.stream)
            return response

    class Broken(httpx.SyncByteStream):
        def __init__(self, stream):
            self.stream = stream

        def __iter__(self):
            yield b"".join(self.stream)[:1000]
            raise httpx.ReadError("connection lost")

        def close(self):
            self.stream.close()

    with Client(client.url, retrying=AT_ONCE, transport=Breaks()) as fragile:
        files = list(fragile.download(done, tmp_path, lambda name: name == "volume.dcm"))
    assert ranges == [None, "bytes=1000-"]
    assert files[0].path.read_bytes() == whole
    assert list(tmp_path.glob("*.partial")) == []

    # What an earlier program left is gone on with; what is wrong is noticed and not kept.
    (tmp_path / "volume.dcm").unlink()
    (tmp_path / "volume.dcm.partial").write_bytes(whole[:10])
    list(client.download(done, tmp_path))
    assert (tmp_path / "volume.dcm").read_bytes() == whole
    (tmp_path / "volume.dcm").write_bytes(b"cut short")
    (tmp_path / "volume.dcm.partial").write_bytes(b"something else")
    with pytest.raises(clients.DigestError):
        list(client.download(done, tmp_path))
    assert not (tmp_path / "volume.dcm.partial").exists()
    list(client.download(done, tmp_path))
    assert (tmp_path / "volume.dcm").read_bytes() == whole


@pytest.mark.parametrize("name", ["../outside", "/etc/passwd", "a/../../b", "."])
def test_no_file_is_written_outside(tmp_path: Path, name: str):
    with pytest.raises(ServiceError, match="outside"):
        clients.files.target_of(tmp_path / "out", name)


def test_a_range_that_is_not_honoured_begins_anew(tmp_path: Path):
    import hashlib

    target = tmp_path / "file"
    target.with_name("file.partial").write_bytes(b"old")
    with Partial(target, hashlib.sha256(b"all of it").hexdigest()) as partial:
        assert partial.headers()["Range"] == "bytes=3-"
        partial.begin(httpx.Response(200))
        partial.write(b"all of it")
        assert partial.finish() == 9


@pytest.mark.parametrize("name", twin.HEADS)
def test_the_twins_are_the_same(name):
    """What waits is what ``python -m tomosim.client.twin`` makes."""
    text = twin.twin(name)
    for command in (["check", "--select", "I,F401", "--fix"], ["format"]):
        done = subprocess.run(
            [sys.executable, "-m", "ruff", *command, "--stdin-filename", str(twin.target(name)), "-"],
            input=text,
            capture_output=True,
            text=True,
            check=True,
        )
        text = done.stdout
    assert text == twin.target(name).read_text()


def test_the_client_is_light():
    heavy = ("fastapi", "sqlalchemy", "celery", "numba", "scipy", "uvicorn")
    code = f"import sys, tomosim.client; print(*(m for m in {heavy} if m in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
