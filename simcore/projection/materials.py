"""Attenuation coefficients of the tissues, from the tables in simcore/data (sources: simcore/data/SOURCES.md)."""

from __future__ import annotations

import csv
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import frozen
from simcore.core.tissues import MAX_TISSUES, Tissue


def attenuation_table(name: str) -> NDArray[np.float64]:
    """Linear attenuation coefficient of every label.

    name: a table of simcore/data, e.g. "johns-yaffe-20keV".
    returns: float64 (MAX_TISSUES,), 1/mm, read-only; 0 for labels without a tissue.
    raises: ValueError where the table is unknown, leaves a tissue out or names one twice.
    """
    file = resources.files("simcore.data").joinpath(f"attenuation-{name}.csv")
    if not file.is_file():
        known = sorted(
            entry.name.removeprefix("attenuation-").removesuffix(".csv")
            for entry in resources.files("simcore.data").iterdir()
            if entry.name.startswith("attenuation-")
        )
        raise ValueError(f"no attenuation table {name!r}; there are {', '.join(known)}")
    table = np.zeros(MAX_TISSUES)
    seen: list[Tissue] = []
    with file.open(encoding="utf-8") as lines:
        for row in csv.DictReader(lines):
            tissue = Tissue[row["tissue"].upper()]
            table[tissue] = float(row["mu_per_mm"])
            seen.append(tissue)
    if sorted(seen) != sorted(Tissue):
        raise ValueError(f"attenuation table {name!r} must name each tissue once; it names {[t.name for t in seen]}")
    return frozen(table)
