"""``tomosim study`` and the client's functions of studies, against the real API in this process."""

import csv
import io
import json
import os
import sys
from pathlib import Path

import anyio
import pytest

from api.app import create_app
from simcore import estimate
from simcore.spec import SimulationSpec
from simcore.store.hashing import FileRef
from simcore.study import StudySpec
from simcore.study.expansion import expand
from tests.support.brokers import SilentBroker
from tests.support.servers import served
from tomosim.cli import main
from tomosim.client import AsyncClient, Client
from worker.settings import Settings

EXAMPLES = sorted((Path(__file__).parents[2] / "tomosim" / "examples").glob("*.json"))
STUDY = {"name": "mine", "axes": [{"kind": "grid", "field": "seed", "values": [1, 2, 3]}]}


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory, module_backend: dict[str, object]):
    """(address, services) of a running API."""
    with pytest.MonkeyPatch.context() as patch:
        for name in [n for n in os.environ if n.startswith("TOMOSIM_")]:
            patch.delenv(name)
        folder = tmp_path_factory.mktemp("data")
        settings = Settings.load(data_folder=folder, memory_limit_bytes=8_000_000_000, **module_backend)
        app = create_app(settings, SilentBroker(), sweep=False)
        with served(app) as address:
            yield address, app.state.services


@pytest.fixture
def study_file(tmp_path):
    path = tmp_path / "study.json"
    path.write_text(json.dumps(STUDY))
    return str(path)


@pytest.fixture
def tomosim(service, capsys):
    """Runs a command of ``tomosim study``: (exit code, standard output, standard error)."""

    def run(*words):
        code = main(["study", *words, "--url", service[0]])
        return code, *capsys.readouterr()

    return run


@pytest.fixture
def submitted(tomosim, study_file, service):
    """(identifier, its cases)"""
    code, out, err = tomosim("submit", study_file)
    assert (code, err) == (0, "tomosim: 3 cases queued\n")
    assert out.startswith(f"{service[0]}/v1/studies/")
    identifier = out.strip().rsplit("/", 1)[1]
    return identifier, service[1].studies.cases(identifier)


def succeed(service, case, tmp_path):
    jobs, store = service[1].jobs, service[1].store
    refs = {}
    for name in ("volume.dcm", "preview/phantom.png"):
        path = tmp_path / "made"
        path.write_bytes(f"{name} of {case.study_number}".encode())
        ref: FileRef = store.add(path)
        refs[name] = {"sha256": ref.sha256, "size": ref.size}
    assert jobs.claim(case.id, "test")
    assert jobs.succeed(case.id, "test", {"files": refs, "results": {"force_N": 100.0}, "stages": []})


def fail(service, case):
    assert service[1].jobs.claim(case.id, "test")
    error = {"kind": "simulation", "code": "solver-failed", "message": "use less compression"}
    assert service[1].jobs.fail(case.id, "test", error)


def files_below(folder):
    return {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}


def test_from_submission_to_files(tomosim, submitted, service, tmp_path):
    identifier, (one, two, three) = submitted
    succeed(service, one, tmp_path)
    fail(service, two)
    assert tomosim("status", identifier)[:2] == (0, "running: 1 queued, 1 succeeded, 1 failed\n")
    assert f"{identifier}  running        2/3     mine" in tomosim("list")[1]
    _, out, _ = tomosim("cases", identifier, "--state", "failed")
    assert out.split() == ["2", two.id, "failed", "seed", "=", "2", "use", "less", "compression"]

    code, _, err = tomosim("download", identifier, "--out", str(tmp_path / "out"))
    assert (code, err) == (0, f"4 files in {tmp_path / 'out'}, 0 of them were there\n")
    one_case = {"case-0001/volume.dcm", "case-0001/preview/phantom.png", "case-0001/manifest.json"}
    assert files_below(tmp_path / "out") == one_case | {"cases.csv"}
    assert (tmp_path / "out" / "case-0001" / "volume.dcm").read_text() == "volume.dcm of 1"

    assert tomosim("retry", identifier)[:2] == (0, "running: 2 queued, 1 succeeded\n")
    succeed(service, two, tmp_path)
    succeed(service, three, tmp_path)
    code, out, err = tomosim("status", identifier, "--wait")
    assert (code, out) == (0, "succeeded: 3 succeeded\n")
    _, _, err = tomosim("download", identifier, "--out", str(tmp_path / "out"), "--only", "dicom")
    assert err.endswith("1 of them were there\n")
    assert "case-0003/volume.dcm" in files_below(tmp_path / "out")
    assert "case-0003/preview/phantom.png" not in files_below(tmp_path / "out")
    rows = list(csv.DictReader(io.StringIO(tomosim("cases", identifier, "--csv")[1])))
    assert [row["force_N"] for row in rows] == ["100.0"] * 3
    assert tomosim("delete", identifier)[0] == 0
    code, _, err = tomosim("status", identifier)
    assert code != 0
    assert "there is no study" in err


def test_exit_code_where_some_failed(tomosim, submitted, service):
    identifier, cases = submitted
    fail(service, cases[0])
    assert tomosim("cancel", identifier)[:2] == (0, "failed: 1 failed, 2 cancelled\n")
    assert tomosim("status", identifier, "--wait")[:2] == (3, "failed: 1 failed, 2 cancelled\n")
    assert tomosim("status", identifier)[0] == 0
    code, _, err = tomosim("delete", "nonsense")
    assert code != 0
    assert "there is no study nonsense" in err


def test_estimate(tomosim, study_file):
    needs = json.loads(tomosim("estimate", study_file)[1])
    assert needs["cases"] == 3


def test_what_is_wrong_is_told(tomosim, tmp_path, monkeypatch):
    code, _, err = tomosim("submit", str(tmp_path / "none.json"))
    assert (code, "cannot be read: No such file" in err) == (2, True)
    stdin = io.TextIOWrapper(io.BytesIO(b'{"axes": [{"kind": "grid", "field": "seed", "values": [-1]}]}'))
    monkeypatch.setattr(sys, "stdin", stdin)
    code, out, err = tomosim("submit", "-")
    assert (code, out) == (2, "")
    assert "case 1: seed = -1" in err
    assert "Traceback" not in err


def test_from_asynchronous_programs(service, tmp_path):
    async def run():
        async with AsyncClient(service[0]) as client:
            resource = await client.submit_study(StudySpec.parse(json.dumps(STUDY)), idempotency_key="async")
            again = await client.submit_study(StudySpec.parse(json.dumps(STUDY)), idempotency_key="async")
            cases = [case async for case in client.study_cases(resource.id, page_size=2)]
            with pytest.raises(TimeoutError):
                await client.wait_for_study(resource.id, timeout_seconds=0.05)
            await client.cancel_study(resource.id)
            ended = await client.wait_for_study(resource.id)
            files = [file.name async for file in client.download_study(resource.id, tmp_path)]
            return resource, again, cases, ended, files

    resource, again, cases, ended, files = anyio.run(run)
    assert again.id == resource.id
    assert [case.number for case in cases] == [1, 2, 3]
    assert (ended.state, files) == ("cancelled", ["cases.csv"])


def test_studies_from_python(service):
    with Client(service[0]) as client:
        resource = client.submit_study(STUDY)
        assert client.estimate_study(STUDY).cases == 3
        assert resource.id in [study.id for study in client.studies(page_size=1)]
        client.cancel_study(resource.id)
        assert client.retry_study(resource.id, cancelled=True).counts["queued"] == 3


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_the_examples_can_be_simulated(path):
    study = StudySpec.parse(path.read_bytes())
    for case in expand(study):
        estimate.check(SimulationSpec.from_dict(case.specification), 8_000_000_000)
    assert study.size == {"angles": 9, "lesion_pairs": 20}[path.stem]
