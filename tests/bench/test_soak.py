"""The soak in short, and that it sees what it is there to see."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from bench.soak import check as checks
from bench.soak.check import Finding, check, left_running
from bench.soak.run import must_fail, soak, specification
from bench.soak.service import MARKER
from simcore.store.hashing import Hashing
from simcore.store.store import Store
from worker.records import schema
from worker.records.database import connect
from worker.records.jobs import Jobs
from worker.settings import Settings


@pytest.fixture(autouse=True)
def _no_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [n for n in os.environ if n.startswith("TOMOSIM_")]:
        monkeypatch.delenv(name)


def test_nothing_is_lost(tmp_path: Path) -> None:
    result, findings = soak(tmp_path, cases=20, seconds=10.0, pause=1.0, seed=1)
    assert findings == []
    assert (result["lost"], result["torn"], result["duplicates"], result["orphans"]) == (0, 0, 0, 0)
    assert result["kills"] >= 5
    assert result["states"]["failed"] == 1
    assert sum(result["states"].values()) == 20


class Aftermath:
    """A data folder as a soak could leave it: three cases with one file each."""

    def __init__(self, folder: Path) -> None:
        self.settings = Settings.load(data_folder=folder)
        self.store = Store(self.settings.store_folder)
        self.engine = connect(self.settings.resolved_database_url)
        schema.prepare(self.engine)
        self.jobs = Jobs(self.engine)
        self.specs = {f"soak-{n:03d}": specification(n) for n in range(3)}
        self.manifests = {name: self.manifest(name) for name in self.specs}
        self.expected: dict[str, checks.Files | None] = {
            name: {"file": m["files"]["file"]["sha256"]} for name, m in self.manifests.items()
        }
        self.ids = {name: self.jobs.create({}, {}, name).id for name in self.specs}

    def manifest(self, content: str) -> dict:
        def compute(folder: Path, key: str, hashing: Hashing) -> tuple[dict, float, int]:
            (folder / "file").write_text(content)
            return {}, 0.0, 0

        record, _ = self.store.run("stage", 1, content, {}, compute)
        return {"files": {"file": vars(record.outputs["file"])}}

    def succeed(self, name: str, manifest: dict | None = None) -> None:
        self.jobs.claim(self.ids[name], "me")
        self.jobs.succeed(self.ids[name], "me", manifest or self.manifests[name])

    def fail(self, name: str, kind: str) -> None:
        self.jobs.claim(self.ids[name], "me")
        self.jobs.fail(self.ids[name], "me", {"kind": kind, "code": "x", "message": "y"})

    def findings(self, cancelled: set[str] = frozenset()) -> list[str]:  # type: ignore[assignment]
        return [f.kind for f in check(self.settings, self.specs, self.expected, cancelled).findings]


@pytest.fixture
def after(tmp_path: Path) -> Aftermath:
    aftermath = Aftermath(tmp_path / "data")
    for name in ("soak-000", "soak-001"):
        aftermath.succeed(name)
    return aftermath


def test_all_is_well(after: Aftermath) -> None:
    after.succeed("soak-002")
    assert after.findings() == []


def test_a_case_that_has_not_ended_is_lost(after: Aftermath) -> None:
    assert after.findings() == ["lost"]


def test_a_failure_counts_unless_it_is_the_cases_own(after: Aftermath) -> None:
    after.fail("soak-002", "simulation")
    assert after.findings() == ["lost"]  # an undisturbed run succeeds
    after.expected["soak-002"] = None
    assert after.findings() == []


def test_a_failure_of_the_system_always_counts(after: Aftermath) -> None:
    after.fail("soak-002", "system")
    after.expected["soak-002"] = None
    assert after.findings() == ["lost"]


def test_cancelled_only_where_it_was_asked(after: Aftermath) -> None:
    after.jobs.cancel(after.ids["soak-002"])
    assert after.findings() == ["lost"]
    assert after.findings({"soak-002"}) == []


def test_two_rows_or_two_ends_are_duplicates(after: Aftermath) -> None:
    after.succeed("soak-002")
    after.ids["soak-002"] = after.jobs.create({}, {}, "soak-002").id
    after.succeed("soak-002")
    assert after.findings() == ["duplicate"]


def test_ended_twice_is_a_duplicate(after: Aftermath) -> None:
    after.jobs.cancel(after.ids["soak-002"])
    after.jobs.retry(after.ids["soak-002"])
    after.succeed("soak-002")
    assert after.findings() == ["duplicate"]


def test_other_files_than_undisturbed(after: Aftermath) -> None:
    after.succeed("soak-002", after.manifests["soak-001"])
    assert after.findings() == ["torn"]


def test_torn_and_missing_objects_are_seen(after: Aftermath) -> None:
    after.succeed("soak-002")
    objects = sorted(p for p in (after.store.root / "objects").rglob("*") if p.is_file())
    objects[0].chmod(0o644)
    objects[0].write_text("x" * objects[0].stat().st_size)
    assert after.findings() == ["torn"]
    objects[1].unlink()
    assert set(after.findings()) == {"torn"}
    assert len(after.findings()) == 3  # its content, its record, its case


def test_an_orphan_is_seen_and_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "ORPHAN_SECONDS", 0.2)
    orphan = subprocess.Popen(
        [sys.executable, "-c", "import time; print(flush=True); time.sleep(60)"],
        env={**os.environ, MARKER: "a-test"},
        stdout=subprocess.PIPE,
    )
    orphan.stdout.readline()
    (finding,) = left_running("a-test")
    assert finding == Finding("orphan", finding.text)
    assert str(orphan.pid) in finding.text
    assert orphan.wait(10) == -9


def test_the_long_soak_has_cases_that_fail() -> None:
    assert sum(must_fail(number) for number in range(200)) == 10
