"""Named ways in which a compression can end without a result."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.core.errors import SolverError

ADVICE = {
    "inverted-element": "an element would turn inside out, however short the load step; ask for a smaller percent, "
    "more load_steps, a finer mesh or a smaller poissons_ratio",
    "not-converged": "Newton's method did not converge within {iterations} iterations, however short the load step; "
    "ask for a smaller percent, more load_steps, a finer mesh or a smaller poissons_ratio",
    "unstable-equilibrium": "the tangent stiffness is not positive, the breast would buckle; ask for a smaller "
    "percent, a law that does not soften or a fixed chest_wall",
    "unstable-material": "the material law loses its stability (St. Venant-Kirchhoff at a principal stretch of 0.577 "
    "at the latest; the least is {stretch:.3f}); ask for a smaller percent or for strain = hencky",
    "paddle-turned": "the paddle turns by more than 26 degrees; ask for a stiffer spring or a smaller percent",
    "force-limit": "the plates press with more than force_limit_N = {limit:g} N; ask for a smaller percent, a softer "
    "material or a higher limit",
    "locked-tissue": "the plates press with {pressure:.3g} times Young's modulus of the stiffest tissue on the outline "
    "of the breast, where at most {limit:g} is meaningful; ask for a smaller percent, a free chest_wall, a wider "
    "plate_edge_mm or a law that stiffens less",
    "target-not-reached": "the plates press with {force:.4g} N where force_N = {target:g} is wanted and percent "
    "allows no more; raise percent or lower force_N",
}
"""What each code means and what to change; the codes are stable."""


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
