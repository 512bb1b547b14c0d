"""The tables of simcore/physics/data, read once and read-only (sources: simcore/physics/data/SOURCES.md)."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from functools import cache
from importlib import resources
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import frozen

FloatArray = NDArray[np.float64]


class ElementTable(NamedTuple):
    """Cross sections of an element, cm2/g, over energies in keV; an edge stands twice, below and above."""

    energies: FloatArray
    photo: FloatArray
    coherent: FloatArray
    incoherent: FloatArray


class KShell(NamedTuple):
    """Fluorescence of a K shell: edge, share of the photo-absorption above it, yield, lines."""

    edge_keV: float
    k_share: float
    fluorescence_yield: float
    k_alpha_keV: float
    k_beta_keV: float
    k_alpha_share: float

    @property
    def line_keV(self) -> float:
        """Mean energy of the K lines."""
        return self.k_alpha_share * self.k_alpha_keV + (1 - self.k_alpha_share) * self.k_beta_keV


class FormFactors(NamedTuple):
    """Atomic form factors F and incoherent scattering functions S, (elements, x), x in 1/Angstrom."""

    rows: Mapping[str, int]
    x: FloatArray
    form_factor: FloatArray
    scattering_function: FloatArray


@cache
def arrays(name: str) -> Mapping[str, NDArray[np.generic]]:
    """The arrays of an npz table.

    name: file name without its end, e.g. "cross_sections".
    """
    with resources.files("simcore.physics.data").joinpath(f"{name}.npz").open("rb") as file, np.load(file) as table:
        return MappingProxyType({key: frozen(table[key]) for key in table.files})


def rows(name: str) -> list[dict[str, str]]:
    """The rows of a csv table, as texts."""
    with resources.files("simcore.physics.data").joinpath(f"{name}.csv").open(encoding="utf-8") as lines:
        return list(csv.DictReader(lines))


@cache
def elements() -> Mapping[str, ElementTable]:
    """Cross sections by symbol, 1 to 150 keV."""
    table = arrays("cross_sections")
    energies, values = (np.asarray(table[key], np.float64) for key in ("energies_keV", "cm2_per_g"))
    starts = np.asarray(table["starts"], np.int64)
    return MappingProxyType(
        {
            str(symbol): ElementTable(
                frozen(energies[first:end]), *(frozen(values[kind, first:end]) for kind in range(3))
            )
            for symbol, first, end in zip(table["elements"], starts, starts[1:], strict=False)
        }
    )


@cache
def atomic_masses() -> Mapping[str, float]:
    """Atomic mass by symbol, g/mol."""
    table = arrays("cross_sections")
    return MappingProxyType(
        {str(symbol): float(mass) for symbol, mass in zip(table["elements"], table["atomic_mass"], strict=True)}
    )


@cache
def form_factors() -> FormFactors:
    """Free-atom form factors and incoherent scattering functions."""
    table = arrays("form_factors")
    x, form, scattering = (
        frozen(np.asarray(table[key], np.float64)) for key in ("x_per_angstrom", "form_factor", "scattering_function")
    )
    return FormFactors(
        MappingProxyType({str(symbol): row for row, symbol in enumerate(table["elements"])}), x, form, scattering
    )


@cache
def k_shells() -> Mapping[str, KShell]:
    """K shells by symbol, of the elements whose K edge stands in the table."""
    return MappingProxyType(
        {
            row["element"]: KShell(*(float(text) for key, text in row.items() if key != "element"))
            for row in rows("fluorescence")
        }
    )


def tg195_spectrum(name: str) -> tuple[FloatArray, FloatArray]:
    """(energies in keV, photons a bin of 0.5 keV) of AAPM Report 195 before any air, in all 1.

    name: "mo-mo-30", "w-al-100" or "w-al-120". raises: ValueError for another.
    """
    table = rows("tg195")
    names = sorted({row["spectrum"] for row in table})
    if name not in names:
        raise ValueError(f"no TG-195 spectrum {name!r}; there are {', '.join(names)}")
    pairs = np.array([(float(row["energy_keV"]), float(row["photons"])) for row in table if row["spectrum"] == name])
    return frozen(pairs[:, 0]), frozen(pairs[:, 1])
