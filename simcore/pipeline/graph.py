"""What a stage is, and what a case has of its stages: a table of ``Stage`` is the whole pipeline."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from simcore.core.artifacts import Report
from simcore.core.progress import Progress
from simcore.core.progress import silent as no_progress
from simcore.spec import SimulationSpec
from simcore.store import codecs
from simcore.store.hashing import Hashing
from simcore.store.records import Begun, StageRecord
from simcore.store.store import Store

T = TypeVar("T")


class CaseProgress(Protocol):
    """Told of every step: ``fraction`` of the stage in [0, 1]; ``cached`` where nothing had to be computed."""

    def __call__(self, stage: str, fraction: float, message: str, *, cached: bool = False) -> None: ...


def silent(stage: str, fraction: float, message: str, *, cached: bool = False) -> None:
    """No progress."""


@dataclass(frozen=True)
class Source:
    """What the key of a stage takes of another stage.

    by: "digest" of its files; "key" where the files are large and their digest would have to be waited for; or an
        entry of its report, where no more than that matters.
    """

    stage: str
    by: str = "digest"


Inputs = Mapping[str, Source]
"""By the name that the input has in the key of the stage."""


@dataclass(frozen=True)
class Codec(Generic[T]):
    """How an artifact is saved and loaded. load: None where too little is kept; the artifact is computed again then."""

    save: Callable[[Path, T], None]
    load: Callable[[codecs.Locate], T] | None


@dataclass(frozen=True)
class Work:
    """What a stage that writes files itself works with; as the arguments of ``simcore.store.records.Compute``."""

    folder: Path
    hashing: Hashing
    progress: Progress


@dataclass(frozen=True)
class Sizes:
    """What the needs of the stages of a case grow with; see simcore.estimate.

    voxels, compressed_voxels: of the phantom before and after compression. tetrahedra: of the mesh. pixels: of all
    views. ray_seconds: of all rays of the case on two cores. volume: voxels of the volume. worked: voxels that the
    reconstruction computes. output_bytes: of the files a client gets.
    """

    voxels: float
    compressed_voxels: float
    tetrahedra: float
    pixels: float
    ray_seconds: float
    volume: float
    worked: float
    output_bytes: float


@dataclass(frozen=True)
class Needs:
    """seconds: on two cores. stored_bytes: room in the store."""

    seconds: float
    stored_bytes: float = 0.0


@dataclass(frozen=True)
class Stage:
    """One stage of every case; a row of the table.

    version:    raised whenever the stage gives other bytes for the same specification: old results no longer match.
    inputs:     of its key; None where a case has no use for the stage.
    parameters: its own part of the specification, JSON-ready.
    needs:      for the estimate.
    compute, codec: its artifact, and how that is stored.
    write:      instead of these, where the files are what it is for: writes them and returns its report.
    parallel:   whether it starts parallel kernels. numba's threads serve one caller: such stages run one after the
                other, the others on one thread beside them.
    after:      stage whose kernels must be done before this one starts beside the rest: a core is to spare from there.
    stands_in:  stage whose result is taken for this one where a case has no use for it.
    public:     names of the files that a client gets: all, or those listed.
    results:    entries of its report that people ask for first: the columns of a study.
    """

    name: str
    version: int
    inputs: Callable[[SimulationSpec], Inputs | None]
    parameters: Callable[[Case], Any]
    needs: Callable[[SimulationSpec, Sizes], Needs]
    compute: Callable[[Case, Progress], Any] | None = None
    codec: Callable[[SimulationSpec], Codec[Any]] | None = None
    write: Callable[[Case, Work], Report] | None = None
    parallel: bool = True
    after: str | None = None
    stands_in: str | None = None
    public: bool | tuple[str, ...] = False
    results: tuple[str, ...] = ()

    def is_public(self, file: str) -> bool:
        """Whether a client gets this file of the stage."""
        return self.public if isinstance(self.public, bool) else file in self.public


@dataclass
class StageResult(Generic[T]):
    """A stage's record, and its artifact: in memory where it was just computed, else loaded or computed again when
    first asked for."""

    case: Case
    stage: Stage
    key: str
    begun: Future[Begun] = field(default_factory=Future)
    fresh: T | None = None

    @property
    def cached(self) -> bool:
        return self.begun.result().cached

    @property
    def record(self) -> StageRecord:
        """Waits for the digests of large files."""
        return self.begun.result().record.result()

    @cached_property
    def codec(self) -> Codec[T]:
        if self.stage.codec is None:
            raise TypeError(f"the stage {self.stage.name} has files only")
        return self.stage.codec(self.case.spec)

    @property
    def recomputes(self) -> bool:
        """Whether asking for the artifact computes it again."""
        return self.fresh is None and self.codec.load is None

    @cached_property
    def artifact(self) -> T:
        if self.fresh is not None:
            return self.fresh
        if self.codec.load is None:
            return self.compute(no_progress)
        return self.codec.load(lambda name: self.case.store.path(self.record.outputs[name]))

    def compute(self, progress: Progress) -> T:
        """The artifact, computed."""
        if self.stage.compute is None:
            raise TypeError(f"the stage {self.stage.name} has files only")
        artifact: T = self.stage.compute(self.case, progress)
        return artifact

    def by(self, what: str) -> str:
        """What a ``Source`` takes of it."""
        if what == "key":
            return self.key
        return self.record.digest if what == "digest" else str(self.record.report[what])


@dataclass
class Case:
    """A specification, and what its stages have given so far.

    results: by stage; what stands in for a stage is there as well. records: of the stages that ran, in their order.
    """

    spec: SimulationSpec
    store: Store
    results: dict[str, StageResult[Any]] = field(default_factory=dict)
    records: list[StageResult[Any]] = field(default_factory=list)

    def artifact(self, stage: str) -> Any:
        return self.results[stage].artifact

    def report(self, stage: str) -> Report:
        return self.results[stage].record.report
