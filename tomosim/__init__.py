"""Simulation of digital breast tomosynthesis: the command ``tomosim``, the client of its service, the specification.

    from tomosim import Client, SimulationSpec, presets

Needs no numerics and nothing of the service; names are loaded when they are first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from tomosim import own

if TYPE_CHECKING:
    from simcore import __version__, presets
    from simcore.core.errors import SimulationError, SpecError
    from simcore.spec import SimulationSpec
    from simcore.study.spec import StudySpec
    from tomosim.client import AsyncClient, Client, ServiceError

__all__ = [
    "AsyncClient",
    "Client",
    "ServiceError",
    "SimulationError",
    "SimulationSpec",
    "SpecError",
    "StudySpec",
    "__version__",
    "presets",
]

_PLACES = {
    "AsyncClient": "tomosim.client",
    "Client": "tomosim.client",
    "ServiceError": "tomosim.client",
    "SimulationError": "simcore.core.errors",
    "SimulationSpec": "simcore.spec",
    "SpecError": "simcore.core.errors",
    "StudySpec": "simcore.study.spec",
    "__version__": "simcore",
}


def __getattr__(name: str) -> Any:
    """A public name, from where it lies."""
    if name not in __all__:
        raise AttributeError(f"module 'tomosim' has no attribute {name!r}")
    own.refuse_foreign()
    if name == "presets":
        return import_module("simcore.presets")
    return getattr(import_module(_PLACES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
