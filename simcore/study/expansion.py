"""From a study to its cases."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

from simcore.core.errors import SpecError
from simcore.core.rng import stream
from simcore.spec import SimulationSpec
from simcore.study.spec import (
    PAIR,
    Axis,
    GridAxis,
    LesionPairAxis,
    ListAxis,
    RandomAxis,
    StudySpec,
    dotted,
    label_columns,
)

Json = Any


@dataclass(frozen=True)
class Case:
    """One case of a study.

    number: from 1. coordinates: {column: value or label}. specification: JSON data, not validated.
    sources: {field: JSON pointer into the study of what set it}.
    """

    number: int
    name: str
    coordinates: dict[str, Json]
    specification: dict[str, Json]
    sources: dict[str, str]


@dataclass(frozen=True)
class _Step:
    """One step along an axis."""

    values: dict[str, Json]
    coordinates: dict[str, Json]
    sources: dict[str, str]


def columns(study: StudySpec) -> list[str]:
    """The columns of the coordinates of its cases."""
    return list(dict.fromkeys(c for axis in study.axes for step in _steps(axis, 0) for c in step.coordinates))


def expand(study: StudySpec) -> Iterator[Case]:
    """Its cases in order: every combination of steps, the last axis changing fastest.

    raises: SpecError where a field of an axis leads through something that has no fields.
    """
    defaults = _defaults(study.base)
    axes = [_steps(axis, number) for number, axis in enumerate(study.axes)]
    base = json.dumps(study.base)
    for number, combination in enumerate(itertools.product(*axes), start=1):
        specification: dict[str, Json] = json.loads(base)  # a copy; deepcopy takes ten times as long
        specification["name"] = _name(study, number)
        coordinates: dict[str, Json] = {}
        sources: dict[str, str] = {}
        for step in combination:
            coordinates |= step.coordinates
            sources |= step.sources
            for field, value in step.values.items():
                _set(specification, field, value, defaults, step.sources[field])
        yield Case(number, str(specification["name"]), coordinates, specification, sources)


def _name(study: StudySpec, number: int) -> str:
    prefix = study.name or str(study.base.get("name") or "case")[:48]
    return f"{prefix} {number:04d}"


def _steps(axis: Axis, number: int) -> list[_Step]:
    where = f"/axes/{number}"
    match axis:
        case GridAxis():
            (field,) = axis.fields
            return [
                _labelled(axis, k, {field: value}, {field: f"{where}/values/{k}"})
                for k, value in enumerate(axis.values)
            ]
        case ListAxis():
            return [
                _labelled(
                    axis,
                    k,
                    {dotted(key): value for key, value in point.items()},
                    {dotted(key): f"{where}/points/{k}/{_escaped(key)}" for key in point},
                )
                for k, point in enumerate(axis.points)
            ]
        case RandomAxis():
            return _drawn(axis, where)
        case LesionPairAxis():
            lesions = [lesion.model_dump(mode="json") for lesion in axis.lesions]
            source = {"phantom.lesions": f"{where}/lesions"}
            return [
                _Step({"phantom.lesions": objects}, {axis.name: label}, source)
                for label, objects in zip(PAIR, ([], lesions), strict=True)
            ]


def _labelled(axis: GridAxis | ListAxis, k: int, values: dict[str, Json], sources: dict[str, str]) -> _Step:
    """A step whose coordinates are its label and its values; lists and objects only where they have no label."""
    coordinates = values
    if axis.labels is not None:
        plain = {field: value for field, value in values.items() if not isinstance(value, list | dict)}
        coordinates = {label_columns(axis)[0]: axis.labels[k], **plain}
    return _Step(values, coordinates, sources)


def _drawn(axis: RandomAxis, where: str) -> list[_Step]:
    # A stream a field: another field changes no draw of this one.
    drawn = {}
    for key, distribution in axis.draws.items():
        random = stream(axis.seed, "study", dotted(key))
        drawn[dotted(key)] = [distribution.draw(random) for _ in range(axis.count)]
    sources = {dotted(key): f"{where}/draws/{_escaped(key)}" for key in axis.draws}
    values = ({field: column[k] for field, column in drawn.items()} for k in range(axis.count))
    return [_Step(v, v, sources) for v in values]


def _escaped(key: str) -> str:
    return key.replace("~", "~0").replace("/", "~1")


def _defaults(base: dict[str, Json]) -> dict[str, Json]:
    """The base with its defaults; those of no base where it alone is not a valid specification."""
    try:
        return SimulationSpec.from_dict(base).model_dump(mode="json")
    except SpecError:
        return SimulationSpec().model_dump(mode="json")


def _set(specification: dict[str, Json], field: str, value: Json, defaults: Json, source: str) -> None:
    """Sets a field; objects on the way that are missing are made, with the kind that is their default."""
    *way, last = field.split(".")
    at: Json = specification
    for depth, step in enumerate(way):
        defaults = _below(defaults, step)
        if isinstance(at, dict) and at.get(step) is None:
            at[step] = {"kind": defaults["kind"]} if isinstance(defaults, dict) and "kind" in defaults else {}
        at = _enter(at, step, ".".join(way[: depth + 1]), source)
    if isinstance(at, list):
        _enter(at, last, field, source)
        at[int(last)] = deepcopy(value)
    elif isinstance(at, dict):
        at[last] = deepcopy(value)
    else:
        raise _no_way(field, at, source)


def _below(defaults: Json, step: str) -> Json:
    return defaults.get(step) if isinstance(defaults, dict) else None


def _enter(at: Json, step: str, path: str, source: str) -> Json:
    if isinstance(at, dict):
        return at[step]
    if isinstance(at, list):
        if step.isascii() and step.isdigit() and int(step) < len(at):
            return at[int(step)]
        problem = f"{path}: the list in the base has {len(at)} entries, numbered from 0"
        raise SpecError(problem, problems=[{"field": path, "pointer": source, "value": step, "message": problem}])
    raise _no_way(path, at, source)


def _no_way(path: str, at: Json, source: str) -> SpecError:
    message = f"{path} cannot be set: what holds it is {json.dumps(at)[:100]} in the base, which has no fields"
    return SpecError(message, problems=[{"field": path, "pointer": source, "value": None, "message": message}])
