"""Every library that the code imports is a dependency of the extra that its room belongs to."""

import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import grimp
import pytest

from simcore.missing import EXTRAS

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
HOUSES = ("simcore", "tomosim_contract", "worker", "api", "tomosim")
WITH_ANOTHER = {"starlette": "fastapi", "llvmlite": "numba", "botocore": "boto3"}
"""Modules that come with a library whose version fits."""


def requirements(names: list[str]) -> set[str]:
    """Normalised names of what some requirements ask for, those of our own extras included."""
    packages: set[str] = set()
    for requirement in names:
        match = re.match(r"([A-Za-z0-9_.-]+)(?:\[([a-z0-9,]+)\])?", requirement)
        assert match is not None
        if match[1] == PROJECT["name"]:
            for extra in match[2].split(","):
                packages |= requirements(PROJECT["optional-dependencies"][extra])
        else:
            packages.add(re.sub(r"[-_.]+", "-", match[1]).lower())
    return packages


BASE = requirements(PROJECT["dependencies"])
OF_EXTRA = {name: requirements(of) for name, of in PROJECT["optional-dependencies"].items()}
GRAPH = grimp.build_graph(*HOUSES, include_external_packages=True)
DISTRIBUTIONS = packages_distributions()


def imported(prefixes: tuple[str, ...]) -> set[str]:
    """Modules of others that the modules below some packages import."""
    rooms = [m for m in GRAPH.modules if m.startswith(prefixes) and not GRAPH.is_module_squashed(m)]
    others = {other for m in rooms for other in GRAPH.find_modules_directly_imported_by(m)}
    return {m for m in others if GRAPH.is_module_squashed(m)} - sys.stdlib_module_names


def distribution(module: str) -> str:
    known = DISTRIBUTIONS.get(WITH_ANOTHER.get(module, module), [module])
    return re.sub(r"[-_.]+", "-", known[0]).lower()


@pytest.mark.parametrize(
    ("rooms", "extras"),
    [
        (("tomosim.client", "tomosim_contract", "tomosim.console"), ()),
        (("simcore",), ("sim", "s3")),
        (("tomosim.",), ("sim", "service")),
        (("api", "worker"), ("service", "postgres", "s3")),
    ],
)
def test_what_a_room_imports_is_among_its_dependencies(rooms: tuple[str, ...], extras: tuple[str, ...]) -> None:
    allowed = BASE.union(*(OF_EXTRA[extra] for extra in extras))
    assert {m: d for m in imported(rooms) if (d := distribution(m)) not in allowed} == {}


def test_what_is_said_of_a_missing_module_names_the_extra_that_has_it() -> None:
    of_module = {module: extra for extra, modules in EXTRAS.items() for module in modules}
    for module in imported(HOUSES):
        if (name := distribution(module)) not in BASE:
            assert name in OF_EXTRA[of_module[module]], module


def test_the_version_stands_in_one_place() -> None:
    assert "version" in PROJECT["dynamic"]
    assert "version" not in PROJECT
