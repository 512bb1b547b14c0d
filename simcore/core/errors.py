"""The one tree of exceptions. Every message says what is wrong, which value, and what is allowed or to change.

kind      whose fault, and so what a service does with it:
          ``user`` (the specification must change), ``simulation`` (the numerics failed: advice in the message),
          ``system`` (disk, memory, a crash: the same specification may succeed later).
code      stable, machine-readable, never reworded.
"""

from __future__ import annotations

from typing import Any, ClassVar, Literal

ErrorKind = Literal["user", "simulation", "system"]


class SimulationError(Exception):
    """Base of all errors that tomosim raises on purpose."""

    kind: ClassVar[ErrorKind] = "simulation"
    code: str = "simulation-failed"

    def __init__(self, message: str, *, code: str | None = None) -> None:
        super().__init__(message)
        if code is not None:
            self.code = code

    def to_dict(self) -> dict[str, Any]:
        return {"kind": self.kind, "code": self.code, "message": str(self)}


class SpecError(SimulationError):
    """The specification is wrong. ``problems`` lists {field, value, message}; field is a dotted path."""

    kind = "user"
    code = "invalid-specification"

    def __init__(self, message: str, *, code: str | None = None, problems: list[dict[str, Any]] | None = None) -> None:
        super().__init__(message, code=code)
        self.problems = problems or []

    def to_dict(self) -> dict[str, Any]:
        return {**super().to_dict(), "problems": self.problems}


class ResourceLimitError(SpecError):
    """The specification is well formed but asks for more than is allowed (message: needed against allowed)."""

    code = "resource-limit"


class PhantomError(SimulationError):
    """The phantom could not be grown as asked (volume, glandularity, number of compartments)."""

    code = "phantom-failed"


class MeshError(SimulationError):
    """No usable tetrahedral mesh."""

    code = "mesh-failed"


class MeshMemoryError(MeshError):
    """The mesher needed more memory than it may use."""

    kind = "system"
    code = "out-of-memory"


class SolverError(SimulationError):
    """The compression did not converge; the message says what to change."""

    code = "solver-failed"


class GeometryError(SimulationError):
    """A projection or reconstruction geometry that cannot be served."""

    kind = "user"
    code = "geometry-not-supported"


class ExportError(SimulationError):
    """DICOM files could not be written as asked."""

    code = "export-failed"


class StoreError(SimulationError):
    """The stage store is damaged, full or not writable."""

    kind = "system"
    code = "store-failed"


class Cancelled(SimulationError):
    """Raised out of a progress callback to stop a stage."""

    code = "cancelled"
