"""The uncompressed breast: ``generate(spec, seed)`` grows the phantom that the specification asks for."""

from __future__ import annotations

from importlib import import_module

from simcore.core.artifacts import Phantom
from simcore.core.progress import Progress, silent
from simcore.phantom.spec import PhantomSpec

__all__ = ["generate"]


def generate(spec: PhantomSpec, seed: int, progress: Progress = silent) -> Phantom:
    """Labels (nz, ny, nx) in the breast frame, mm, with a report of what they hold.

    seed: of all random streams, any non-negative integer; the same specification and seed give the same bytes.
    raises: PhantomError where the specification cannot be met; its message says what to change.

    The model of kind ``k`` is the module ``simcore.phantom.k``, loaded when first asked for: whoever only reads
    specifications imports no compiler.
    """
    phantom: Phantom = import_module(f"simcore.phantom.{spec.kind}").generate(spec, seed, progress)
    return phantom
