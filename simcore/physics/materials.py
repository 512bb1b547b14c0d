"""Materials: composition by weight and density; the standard ones and those of the tissues."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

from simcore.core.tissues import Tissue
from simcore.physics.spec import composition_problem
from simcore.physics.tables import rows


@dataclass(frozen=True, eq=False)
class Material:
    """Elements by weight.

    density_g_cm3: g/cm3.
    mass_fractions: by chemical symbol, summing to 1 within 1e-3; they are scaled to sum to 1.
    raises: ValueError for an element without cross sections, a fraction below 0, another sum, a density not above 0.
    """

    name: str
    density_g_cm3: float
    mass_fractions: Mapping[str, float]

    def __post_init__(self) -> None:
        problem = composition_problem(self.mass_fractions)
        if problem is None and not self.density_g_cm3 > 0:
            problem = f"density_g_cm3 = {self.density_g_cm3:g} must be above 0"
        if problem is not None:
            raise ValueError(f"material {self.name!r}: {problem}")
        total = sum(self.mass_fractions.values())
        scaled = {symbol: fraction / total for symbol, fraction in self.mass_fractions.items() if fraction > 0}
        object.__setattr__(self, "mass_fractions", MappingProxyType(scaled))


def mixture(name: str, parts: Sequence[tuple[Material, float]], *, density_g_cm3: float | None = None) -> Material:
    """A mixture by weight.

    parts: materials with their shares of the mass, any positive scale.
    density_g_cm3: where not given, the volumes of the parts add up.
    """
    total = sum(share for _, share in parts)
    fractions: dict[str, float] = {}
    for part, share in parts:
        for symbol, fraction in part.mass_fractions.items():
            fractions[symbol] = fractions.get(symbol, 0.0) + fraction * share / total
    if density_g_cm3 is None:
        density_g_cm3 = total / sum(share / part.density_g_cm3 for part, share in parts)
    return Material(name, density_g_cm3, fractions)


@cache
def standard_materials() -> Mapping[str, Material]:
    """The materials of simcore/physics/data/materials.csv by name."""
    return MappingProxyType({row["material"]: _of_row(row) for row in rows("materials")})


def material(name: str) -> Material:
    """A standard material.

    raises: ValueError naming those there are.
    """
    if name not in standard_materials():
        raise ValueError(f"no material {name!r}; there are {', '.join(standard_materials())}")
    return standard_materials()[name]


@cache
def tissue_sets() -> Mapping[str, Mapping[Tissue, Material]]:
    """What each tissue is made of, by set: "icru-hammerstein" and "johns-yaffe" (the paper's attenuation).

    Primary, scatter and dose of a case share one set: adipose tissue of the two differs by 12.5 % at 20 keV.
    """
    sets: dict[str, dict[Tissue, Material]] = {}
    for row in rows("tissues"):
        sets.setdefault(row["set"], {})[Tissue[row["tissue"].upper()]] = material(row["material"])
    return MappingProxyType({name: MappingProxyType(tissues) for name, tissues in sets.items()})


def _of_row(row: dict[str, str]) -> Material:
    texts = row["percent_by_weight"].split()
    fractions = {symbol: float(percent) / 100 for symbol, percent in zip(texts[::2], texts[1::2], strict=True)}
    return Material(row["material"], float(row["density_g_cm3"]), fractions)
