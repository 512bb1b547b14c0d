"""From a posted study to cases that can be simulated, before anything is kept."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from api.http.deps import Services
from api.http.errors import ApiError, shown
from simcore import estimate, phantom
from simcore.core.errors import ResourceLimitError, SpecError
from simcore.spec import SimulationSpec
from simcore.store.store import Store
from simcore.study import StudySpec
from simcore.study.expansion import Case, expand
from tomosim_contract.studies import StudyEstimate
from worker.records.studies import NewCase

Json = dict[str, Any]

MOST_PROBLEMS = 20
"""Problems that are told of one study."""


@dataclass(frozen=True)
class Checked:
    """A study whose cases can all be simulated."""

    cases: list[NewCase]
    needs: StudyEstimate


def check(study: StudySpec, served: Services) -> Checked:
    """Expands a study and validates and estimates every case.

    raises: ApiError 422 study-too-large; invalid-request or resource-limit, naming the fields and the first case of
    each problem.
    """
    limit = served.settings.study_case_limit
    if study.size > limit:
        counts = f" ({' x '.join(map(str, study.steps))})" if len(study.steps) > 1 else ""
        raise ApiError(
            422,
            "study-too-large",
            f"the study has {study.size} cases{counts}, and {limit} are allowed: take fewer steps, or post "
            "several studies",
            errors=[{"pointer": "/axes", "value": study.size, "detail": f"at most {limit} cases"}],
            cases=study.size,
            allowed=limit,
        )
    problems = _Problems()
    phantoms = _Phantoms(served.store)
    cases = []
    for case in _expand(study):
        try:
            specification = SimulationSpec.from_dict(case.specification)
            phantoms.require(specification)
            needs = estimate.check(specification, served.settings.memory_limit)
        except SpecError as error:
            problems.add(case, error)
            continue
        name = specification.name.replace("\0", "")
        cases.append(NewCase(name, case.coordinates, specification.model_dump(mode="json"), needs.model_dump()))
    problems.refuse()
    return Checked(cases, _sum([case.estimate for case in cases]))


def _expand(study: StudySpec) -> Iterator[Case]:
    try:
        yield from expand(study)
    except SpecError as error:
        errors = [{"pointer": p["pointer"], "value": shown(p["value"]), "detail": p["message"]} for p in error.problems]
        raise ApiError(422, "invalid-request", str(error), errors=errors) from None


def _sum(needs: list[Json]) -> StudyEstimate:
    outputs = sum(n["output_bytes"] for n in needs)
    # What the cases share is not known before: intermediate results count once.
    between = max(n["storage_bytes"] - n["output_bytes"] for n in needs)
    return StudyEstimate(
        cases=len(needs),
        memory_bytes=max(n["memory_bytes"] for n in needs),
        storage_bytes=outputs + max(between, 0),
        output_bytes=outputs,
        seconds=round(sum(n["seconds"] for n in needs), 1),
    )


class _Phantoms:
    """Looks every uploaded phantom up once."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._known: set[str] = set()

    def require(self, specification: SimulationSpec) -> None:
        """raises: SpecError where the phantom is not there, or another one than the specification says"""
        text = specification.phantom.model_dump_json()
        if text not in self._known:
            phantom.require(specification.phantom, self._store)
            self._known.add(text)


class _Problems:
    """What is wrong with the cases: the same problem is told once, with its first case and how many have it."""

    def __init__(self) -> None:
        self._found: dict[tuple[str, str, str], Json] = {}
        self._cases = 0
        self._only_too_much = True

    def add(self, case: Case, error: SpecError) -> None:
        self._cases += 1
        self._only_too_much &= isinstance(error, ResourceLimitError)
        for problem in error.problems or [{"field": "(the whole specification)", "value": None, "message": str(error)}]:
            pointer = _pointer(case, str(problem["field"]))
            value = shown(problem.get("value"))
            key = (pointer, json.dumps(value), problem["message"])
            entry = self._found.setdefault(
                key,
                {
                    "pointer": pointer,
                    "value": value,
                    "detail": problem["message"],
                    "field": problem["field"],
                    "case": case.number,
                    "coordinates": case.coordinates,
                    "cases": 0,
                },
            )
            entry["cases"] += 1

    def refuse(self) -> None:
        """raises: ApiError 422 where anything was found"""
        if not self._found:
            return
        problems = list(self._found.values())[:MOST_PROBLEMS]
        more = len(self._found) - len(problems)
        lines = [_line(entry) for entry in problems[:3]]
        if len(self._found) > len(lines):
            lines.append(f"and {len(self._found) - len(lines)} more problems")
        raise ApiError(
            422,
            "resource-limit" if self._only_too_much else "invalid-request",
            f"{self._cases} {'case' if self._cases == 1 else 'cases'} cannot be simulated: " + "; ".join(lines),
            errors=problems,
            more_problems=more,
        )


def _line(entry: Json) -> str:
    where = f"case {entry['case']}"
    if entry["cases"] > 1:
        where += f" and {entry['cases'] - 1} more"
    value = "" if entry["value"] is None else f" = {entry['value']!r}"
    field = "" if entry["field"].startswith("(") else f"{entry['field']}{value}: "
    return f"{where}: {field}{entry['detail'].removeprefix(field)}"


def _pointer(case: Case, field: str) -> str:
    """Where in the study the wrong field was set: on an axis, or in the base."""
    if field.startswith("("):
        return "/axes"
    for path, source in case.sources.items():
        if field == path or path.startswith(f"{field}."):
            return source
        if field.startswith(f"{path}."):
            return source + field.removeprefix(path).replace(".", "/")
    return "/base/" + field.replace(".", "/")
