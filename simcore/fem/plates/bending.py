"""Bending of a rectangular plate that is simply supported along three edges and free along the chest wall.

Kirchhoff's energy D/2 int (w_xx + w_yy)^2 - 2 (1 - nu) (w_xx w_yy - w_xy^2), D = E t^3 / (12 (1 - nu^2)), minimised
over (1 - x/depth) P_i(2 x/depth - 1) sin(j pi (y/width + 1/2)), Legendre's polynomials P_i: Ritz's method.

Source: Timoshenko, Woinowsky-Krieger, Theory of Plates and Shells (1959), chapters 2 and 10.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

Floats = NDArray[np.float64]
DEGREES, WAVES = 8, 11
_QUADRATURE = 40


@dataclass(frozen=True, eq=False)
class BendingPlate:
    """depth: along x from the chest wall, width: along y, centred, mm. compliance: (k, k), of the amplitudes, mm/N."""

    depth: float
    width: float
    compliance: Floats

    @classmethod
    def of(
        cls, depth: float, width: float, thickness: float, youngs_modulus: float, poissons_ratio: float
    ) -> BendingPlate:
        """Lengths in mm, modulus in N/mm^2."""
        rigidity = youngs_modulus * thickness**3 / (12 * (1 - poissons_ratio**2))
        nodes, weights = _gauss_points()
        x = _polynomials((nodes + 1) / 2, depth)
        y = _sines(nodes / 2, width)
        wx, wy = weights * depth / 2, weights * width / 2

        def products(of: list[Floats], weight: Floats, a: int, b: int) -> Floats:
            return np.asarray(np.einsum("q,qi,qj->ij", weight, of[a], of[b]), dtype=np.float64)

        def both(a: tuple[int, int], b: tuple[int, int]) -> Floats:
            """Integral of the product of derivatives a and b, each (order in x, order in y)."""
            return np.asarray(np.kron(products(x, wx, a[0], b[0]), products(y, wy, a[1], b[1])), dtype=np.float64)

        mixed = both((2, 0), (0, 2))
        stiffness = rigidity * (
            both((2, 0), (2, 0))
            + both((0, 2), (0, 2))
            + poissons_ratio * (mixed + mixed.T)
            + 2 * (1 - poissons_ratio) * both((1, 1), (1, 1))
        )
        return cls(depth, width, np.asarray(np.linalg.inv(stiffness), dtype=np.float64))

    def deflection(self, at: Floats, points: Floats, forces: Floats) -> Floats:
        """Deflection (n,), mm, under normal forces (m,), N.

        at: (n, >= 2), points: (m, >= 2), (x, y), mm; beyond the plate they count as on its edge.
        """
        amplitudes = self.compliance @ (self._shapes(points).T @ forces)
        deflection: Floats = self._shapes(at) @ amplitudes
        return deflection

    def _shapes(self, points: Floats) -> Floats:
        x = _polynomials(np.clip(points[:, 0] / self.depth, 0, 1), self.depth)[0]
        y = _sines(np.clip(points[:, 1] / self.width, -0.5, 0.5), self.width)[0]
        shapes: Floats = np.einsum("pi,pj->pij", x, y).reshape(len(points), x.shape[1] * y.shape[1])
        return shapes


def _gauss_points() -> tuple[Floats, Floats]:
    """(points, weights) in [-1, 1]."""
    points, weights = legendre.leggauss(_QUADRATURE)
    return np.asarray(points, dtype=np.float64), np.asarray(weights, dtype=np.float64)


def _polynomials(t: Floats, depth: float) -> list[Floats]:
    """(1 - t) P_i(2 t - 1) and its first and second derivatives along x = t depth, (points, DEGREES) each."""
    s = 2 * t - 1
    values = []
    for order in range(3):
        columns = []
        for i in range(DEGREES):
            series = legendre.legmul([0.5, -0.5], np.eye(i + 1)[i])
            columns.append(legendre.legval(s, legendre.legder(series, order)) * (2 / depth) ** order)
        values.append(np.stack(columns, axis=1))
    return values


def _sines(t: Floats, width: float) -> list[Floats]:
    """sin(j pi (t + 1/2)) and its first and second derivatives along y = t width, (points, WAVES) each."""
    wave = np.arange(1, WAVES + 1) * np.pi
    phase = np.outer(t + 0.5, wave)
    return [np.sin(phase), np.cos(phase) * wave / width, -np.sin(phase) * (wave / width) ** 2]
