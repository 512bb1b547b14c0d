"""Named ways in which a compression can end without a result."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from simcore.core.advice import one_of, where
from simcore.core.errors import SolverError
from simcore.fem.laws.by_tissue import ByTissue
from simcore.fem.laws.law import Law
from simcore.fem.laws.published import Published
from simcore.fem.spec import MOST_LOAD_STEPS, MOST_PERCENT, CompressionSpec

NEAR_INCOMPRESSIBLE = 10.0
"""Bulk over shear modulus above which a smaller Poisson's ratio (0.45 gives 9.7) makes a compression easier."""

Remedy = Callable[[CompressionSpec], str | None]
"""What to change in a specification, None where it is so already."""

FAULTS = {
    "inverted-element": "an element would turn inside out, however short the load step",
    "not-converged": "Newton's method did not converge within {iterations} iterations, however short the load step",
    "linear-system": "conjugate gradients did not solve a linear system within {limit} iterations, however short the "
    "load step",
    "unsettled-plates": "breast and plates that give way did not come to rest within {rounds} rounds, however short "
    "the load step",
    "unstable-equilibrium": "the tangent stiffness is not positive, the breast would buckle",
    "unstable-material": "the material law loses its stability (St. Venant-Kirchhoff at a principal stretch of 0.577 "
    "at the latest; the least is {stretch:.3f})",
    "paddle-turned": "the paddle turns by more than 26 degrees",
    "force-limit": "the plates press with more than force_limit_N = {limit:g} N",
    "locked-tissue": "the plates press with {pressure:.3g} times Young's modulus of the stiffest tissue on the outline "
    "of the breast, where at most {limit:g} is meaningful",
    "target-not-reached": "the plates press with {force:.4g} N where force_N = {target:g} is wanted and percent "
    "allows no more",
    "force-not-met": "the plates press with {force:.4g} N at {percent:.4g} % and with {beyond:.4g} N at {further:.4g} "
    "%, and within {steps} load steps no place between was found where they press with force_N = {target:g} N",
}
"""What each code means; the codes are stable."""


def _less(spec: CompressionSpec) -> str:
    if spec.thickness_mm is not None:
        return "a larger thickness_mm"
    return "a smaller percent" if spec.force_N is None else "a smaller force_N"


def _finer_mesh(spec: CompressionSpec) -> str:
    return "a finer mesh (mesh.edge_length_mm)"


def _coarser_mesh(spec: CompressionSpec) -> str:
    return "a coarser mesh or one of better shaped elements (mesh.edge_length_mm, mesh.kind = 'lattice')"


def _poissons_ratio(spec: CompressionSpec) -> str | None:
    if isinstance(spec.material, Published):
        return None
    stiff = any(law.bulk > NEAR_INCOMPRESSIBLE * law.shear for law in laws(spec))
    return where(stiff, "a smaller poissons_ratio")


def _law_that_does_not_soften(spec: CompressionSpec) -> str | None:
    return where(any(law.energy.softens for law in laws(spec)), "a law that does not soften")


def _law_that_stiffens_less(spec: CompressionSpec) -> str | None:
    return where(any(law.energy.stiffens for law in laws(spec)), "a law that stiffens less")


def _fixed_wall(spec: CompressionSpec) -> str | None:
    return where(spec.chest_wall == "free_in_plane", "chest_wall = 'fixed'")


def _free_wall(spec: CompressionSpec) -> str | None:
    return where(spec.chest_wall != "free_in_plane", "chest_wall = 'free_in_plane'")


def _wider_edge(spec: CompressionSpec) -> str | None:
    return where(spec.chest_wall != "free_in_plane" and spec.plate_edge_mm < 200.0, "a wider plate_edge_mm")


def _stiffer_plates(spec: CompressionSpec) -> str | None:
    if spec.elastic_plates is None:
        return where(spec.spring_paddle is not None, "a stiffer spring_paddle")
    return "thicker elastic_plates"


def _more_percent(spec: CompressionSpec) -> str | None:
    return where(spec.percent < MOST_PERCENT, "a larger percent")


REMEDIES: dict[str, tuple[Remedy, ...]] = {
    "inverted-element": (_less, _finer_mesh, _poissons_ratio, _wider_edge),
    "not-converged": (_less, _finer_mesh, _poissons_ratio, _wider_edge),
    "linear-system": (_less, _coarser_mesh, _poissons_ratio),
    "unsettled-plates": (_stiffer_plates, _less),
    "unstable-equilibrium": (_less, _law_that_does_not_soften, _fixed_wall),
    "unstable-material": (_less, lambda spec: "strain = 'hencky'"),
    "paddle-turned": (_stiffer_plates, _less),
    "force-limit": (_less, lambda spec: "a softer material", lambda spec: "a higher force_limit_N"),
    "locked-tissue": (_less, _free_wall, _wider_edge, _law_that_stiffens_less),
    "target-not-reached": (_more_percent, lambda spec: "a smaller force_N"),
    "force-not-met": (_less, lambda spec: "percent without force_N", _finer_mesh),
}
"""What to change, by code; of these, what the specification has not already."""


def message(code: str, spec: CompressionSpec, **facts: float) -> str:
    """What happened and what to change in ``spec``."""
    return f"{FAULTS[code].format(**facts)}; take {one_of(*(remedy(spec) for remedy in REMEDIES[code]))}"


def remedy_of_unverified(spec: CompressionSpec) -> str:
    """What to change where the last look at a solution does not confirm it."""
    return one_of(where(spec.load_steps < MOST_LOAD_STEPS, "more load_steps"), _finer_mesh(spec), _less(spec))


def laws(spec: CompressionSpec) -> list[Law]:
    """The constitutive laws of ``spec``, one for each tissue where they differ."""
    material = spec.material
    return list(material.laws().values()) if isinstance(material, ByTissue | Published) else [material.law()]


class CompressionFailed(SolverError):
    """A compression that stopped on its way, with the last state that was a verified equilibrium.

    percent: compression of that state. force_N: plate force there. displacement: (n, 3), mm. force_curve: as in the
    report of a compression.
    """

    def __init__(
        self,
        message: str,
        *,
        code: str | None = None,
        percent: float = 0.0,
        force_N: float = 0.0,
        displacement: NDArray[np.float64] | None = None,
        force_curve: list[dict[str, float]] | None = None,
    ) -> None:
        super().__init__(message, code=code)
        self.percent = percent
        self.force_N = force_N
        self.displacement = displacement
        self.force_curve = force_curve or []
