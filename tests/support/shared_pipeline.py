"""A pipeline whose first stages are shared by cases of one seed, for tests of studies.

Every computation of a stage adds a line "stage seed process begun|done" to the file that SHARED_PIPELINE_LOG names.
"""

import os
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from simcore.store.store import Store

STAGES = ("phantom", "mesh", "fem", "projection")
SHARED = STAGES[:3]
SECONDS = {"phantom": 1.0, "projection": 0.2}


@dataclass
class Result:
    manifest: dict[str, Any]


def run(spec: Any, store: Store, progress: Any) -> Result:
    inputs: dict[str, str] = {}
    stages = []
    for stage in STAGES:
        progress(stage, 0.0, "started")
        parameters = {"seed": spec.seed} if stage in SHARED else {"views": spec.acquisition.views}
        record, cached = store.run(
            stage, 1, parameters, inputs, lambda folder, key, hashing, s=stage: _compute(s, spec.seed, folder)
        )
        progress(stage, 1.0, "done", cached=cached)
        inputs = {stage: record.digest}
        stages.append({"name": stage, "key": record.key, "cached": cached, "outputs": {}})
    files = {name: asdict(ref) for name, ref in record.outputs.items()}
    return Result({"stages": stages, "files": files, "results": {}})


def _compute(stage: str, seed: int, folder: Path) -> tuple[dict[str, Any], float, int]:
    _log(stage, seed, "begun")
    time.sleep(SECONDS.get(stage, 0.0))
    (folder / f"{stage}.txt").write_text(f"{stage} of {seed}, made by {os.getpid()}")
    _log(stage, seed, "done")
    return {}, 0.0, 0


def _log(stage: str, seed: int, what: str) -> None:
    with open(os.environ["SHARED_PIPELINE_LOG"], "a") as f:
        f.write(f"{stage} {seed} {os.getpid()} {what}\n")
