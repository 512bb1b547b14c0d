"""A study as a table: CSV for spreadsheets."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from typing import Any, Literal

from api.studies.resources import case_resource
from worker.records.jobs import Simulation
from worker.records.studies import Study

_BEGINS_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def preferred(accept: str | None) -> Literal["json", "csv"]:
    """What an Accept header asks for: CSV where it is named and JSON is not preferred to it."""
    quality = {"application/json": 0.0, "text/csv": 0.0}
    for item in (accept or "").split(","):
        name, *parameters = (part.strip().lower() for part in item.split(";"))
        if name in quality:
            quality[name] = _quality(parameters)
    return "csv" if quality["text/csv"] > quality["application/json"] else "json"


def _quality(parameters: Sequence[str]) -> float:
    for parameter in parameters:
        if parameter.startswith("q="):
            try:
                return float(parameter[2:])
            except ValueError:
                return 0.0
    return 1.0


def csv_table(study: Study, cases: Sequence[Simulation], now: float) -> str:
    """One line a case: number, name, identifier, state, coordinates, results, failure (RFC 4180, UTF-8), at a time.

    A text that a spreadsheet would take for a formula gets an apostrophe in front.
    """
    results = [_flat(case.results or {}) for case in cases]
    columns = list(dict.fromkeys(name for result in results for name in result))
    target = io.StringIO()
    writer = csv.writer(target)
    times = ["started_at", "finished_at"]
    writer.writerow(
        map(
            _cell,
            [
                *("number", "name", "id", "state", *study.columns, *columns, "attempt", *times, "error_code", "error"),
                "expired",
            ],
        )
    )
    for case, result in zip(cases, results, strict=True):
        shown = case_resource(case, now)
        coordinates = [shown.coordinates.get(column) for column in study.columns]
        error = ["", ""] if shown.error is None else [shown.error.code, shown.error.message]
        when = [at.isoformat() if at else "" for at in (shown.started_at, shown.finished_at)]
        cells = [shown.number, shown.name, shown.id, shown.state, *coordinates]
        cells += [*(result.get(column) for column in columns), shown.attempt, *when, *error, shown.expired]
        writer.writerow(map(_cell, cells))
    return target.getvalue()


def _flat(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """{"a": {"b": 1}} as {"a.b": 1}."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        flat |= _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value}
    return flat


def _cell(value: Any) -> Any:
    if value is None:
        return ""
    if isinstance(value, bool | list | dict):
        return json.dumps(value)
    if isinstance(value, str) and value.startswith(_BEGINS_FORMULA):
        return f"'{value}"
    return value
