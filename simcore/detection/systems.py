"""The detectors of named systems, from simcore/detection/data/systems.csv."""

from __future__ import annotations

import csv
import json
from functools import cache
from importlib import resources
from typing import Any

from simcore.core.errors import SpecError
from simcore.detection.spec import DetectionSpec


@cache
def systems() -> tuple[str, ...]:
    """Names of the systems there are detectors of."""
    return tuple(dict.fromkeys(row["system"] for row in _rows()))


def detector_of(system: str) -> DetectionSpec:
    """The detector of a system; what its rows do not name has the default.

    raises: SpecError naming the systems there are.
    """
    if system not in systems():
        raise SpecError(f"no detector of {system!r}; there are those of {', '.join(systems())}")
    data: dict[str, Any] = {}
    for row in _rows():
        if row["system"] == system:
            *parents, last = row["field"].split(".")
            place = data
            for name in parents:
                place = place.setdefault(name, {})
            place[last] = json.loads(row["value"])
    return DetectionSpec.model_validate(data)


@cache
def _rows() -> list[dict[str, str]]:
    with resources.files("simcore.detection.data").joinpath("systems.csv").open(encoding="utf-8") as lines:
        return list(csv.DictReader(lines))
