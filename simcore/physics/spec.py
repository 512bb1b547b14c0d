"""What to ask of the X-ray tube and of the materials in its beam."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from simcore.core.spec_base import Spec, quantity
from simcore.core.tissues import Tissue

LOWEST_KVP, HIGHEST_KVP = 20.0, 49.0
LOWEST_KEV, HIGHEST_KEV = 1.0, 150.0

_LIGHT = "H Be B C N O F Na Mg Al Si P S Cl Ar K Ca"
_HEAVY = "Ti Cr Mn Fe Ni Cu Zn Se Br Sr Mo Rh Ag Cd Sn I Cs Ba Gd W Au Pb Bi"
ELEMENTS = tuple(f"{_LIGHT} {_HEAVY}".split())
"""Those that there are cross sections of; named here so that a specification is read without them."""
FRACTIONS_TOLERANCE = 1e-3

FilterMaterial = Literal[
    "aluminium", "rhodium", "silver", "molybdenum", "copper", "beryllium", "pmma", "polycarbonate", "carbon-fibre"
]
Energy = Annotated[float, Field(ge=LOWEST_KEV, le=HIGHEST_KEV)]
Number = Annotated[float, Field(ge=0.0, le=1e30)]


class FilterSpec(Spec):
    """A plane filter that every ray of the beam passes once."""

    material: FilterMaterial = Field("aluminium", description="material [1]")
    thickness_mm: float = quantity("thickness", unit="mm", default=0.7, gt=0.0, le=20.0)


class MeasuredSpectrum(Spec):
    """Photons behind all filters, as they were measured: what the tube sends out instead of the tables."""

    energies_keV: tuple[Energy, ...] = Field(
        strict=False,
        min_length=1,
        max_length=1000,
        json_schema_extra={"unit": "keV"},
        description="photon energies, ascending [keV]",
    )
    photons: tuple[Number, ...] = Field(
        strict=False, min_length=1, max_length=1000, description="photons at these energies, on any scale [1]"
    )
    mGy_per_mAs: float | None = Field(
        None,
        gt=0.0,
        le=100.0,
        json_schema_extra={"unit": "mGy/mAs"},
        description="air kerma of it at 1 m for a tube load of 1 mAs; without it there is no exposure by tube load "
        "and no load in the files [mGy/mAs]",
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if len(self.energies_keV) != len(self.photons):
            raise ValueError(f"{len(self.energies_keV)} energies and {len(self.photons)} numbers of photons")
        if any(b <= a for a, b in zip(self.energies_keV, self.energies_keV[1:], strict=False)):
            raise ValueError("energies_keV must ascend")
        if not sum(self.photons) > 0:
            raise ValueError("photons must not all be 0")
        return self


class TubeSpec(Spec):
    """Anode, voltage and filters; spectra of SpekPy behind them."""

    anode: Literal["W", "Mo", "Rh"] = Field("W", description="target: tungsten, molybdenum or rhodium")
    kVp: float = quantity("tube voltage", unit="kV", default=28.0, ge=LOWEST_KVP, le=HIGHEST_KVP)
    filters: tuple[FilterSpec, ...] = Field(
        (FilterSpec(material="rhodium", thickness_mm=0.05),),
        strict=False,
        max_length=8,
        description="filters that are chosen; none where the list is empty",
    )
    inherent: tuple[FilterSpec, ...] = Field(
        (FilterSpec(material="beryllium", thickness_mm=0.8), FilterSpec(material="aluminium", thickness_mm=0.2)),
        strict=False,
        max_length=8,
        description="filtration that every beam has: window and mirror, as aluminium so much that half-value layers of "
        "the system are met",
    )
    measured: MeasuredSpectrum | None = Field(
        None, description="spectrum behind all filters instead of anode, kVp and filters; those of the table where null"
    )

    @model_validator(mode="after")
    def _lets_photons_through(self) -> Self:
        chosen = {filter.material for filter in self.filters}
        usual = {"W": {"aluminium", "rhodium", "silver", "copper"}, "Mo": {"molybdenum", "rhodium", "aluminium"}}
        allowed = usual.get(self.anode, {"rhodium", "silver", "aluminium", "copper"})
        odd = chosen & {"molybdenum", "rhodium", "silver", "aluminium", "copper"} - allowed
        if odd and self.measured is None:
            raise ValueError(
                f"filter {', '.join(sorted(odd))} with the anode {self.anode} is not a pair of mammography; "
                f"{self.anode} goes with {', '.join(sorted(allowed))}"
            )
        return self


def composition_problem(mass_fractions: Mapping[str, float]) -> str | None:
    """What is wrong with mass fractions, as a sentence; None where nothing is."""
    unknown = [symbol for symbol in mass_fractions if symbol not in ELEMENTS]
    if unknown:
        return f"no cross sections of {', '.join(map(repr, unknown))}; there are {', '.join(ELEMENTS)}"
    negative = [f"{symbol} = {fraction:g}" for symbol, fraction in mass_fractions.items() if not fraction >= 0]
    if negative:
        return f"mass fractions must not be below 0: {', '.join(negative)}"
    total = sum(mass_fractions.values())
    if not abs(total - 1) <= FRACTIONS_TOLERANCE:
        hint = "; give fractions, not percent" if 99 <= total <= 101 else ""
        return f"mass fractions sum to {total:.6g}; they must sum to 1 within {FRACTIONS_TOLERANCE:g}{hint}"
    return None


class CompositionSpec(Spec):
    """A material of one's own."""

    density_g_cm3: float = quantity("density", unit="g/cm3", gt=0.0, le=25.0)
    mass_fractions: dict[str, float] = Field(
        min_length=1, max_length=30, description="shares of the elements by weight, summing to 1 within 0.001 [1]"
    )

    @model_validator(mode="after")
    def _sums(self) -> Self:
        if problem := composition_problem(self.mass_fractions):
            raise ValueError(problem)
        return self


TissueName = Annotated[str, Field(pattern="^(" + "|".join(t.name.lower() for t in Tissue if t != Tissue.AIR) + ")$")]


class MaterialsSpec(Spec):
    """What tissues are made of; primary, scatter and dose share it."""

    tissues: Literal["johns-yaffe", "icru-hammerstein"] = Field(
        "johns-yaffe",
        description="set of compositions: the two differ by 12.5 % in adipose tissue at 20 keV (docs/xray.md)",
    )
    own: dict[TissueName, CompositionSpec] = Field(
        default_factory=dict, description="compositions that take the place of those of the set, by tissue"
    )
