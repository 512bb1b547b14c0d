"""Stored facts of the cases: how they are read, written and compared with those of a run."""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from simcore import mesh, pipeline
from simcore.core.artifacts import Phantom, TetMesh
from simcore.core.canonical import canonical
from simcore.core.progress import Progress
from simcore.mesh.spec import MeshSpec
from simcore.spec import SimulationSpec
from simcore.store.store import Store
from tests.golden.cases import CASES, brief
from tests.golden.facts import Facts, facts_of

FOLDER = Path(__file__).parent / "references"
MESH = FOLDER / "tetwild.npz"
RECORD = "python -m tests.golden.record"
STAGES = pipeline.stages_of(SimulationSpec())
BEFORE = {"mechanics": STAGES[:3], "preview": STAGES[:6]}
"""What a stage reads, directly or not, where that is not every stage that is listed before it."""


@dataclass(frozen=True)
class Reference:
    """One stage of one case. versions: its own and those of the stages before it, when the facts were taken."""

    versions: dict[str, int]
    facts: Facts


@dataclass(frozen=True)
class Run:
    """A case as it runs now. definition: digest of what the case asks for beyond the defaults."""

    definition: str
    facts: dict[str, Facts]


def run(name: str, store: Store) -> Run:
    """Simulates a case, with the stored mesh instead of fTetWild's."""
    spec = CASES[name](store)
    with stored_mesh():
        facts = facts_of(pipeline.run(spec, store))
    return Run(hashlib.sha256(canonical(brief(spec))).hexdigest(), facts)


@contextlib.contextmanager
def stored_mesh() -> Iterator[None]:
    """fTetWild gives another mesh each time: inside, its mesh is the stored one."""
    build = mesh.build

    def build_or_read(phantom: Phantom, spec: MeshSpec, progress: Progress) -> TetMesh:
        return read_mesh() if spec.kind == "tetwild" else build(phantom, spec, progress)

    with mock.patch.object(mesh, "build", build_or_read):
        yield


def read_mesh() -> TetMesh:
    with np.load(MESH) as arrays:
        whole = {name: arrays[name].astype(np.int64) for name in ("tets", "wall", "skin")}
        return TetMesh(nodes=arrays["nodes"], **whole, report=json.loads(str(arrays["report"])))


def write_mesh(tetrahedra: TetMesh) -> None:
    whole = {name: getattr(tetrahedra, name).astype(np.int32) for name in ("tets", "wall", "skin")}
    np.savez_compressed(MESH, nodes=tetrahedra.nodes, report=json.dumps(tetrahedra.report), **whole)


def versions_of(stage: str) -> dict[str, int]:
    """Versions of a stage and of those before it, as they are now."""
    before = BEFORE.get(stage, STAGES[: STAGES.index(stage)])
    return {name: pipeline.VERSIONS[name] for name in (*before, stage)}


def read(name: str) -> tuple[str, dict[str, Reference]]:
    """(definition, {stage: reference}); nothing where the case was never recorded."""
    path = FOLDER / f"{name}.json"
    if not path.exists():
        return "", {}
    stored = json.loads(path.read_bytes())
    stages = {s: Reference(r["versions"], Facts(**r["facts"])) for s, r in stored["stages"].items()}
    return stored["definition"], stages


def write(name: str, definition: str, stages: dict[str, Reference]) -> None:
    FOLDER.mkdir(exist_ok=True)
    (FOLDER / f"{name}.json").write_text(_text({"definition": definition, "stages": _plain(stages)}))


def _plain(stages: dict[str, Reference]) -> dict[str, Any]:
    return {stage: asdict(reference) for stage, reference in stages.items()}


def _text(stored: dict[str, Any]) -> str:
    """JSON with a line for every fact."""
    lines = [f'{{"definition": {json.dumps(stored["definition"])}, "stages": {{']
    for stage, reference in stored["stages"].items():
        facts = reference["facts"]
        lines.append(f'"{stage}": {{"versions": {json.dumps(reference["versions"])}, "facts": {{')
        for kind in facts:
            entries = [f"{json.dumps(k)}: {json.dumps(v, separators=(',', ':'))}" for k, v in facts[kind].items()]
            lines.append(f'"{kind}": {{\n' + ",\n".join(entries) + "\n}" + ("," if kind != "tolerances" else ""))
        lines.append("}}" + ("," if stage != list(stored["stages"])[-1] else ""))
    return "\n".join([*lines, "}}"]) + "\n"


def differences(reference: Facts, now: Facts) -> list[str]:
    """What is not as it was, one line each."""
    lines = []
    for name in sorted({*reference.exact, *now.exact}):
        before, after = reference.exact.get(name, "nothing"), now.exact.get(name, "nothing")
        if before != after:
            lines.append(f"{name}: {after[:80]} instead of {before[:80]}")
    for name in sorted({*reference.means, *now.means}):
        before_means, means = (np.array(f.means.get(name, [])) for f in (reference, now))
        if before_means.shape != means.shape:
            lines.append(f"{name}: {means.size} means instead of {before_means.size}")
            continue
        off, tolerance = np.abs(means - before_means), reference.tolerances[name]
        if np.any(off > tolerance):
            count = f"{np.count_nonzero(off > tolerance)} of {off.size}"
            lines.append(f"{name}: {count} means are off by more than {tolerance:.3g}, the farthest by {off.max():.3g}")
    return lines


def complaint(stage: str, reference: Reference | None, now: Facts) -> str:
    """What is wrong with a stage and what to do; empty where nothing is."""
    versions = versions_of(stage)
    if reference is None:
        return f"{stage}: nothing is recorded. Run {RECORD}"
    if reference.versions != versions:
        changed = {k: (reference.versions.get(k), v) for k, v in versions.items() if reference.versions.get(k) != v}
        text = ", ".join(f"{k} {before} -> {after}" for k, (before, after) in changed.items())
        return f"{stage}: stage versions have changed since this was recorded ({text}). Run {RECORD}"
    if lines := differences(reference.facts, now):
        return (
            f"{stage}: the result has changed, but no version of this stage or one before it. Where that is meant, "
            f"raise the version of '{stage}' in simcore/pipeline/table.py and run {RECORD}; where not, "
            f"python -m bench.same main shows which bytes differ.\n  " + "\n  ".join(lines)
        )
    return ""
