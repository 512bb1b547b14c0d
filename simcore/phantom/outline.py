"""The outline of the breast on a voxel grid: quarters of two ellipsoids, a skin of true normal thickness.

Every row of voxels along x starts at the chest wall and leaves first the tissue, then the skin (both bodies are
convex and hold their chest-wall plane), so two numbers a row describe the whole outline.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.core.errors import PhantomError
from simcore.core.grid import Grid
from simcore.core.tissues import Tissue
from simcore.phantom.spec import AnthropomorphicPhantom, NippleSpec

SemiAxes = tuple[float, float, float, float]
"""(depth a along x, half width b along y, upper half height c, lower half height c), mm."""

VOLUME_TOLERANCE = 0.01
"""Largest relative difference between the volume asked for and the one counted in voxels."""


@dataclass(frozen=True)
class Outline:
    """The outer shape on its grid.

    axes:        semi-axes, mm.
    grid:        corner at x = 0; z = 0 lies between two slices; 1 to 2 voxels of air on all other sides.
    breast_rows: int32 (nz, ny), voxels of the row inside the breast, counted from the chest wall.
    tissue_rows: int32 (nz, ny), voxels of the row inside the skin.
    cover:       uint8 (nz, ny), the label of what lies between them: skin, or nipple.
    """

    axes: SemiAxes
    grid: Grid
    breast_rows: NDArray[np.int32]
    tissue_rows: NDArray[np.int32]
    cover: NDArray[np.uint8]

    @property
    def breast_voxels(self) -> int:
        return int(self.breast_rows.sum(dtype=np.int64))

    @property
    def tissue_voxels(self) -> int:
        """All but air and skin."""
        return int(self.tissue_rows.sum(dtype=np.int64))


def outline(spec: AnthropomorphicPhantom) -> Outline:
    """The outline of ``spec`` on its voxel grid.

    raises: PhantomError where the voxels cannot hold the volume or the skin leaves nothing inside.
    """
    axes = _axes_for_counted_volume(spec)
    smallest_radius = min(axes) ** 2 / max(axes)
    if spec.skin_mm >= smallest_radius:
        raise PhantomError(
            f"skin_mm = {spec.skin_mm:g} mm is thicker than a breast of {spec.volume_ml:g} ml allows, whose smallest "
            f"radius of curvature is {smallest_radius:.2f} mm: take a thinner skin or a larger or rounder breast"
        )
    grid = _grid(axes, spec.voxel_mm, spec.nipple)
    y, z = grid.centres("y")[None, :], grid.centres("z")[:, None]
    breast = _breast_rows(axes, grid, spec.nipple)
    tissue = np.minimum(breast, _rows(_inner_surface_depth(axes, y, z, spec.skin_mm), spec.voxel_mm))
    cover = np.full(breast.shape, Tissue.SKIN, dtype=np.uint8)
    if spec.nipple is not None:
        cover[np.hypot(y, z) < spec.nipple.diameter_mm / 2] = Tissue.NIPPLE
    result = Outline(axes, grid, breast, tissue, cover)
    if result.tissue_voxels == 0:
        raise PhantomError(
            f"skin_mm = {spec.skin_mm:g} mm leaves no voxel of {spec.voxel_mm:g} mm inside a breast of "
            f"{spec.volume_ml:g} ml: take a thinner skin, smaller voxels or a larger breast"
        )
    return result


def similar_radius(
    axes: SemiAxes, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Scale of the similar outline through a point: 0 at the origin, 1 on the surface."""
    a, b, upper, lower = axes
    c = np.where(z > 0, upper, lower)
    return np.sqrt((x / a) ** 2 + (y / b) ** 2 + (z / c) ** 2)


def _grid(axes: SemiAxes, voxel: float, nipple: NippleSpec | None) -> Grid:
    depth = axes[0] + (nipple.height_mm if nipple else 0.0)
    a, b, upper, lower = (math.ceil(axis / voxel) + 1 for axis in (depth, *axes[1:]))
    return Grid((upper + lower, 2 * b, a), (voxel, voxel, voxel), (0.0, -b * voxel, -lower * voxel))


def _rows(depth: NDArray[np.float64], voxel: float) -> NDArray[np.int32]:
    """Number of voxel centres between the chest wall and ``depth``."""
    return np.floor(depth / voxel + 0.5).astype(np.int32)


def _breast_rows(axes: SemiAxes, grid: Grid, nipple: NippleSpec | None) -> NDArray[np.int32]:
    """Voxels of each row inside the skin and the nipple, (nz, ny)."""
    y, z = grid.centres("y")[None, :], grid.centres("z")[:, None]
    depth = _surface_depth(axes, y, z)
    if nipple is not None:
        # Straight sides and a round tip: a superellipse of degree 4.
        relative = np.minimum(1.0, np.hypot(y, z) / (nipple.diameter_mm / 2))
        depth = depth + nipple.height_mm * (1.0 - relative**4) ** 0.25
    return _rows(depth, grid.spacing[0])


def _surface_depth(axes: SemiAxes, y: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.float64]:
    """x of the outer surface over (y, z), mm; 0 outside."""
    return axes[0] * np.sqrt(np.maximum(0.0, 1.0 - similar_radius(axes, np.zeros(()), y, z) ** 2))


def _inner_surface_depth(
    axes: SemiAxes, y: NDArray[np.float64], z: NDArray[np.float64], thickness: float
) -> NDArray[np.float64]:
    """x of the surface at a normal distance of ``thickness`` inside the outer one over (y, z), mm; 0 where there is
    none in front of the chest wall.

    A point at distance d under its foot q on the ellipsoid is p_i = q_i (1 - t / a_i^2) with t = d / |(q_i / a_i^2)|.
    Given p_y and p_z, t alone is unknown; its fixed point contracts by about thickness over radius of curvature.
    """
    a, b, upper, lower = axes
    c = np.where(z > 0, upper, lower)
    t = np.full(np.broadcast_shapes(y.shape, z.shape), thickness * min(axes))
    x_squared = np.zeros_like(t)
    for _ in range(100):
        foot_y = y / (1.0 - t / b**2)
        foot_z = z / (1.0 - t / c**2)
        x_squared = 1.0 - (foot_y / b) ** 2 - (foot_z / c) ** 2
        slope = np.sqrt(np.maximum(0.0, x_squared) / a**2 + (foot_y / b**2) ** 2 + (foot_z / c**2) ** 2)
        # Outside the ellipsoid (rows that no tissue touches) t must only stay where its divisors are positive.
        new = np.minimum(thickness / np.maximum(slope, 1e-12), 0.99 * min(axes) ** 2)
        done = np.max(np.abs(new - t)) < 1e-6 * min(axes)
        t = new
        if done:
            return np.where(x_squared > 0, a * np.sqrt(np.maximum(0.0, x_squared)) * (1.0 - t / a**2), 0.0)
    raise PhantomError(
        f"no surface at a depth of {thickness:g} mm follows the outline; ask for a thinner skin or layer of fat, or a "
        "larger volume"
    )


def _axes_for_counted_volume(spec: AnthropomorphicPhantom) -> SemiAxes:
    """The semi-axes of the specification, scaled by the least that lets the voxels count up to the volume (by nothing
    at all with fine voxels)."""
    best_error, best = math.inf, spec.semi_axes()
    for step in range(61):
        for scale in (1.0 + 0.0015 * step, 1.0 - 0.0015 * step):
            a, b, upper, lower = (scale * axis for axis in spec.semi_axes())
            error = abs(_counted_volume_ml((a, b, upper, lower), spec) / spec.volume_ml - 1.0)
            if error < best_error:
                best_error, best = error, (a, b, upper, lower)
        if best_error < VOLUME_TOLERANCE / 4:
            break
    if best_error > VOLUME_TOLERANCE:
        raise PhantomError(
            f"voxels of {spec.voxel_mm:g} mm count {100 * best_error:.1f} % beside volume_ml = {spec.volume_ml:g} ml "
            f"(allowed: 1 %): take smaller voxels"
        )
    return best


def _counted_volume_ml(axes: SemiAxes, spec: AnthropomorphicPhantom) -> float:
    grid = _grid(axes, spec.voxel_mm, spec.nipple)
    return float(_breast_rows(axes, grid, spec.nipple).sum(dtype=np.int64)) * grid.voxel_volume * 1e-3
