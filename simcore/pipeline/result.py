"""A finished case: its manifest, and where each public file lies."""

from __future__ import annotations

import json
import platform
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from simcore import __version__
from simcore.cautions import cautions
from simcore.core.artifacts import Report
from simcore.pipeline.graph import Case, Stage, StageResult
from simcore.store.hashing import FileRef
from simcore.store.store import Store

LIBRARIES = ("numpy", "scipy", "numba", "pydicom", "pytetwild", "scikit-image", "zstandard")


@dataclass
class CaseResult:
    """A finished case: its manifest and where each public file lies in the store."""

    manifest: dict[str, Any]
    files: dict[str, FileRef]
    store: Store

    def write(self, out: Path) -> None:
        """Copies every file of the case and manifest.json below ``out``."""
        for name, ref in self.files.items():
            self.store.materialise(ref, out / name)
        out.mkdir(parents=True, exist_ok=True)
        (out / "manifest.json").write_text(json.dumps(self.manifest, indent=1) + "\n")


def result_of(case: Case, table: Sequence[Stage], seconds: float) -> CaseResult:
    """seconds: from specification to the last file."""
    reports = {r.stage.name: r.record.report for r in case.records}
    public = {name: ref for r in case.records for name, ref in r.record.outputs.items() if r.stage.is_public(name)}
    manifest = {
        "schema": "tomosim-manifest/1",
        "software": {"name": "tomosim", "version": __version__, "libraries": _libraries()},
        "host": {"machine": platform.machine(), "system": platform.system(), "python": sys.version.split()[0]},
        "specification": case.spec.model_dump(mode="json"),
        "seed": case.spec.seed,
        "seconds": round(seconds, 3),
        "computed_stages": sum(not r.cached for r in case.records),
        "stages": [_entry(r) for r in case.records],
        "results": {**_results(table, reports), "cautions": cautions(case.spec, reports)},
        "files": {name: asdict(ref) for name, ref in public.items()},
    }
    return CaseResult(manifest, public, case.store)


def _entry(result: StageResult[Any]) -> dict[str, Any]:
    record = result.record
    return {
        "name": record.stage,
        "version": record.version,
        "key": record.key,
        "cached": result.cached,
        "seconds": record.seconds,
        "peak_memory_bytes": record.peak_memory_bytes,
        "outputs": {name: asdict(ref) for name, ref in record.outputs.items()},
        "report": record.report,
    }


def _results(table: Sequence[Stage], reports: dict[str, Report]) -> Report:
    """The numbers people ask for first."""
    return {
        name: reports[stage.name][name]
        for stage in table
        for name in stage.results
        if name in reports.get(stage.name, {})
    }


def _libraries() -> dict[str, str]:
    """Versions; without those that are not to be had on every platform (simcore.available)."""
    return {name: metadata.version(name) for name in LIBRARIES if any(metadata.distributions(name=name))}
