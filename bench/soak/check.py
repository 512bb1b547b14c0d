"""What must hold after a soak: nothing lost, nothing torn, nothing twice, nobody left."""

from __future__ import annotations

import os
import signal
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from bench.soak.service import marked
from simcore.core.errors import SimulationError
from simcore.spec import SimulationSpec
from simcore.store.hashing import FileRef, file_digest
from simcore.store.records import parsed
from simcore.store.store import Store
from tomosim_contract.names import EVENT_STATE, FINAL_STATES
from worker.records.database import connect, events, simulations
from worker.settings import Settings

ORPHAN_SECONDS = 5.0
"""For so long a process may need to notice that its parent is gone."""

Files = dict[str, str]
"""Digest of every file of a case, by name."""


@dataclass(frozen=True)
class Finding:
    """Something that is wrong. kind: lost, torn, duplicate, orphan, posting."""

    kind: str
    text: str


@dataclass
class Checked:
    """findings: everything that is wrong. attempts: cases by number of attempts."""

    findings: list[Finding] = field(default_factory=list)
    states: dict[str, int] = field(default_factory=dict)
    attempts: dict[int, int] = field(default_factory=dict)


def left_running(marker: str) -> list[Finding]:
    """Processes of a stopped run that are still there; they are killed."""
    deadline = time.monotonic() + ORPHAN_SECONDS
    while (left := list(marked(marker))) and time.monotonic() < deadline:
        time.sleep(0.1)
    for pid, _ in left:
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            continue
    return [Finding("orphan", f"process {pid}: {command}") for pid, command in left]


def reference_files(specs: dict[str, SimulationSpec], folder: Path) -> dict[str, Files | None]:
    """The files of every case as an undisturbed run makes them; None for a case that fails by its own fault."""
    from simcore import pipeline

    store = Store(folder)
    expected: dict[str, Files | None] = {}
    for name, spec in specs.items():
        try:
            manifest = pipeline.run(spec, store, lambda *args, **more: None).manifest
            expected[name] = {file: ref["sha256"] for file, ref in manifest["files"].items()}
        except SimulationError:
            expected[name] = None
    return expected


def check(
    settings: Settings, specs: dict[str, SimulationSpec], expected: dict[str, Files | None], cancelled: set[str]
) -> Checked:
    """Compares database and store with what an undisturbed run makes."""
    checked = Checked()
    engine = connect(settings.resolved_database_url)
    with engine.connect() as connection:
        rows = connection.execute(sa.select(simulations)).mappings().all()
        ends = _ends(connection)
    engine.dispose()
    checked.states = dict(Counter(row["state"] for row in rows))
    checked.attempts = dict(sorted(Counter(row["attempt"] for row in rows).items()))
    by_name: dict[str, list[Any]] = {name: [] for name in specs}
    for row in rows:
        by_name[row["name"]].append(row)
    for name, cases in by_name.items():
        checked.findings += _case(name, cases, expected[name], name in cancelled, ends)
    checked.findings += _store(Store(settings.store_folder), [row["manifest"] for row in rows if row["manifest"]])
    return checked


def _ends(connection: sa.Connection) -> Counter[str]:
    """How often each case reached a final state."""
    query = sa.select(events.c.simulation_id, events.c.data).where(events.c.kind == EVENT_STATE)
    return Counter(row.simulation_id for row in connection.execute(query) if row.data["state"] in FINAL_STATES)


def _case(
    name: str, rows: list[Any], expected: Files | None, may_be_cancelled: bool, ends: Counter[str]
) -> Iterator[Finding]:
    if not rows:
        yield Finding("lost", f"{name} is not in the database")
    if len(rows) > 1:
        yield Finding("duplicate", f"{name} is there {len(rows)} times")
    for row in rows:
        state, error = row["state"], row["error"] or {}
        if ends[row["id"]] > 1:
            yield Finding("duplicate", f"{name} ended {ends[row['id']]} times")
        if state == "succeeded":
            files = {file: ref["sha256"] for file, ref in row["manifest"]["files"].items()}
            if files != expected:
                differ = sorted(f for f in {*files, *(expected or {})} if files.get(f) != (expected or {}).get(f))
                yield Finding("torn", f"{name} has other files than an undisturbed run: {differ}")
        elif state == "failed":
            if expected is not None or error.get("kind") != "simulation":
                yield Finding("lost", f"{name} failed: {error}")
        elif state != "cancelled" or not may_be_cancelled:
            yield Finding("lost", f"{name} is {state} (attempt {row['attempt']}, owner {row['owner']})")


def _store(store: Store, manifests: list[dict[str, Any]]) -> Iterator[Finding]:
    """Every object holds what its name says, and every record and case has all its objects."""
    for path in (store.root / "objects").rglob("*"):
        if path.is_file() and file_digest(path) != path.name:
            yield Finding("torn", f"object {path.name} holds something else")
    refs: dict[str, FileRef] = {}
    for path in (store.root / "stages").rglob("*.json"):
        record = parsed(path.read_bytes())
        if record is None:
            yield Finding("torn", f"record {path.name} cannot be read")
            continue
        refs |= {f"{path.name} {name}": ref for name, ref in record.outputs.items()}
    for number, manifest in enumerate(manifests):
        refs |= {f"manifest {number} {name}": FileRef(**ref) for name, ref in manifest["files"].items()}
    for what, ref in refs.items():
        path = store.path(ref)
        if not path.exists() or path.stat().st_size != ref.size:
            yield Finding("torn", f"{what}: object {ref.sha256} is missing or cut short")
