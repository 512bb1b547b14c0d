"""Every kind of every part of a specification gives what it gave when it was recorded; see README.md."""

from collections.abc import Iterator
from typing import Any, get_args

import numpy as np
import pytest
from pydantic import BaseModel

from simcore import pipeline
from simcore.core.spec_base import Spec
from simcore.dicom.identity import Identifiers
from simcore.spec import SimulationSpec
from simcore.store.store import Store
from simcore.xray import XraySpec
from tests.golden import record, references
from tests.golden.cases import CASES, half_ellipsoid
from tests.golden.facts import block_means, digest

MAX_BYTES = 1_000_000
CHOICES = [("export", "encoding"), ("export", "extra_objects"), ("physics", "sampling"), ("physics", "attenuation")]
"""Fields of which every value is touched."""


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    return Store(tmp_path_factory.mktemp("golden"), min_free_bytes=0)


@pytest.mark.parametrize("name", CASES)
def test_results_are_those_that_were_recorded(name: str, store: Store) -> None:
    now = references.run(name, store)
    definition, stored = references.read(name)
    assert definition == now.definition, f"the case asks for something else: run {references.RECORD} {name}"
    assert list(stored) == list(now.facts), f"the case has other stages: run {references.RECORD} {name}"
    for stage, facts in now.facts.items():  # those after the first that differs differ because of it
        assert (text := references.complaint(stage, stored[stage], facts)) == "", f"{name}, {text}"


def test_a_changed_result_needs_a_raised_version(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    facts = references.run("lattice", store).facts["projection"]
    reference = references.Reference(references.versions_of("projection"), facts)
    assert references.complaint("projection", reference, facts) == ""
    darker = references.Facts(facts.exact, {**facts.means, "pixels": [0.99 * v for v in facts.means["pixels"]]})
    assert "raise the version of 'projection' in simcore/pipeline/table.py" in references.complaint(
        "projection", reference, darker
    )
    lighter = references.Facts({**facts.exact, "pixels: shape": "(5, 1, 1)"}, facts.means)
    assert "pixels: shape: (5, 1, 1) instead of (5, 256, 160)" in references.complaint("projection", reference, lighter)
    monkeypatch.setitem(pipeline.VERSIONS, "warp", pipeline.VERSIONS["warp"] + 1)
    assert references.RECORD in references.complaint("projection", reference, facts)


def test_a_change_without_a_reason_is_not_recorded(
    store: Store, monkeypatch: pytest.MonkeyPatch, tmp_path: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(references, "FOLDER", tmp_path)
    assert record.record("compressed-upload", store, force=False)
    definition, stages = references.read("compressed-upload")
    honest = (tmp_path / "compressed-upload.json").read_bytes()
    stages["projection"].facts.means["pixels"][0] += 1000.0
    references.write("compressed-upload", definition, stages)
    assert not record.record("compressed-upload", store, force=False)
    assert "raise the version of 'projection'" in capsys.readouterr().err
    assert record.record("compressed-upload", store, force=True)
    assert (tmp_path / "compressed-upload.json").read_bytes() == honest


def models(value: Any) -> Iterator[Spec]:
    """A specification and all that stand in it."""
    if isinstance(value, BaseModel):
        yield value  # type: ignore[misc]
        for name in type(value).model_fields:
            yield from models(getattr(value, name))
    elif isinstance(value, list | tuple):
        for item in value:
            yield from models(item)


def kinds(model: type[BaseModel]) -> set[type[BaseModel]]:
    """All models that a specification can hold."""
    models_there: set[type[BaseModel]] = set()

    def walk(annotation: Any) -> None:
        if isinstance(annotation, type) and issubclass(annotation, BaseModel) and annotation not in models_there:
            models_there.add(annotation)
            for item in annotation.model_fields.values():
                walk(item.annotation)
        for part in get_args(annotation):
            walk(part)

    walk(model)
    return models_there


def test_the_cases_touch_every_kind(store: Store) -> None:
    specs = [make(store) for make in CASES.values()]
    touched = {type(m) for spec in specs for m in models(spec)}
    # Cases with X-rays are proved by closed forms and published values (tests/simcore/test_xray.py and its rooms).
    assert {m.__name__ for m in kinds(SimulationSpec) - kinds(XraySpec) - touched} == set()
    for part, name in CHOICES:
        field = type(getattr(specs[0], part)).model_fields[name]
        values = {str(v) for spec in specs for v in np.atleast_1d(getattr(getattr(spec, part), name))}
        assert choices(field.annotation) <= values, f"{part}.{name}"


def choices(annotation: Any) -> set[str]:
    """What a field with listed values, or a list of such, may hold."""
    parts = get_args(annotation)
    return set(parts) if all(isinstance(p, str) for p in parts) else set().union(*map(choices, parts))


def test_references_are_small() -> None:
    assert sum(p.stat().st_size for p in references.FOLDER.iterdir()) < MAX_BYTES


def test_identifiers_of_a_root() -> None:
    ids = Identifiers("0123456789abcdef")
    assert ids.study == "2.25.245442968623127754988250304065226384997"
    assert ids.series("labels") == "2.25.200098230347181368865849476578757952464"
    assert ids.instance("projections", 2) == "2.25.55177189662381512933311628496682269794"


def test_the_uploaded_volume() -> None:
    assert digest(half_ellipsoid()) == "27b9c31830cb5ea9a3f15691f2e4ab0818b31f7d48651364664e548cb8a68da8"


def test_means_of_blocks() -> None:
    assert block_means(np.arange(10.0)).tolist() == [0.5, 2.5, 4.5, 6.5, 8.5]
    assert block_means(np.array([1.0, np.nan, np.inf])).tolist() == [1.0, 0.0, 0.0]
    assert block_means(np.ones((7, 3))).shape == (5, 3)
