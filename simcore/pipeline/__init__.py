"""One case from specification to DICOM: the stages of ``table`` in order, each computed once and kept in the store.

    phantom -> mesh -> fem -> warp -> projection [-> transport -> detection] -> reconstruction -> dicom
        -> mechanics -> preview

A second run of the same specification computes nothing; a run after a kill continues after the last whole stage;
a sweep over acquisitions grows and compresses its phantom once.
"""

from __future__ import annotations

import time

from simcore import available, phantom, unused
from simcore.pipeline.graph import Case, CaseProgress, silent
from simcore.pipeline.result import CaseResult, result_of
from simcore.pipeline.scheduler import Scheduler
from simcore.pipeline.table import TABLE
from simcore.spec import SimulationSpec
from simcore.store.records import Commits
from simcore.store.store import Store

__all__ = ["STAGES", "TABLE", "VERSIONS", "CaseResult", "run", "stages_of"]

STAGES = tuple(stage.name for stage in TABLE)
VERSIONS = {stage.name: stage.version for stage in TABLE}


def stages_of(spec: SimulationSpec) -> tuple[str, ...]:
    """The stages that a case has, in their order."""
    return tuple(stage.name for stage in TABLE if stage.inputs(spec) is not None)


def run(spec: SimulationSpec, store: Store, progress: CaseProgress = silent) -> CaseResult:
    """Simulates one case.

    raises: SimulationError (its message says what to change); whatever was computed before stays in the store.
    """
    unused.refuse(spec)
    available.refuse(spec)
    start = time.perf_counter()
    phantom.require(spec.phantom, store)
    case = Case(spec, store)
    with Commits() as later:
        Scheduler(TABLE, case, progress, later).run()
    return result_of(case, TABLE, time.perf_counter() - start)
