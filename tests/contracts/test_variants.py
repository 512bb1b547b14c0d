"""A new variant is one file and one line in its family's union: a forgotten line is found here."""

import importlib
import inspect
import pkgutil
from typing import get_args

import pytest

from simcore.core.spec_base import Spec
from simcore.fem.laws import MaterialSpec
from simcore.mesh.spec import MeshSpec
from simcore.phantom.lesions import LesionSpec
from simcore.phantom.spec import PhantomSpec
from simcore.reconstruction.methods import method_of
from simcore.reconstruction.spec import ReconstructionSpec

FAMILIES = {
    "simcore.phantom": PhantomSpec,
    "simcore.phantom.lesions": LesionSpec,
    "simcore.mesh": MeshSpec,
    "simcore.fem": MaterialSpec,
    "simcore.reconstruction": ReconstructionSpec,
}


def members(union) -> set[type[Spec]]:
    """The classes of Annotated[A | B, ...] or Annotated[A, ...]."""
    inner = get_args(union)[0]
    return set(get_args(inner)) or {inner}


def family(module: str) -> str:
    """The innermost family that a module belongs to."""
    return max((f for f in FAMILIES if (module + ".").startswith(f + ".")), key=len)


def variants(package: str) -> set[type[Spec]]:
    """All specifications with a ``kind`` that are defined below the package and in no family inside it."""
    root = importlib.import_module(package)
    classes = set()
    for info in pkgutil.walk_packages(root.__path__, package + "."):
        if info.name.endswith("_child"):
            continue
        for _, cls in inspect.getmembers(importlib.import_module(info.name), inspect.isclass):
            own = cls.__module__.startswith(package + ".") and family(cls.__module__) == package
            if own and issubclass(cls, Spec) and "kind" in cls.model_fields:
                classes.add(cls)
    return classes


@pytest.mark.parametrize("package", FAMILIES)
def test_every_variant_is_in_its_union_and_has_an_example(package: str):
    union = members(FAMILIES[package])
    assert variants(package) == union
    for cls in union:
        example = cls.example()
        assert cls.model_validate_json(example.model_dump_json()) == example
    kinds = [cls.model_fields["kind"].default for cls in union]
    assert len(set(kinds)) == len(kinds)


def test_every_reconstruction_has_a_method():
    for cls in members(ReconstructionSpec):
        assert callable(method_of(cls.example()))
