"""How each kind reconstructs: from the views to the volume as it is stored."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

from simcore.core.artifacts import ProjectionStack, Volume
from simcore.core.progress import Progress
from simcore.reconstruction.body import Body
from simcore.reconstruction.spec import ReconstructionSpec

Method = Callable[[ProjectionStack, ReconstructionSpec, Body, Progress], Volume]

_METHODS = {
    "fbp": ("fbp", "filtered_backprojection"),
    "backprojection": ("unfiltered", "unfiltered_backprojection"),
    "sart": ("algebraic", "algebraic_reconstruction"),
    "sirt": ("algebraic", "algebraic_reconstruction"),
    "ml": ("likelihood", "maximum_likelihood"),
}
"""Module and function of every kind."""


def method_of(spec: ReconstructionSpec) -> Method:
    """The method of the kind of ``spec``. Compiled code is loaded here, not with the specifications."""
    module, function = _METHODS[spec.kind]
    method: Method = getattr(import_module(f"{__name__}.{module}"), function)
    return method
