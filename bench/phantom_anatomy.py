"""Compartments, ligaments and skin of the phantom against the anatomy it should have; writes docs/phantom_anatomy.md.

    python -m bench.phantom_anatomy [--voxel-mm 0.1] [--seeds 1 2 3]

Volumes of compartments come from the stage's own survey. Thicknesses are measured in the labels of a slab through the
middle of a cup C: of the skin along the normals of the outline, of ligaments
along theirs. Last line: one JSON object.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from simcore import phantom
from simcore.core.grid import Grid
from simcore.core.rng import stream
from simcore.core.tissues import Tissue
from simcore.phantom.anthropomorphic import settle, slab_grid
from simcore.phantom.raster import COLUMN
from simcore.phantom.seeds import RELATIVE_VOLUME, Region
from simcore.phantom.spec import AnthropomorphicPhantom, TextureSpec

PAGE = Path(__file__).parent.parent / "docs" / "phantom_anatomy.md"
BREASTS = {
    "plain": AnthropomorphicPhantom(),
    "textured": AnthropomorphicPhantom(texture=TextureSpec(amplitude_mm=2.0)),
}
SLAB_SLICES = 10 * COLUMN
POINTS = 4000
BALL_MM = 1.0
"""Radius around a point of a ligament from which its normal is taken."""
LEAST_FLATNESS = 3.0
"""Least ratio of the middle to the smallest variance of the ligament in that ball."""
STEP = 0.25
"""Distance of samples along a line, voxels."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--voxel-mm", type=float, default=0.1)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    args = parser.parse_args()
    volumes = [phantom.generate(BREASTS["plain"].with_(voxel_mm=0.4), seed).report for seed in args.seeds]
    thickness = {name: measured(spec.with_(voxel_mm=args.voxel_mm), args.seeds[0]) for name, spec in BREASTS.items()}
    PAGE.write_text(page(volumes, thickness, args.voxel_mm))
    kinds = {kind: [r["compartment_volume_cm3"][kind]["median"] for r in volumes] for kind in _kinds(volumes)}
    print(json.dumps({"median_compartment_cm3": kinds, "thickness_mm": thickness}))
    return 0


def measured(spec: AnthropomorphicPhantom, seed: int) -> dict[str, Any]:
    """Thickness of skin and ligaments in a slab around z = 0: 5th, 50th, 95th percentile, mm."""
    breast = settle(spec, seed)
    whole = breast.shape.grid
    middle = round(-whole.corner[2] / whole.spacing[2])
    first = (middle - SLAB_SLICES // 2) // COLUMN * COLUMN
    grid = slab_grid(whole, first, SLAB_SLICES)
    labels = np.zeros(grid.shape, np.uint8)
    breast.fill(labels, first)
    random = stream(seed, "anatomy")
    return {
        "skin": _percentiles(skin_thickness(labels, grid, breast.shape.axes, spec.skin_mm, random)),
        "ligament": _percentiles(ligament_thickness(labels, grid, random)),
    }


def skin_thickness(
    labels: np.ndarray, grid: Grid, axes: tuple[float, ...], nominal: float, random: np.random.Generator
) -> np.ndarray:
    """mm, at random points of the outline within the slab, counted along its inward normals."""
    a, b, upper, lower = axes
    z = random.uniform(grid.corner[2] + 4 * nominal, grid.upper[2] - 4 * nominal, POINTS)
    c = np.where(z > 0, upper, lower)
    across = np.sqrt(1 - (z / c) ** 2)
    angle = random.uniform(-0.45 * np.pi, 0.45 * np.pi, POINTS)  # away from the chest wall
    surface = np.stack([a * across * np.cos(angle), b * across * np.sin(angle), z], axis=1)
    normal = surface / np.stack([np.full(POINTS, a), np.full(POINTS, b), c], axis=1) ** 2
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    reach = np.arange(-2 * nominal, 4 * nominal, STEP * grid.spacing[0])
    tissues = look_up(labels, grid, surface[:, None, :] - reach[None, :, None] * normal[:, None, :])
    thickness: np.ndarray = np.count_nonzero(tissues == Tissue.SKIN, axis=1) * (reach[1] - reach[0])
    return thickness


def ligament_thickness(labels: np.ndarray, grid: Grid, random: np.random.Generator) -> np.ndarray:
    """mm, at random points of ligaments along their normals; where several meet there is none, and no value."""
    inner = labels[COLUMN:-COLUMN]
    places = np.flatnonzero(inner.ravel() == Tissue.LIGAMENT)
    k, j, i = np.unravel_index(random.choice(places, POINTS, replace=False), inner.shape)
    points = np.stack([grid.centres("x")[i], grid.centres("y")[j], grid.centres("z")[k + COLUMN]], axis=1)
    points += random.uniform(-0.5, 0.5, points.shape) * grid.spacing
    axis = np.linspace(-BALL_MM, BALL_MM, 13)
    ball = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    ball = ball[np.linalg.norm(ball, axis=1) <= BALL_MM]
    share = (look_up(labels, grid, points[:, None] + ball) == Tissue.LIGAMENT).astype(float)
    share /= share.sum(axis=1, keepdims=True)
    middle = share @ ball
    spread = np.einsum("pb,bi,bj->pij", share, ball, ball) - middle[:, :, None] * middle[:, None, :]
    size, frame = np.linalg.eigh(spread)
    flat = size[:, 1] > LEAST_FLATNESS * size[:, 0]
    step = STEP * grid.spacing[0]
    reach = np.arange(0.0, 2.0, step)
    chord = np.full(np.count_nonzero(flat), -step)
    for sign in (1.0, -1.0):
        line = points[flat, None, :] + sign * reach[None, :, None] * frame[flat, None, :, 0]
        outside = look_up(labels, grid, line) != Tissue.LIGAMENT
        chord += np.where(outside.any(axis=1), outside.argmax(axis=1), len(reach)) * step
    return chord


def look_up(labels: np.ndarray, grid: Grid, points: np.ndarray) -> np.ndarray:
    """Labels at points (..., 3), mm; air beyond the grid."""
    index = np.floor((points - grid.corner) / grid.spacing).astype(np.int64)
    inside = np.all((index >= 0) & (index < np.array(labels.shape)[::-1]), axis=-1)
    index[~inside] = 0
    values: np.ndarray = np.where(inside, labels[index[..., 2], index[..., 1], index[..., 0]], Tissue.AIR)
    return values


def page(reports: list[dict[str, Any]], thickness: dict[str, Any], voxel_mm: float) -> str:
    """docs/phantom_anatomy.md"""
    published = {region.name.lower(): volume for region, volume in RELATIVE_VOLUME.items()}
    lines = [
        "# The phantom's anatomy",
        "",
        "Made by `python -m bench.phantom_anatomy`: cup C (700 ml, 450 compartments, glandularity 0.30).",
        "",
        f"## Volumes of compartments, cm3 ({len(reports)} breasts)",
        "",
        "| kind | number | 5 % | median | 95 % | published mean |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for kind in _kinds(reports):
        spread = [r["compartment_volume_cm3"][kind] for r in reports]
        number = np.mean([r["compartments"][kind] for r in reports])
        low, median, high = (np.mean([s[p] for s in spread]) for p in ("percentile_5", "median", "percentile_95"))
        known = f"{published[kind]:.2f}" if kind in published else "-"
        lines.append(f"| {kind} | {number:.0f} | {low:.2f} | {median:.2f} | {high:.2f} | {known} |")
    lines += [
        "",
        "The number of compartments is an input, and the paper's 350 to 550 in 250 to 1500 ml make them larger than "
        "the published ones: 700 ml / 450 = 1.56 cm3. Only the published ratios of volume are used. Glandular "
        "compartments are one body and have no ligaments between them.",
        "",
        f"## Thickness, mm (slab of {voxel_mm:g} mm voxels)",
        "",
        "| breast | tissue | asked | 5 % | median | 95 % | published |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    design = {"skin": BREASTS["plain"].skin_mm, "ligament": BREASTS["plain"].compartments.ligament_mm}
    known = {"skin": "1.44 +- 0.25 (0.87 to 2.34)", "ligament": "0.2 to 0.6"}
    for name, tissues in thickness.items():
        for tissue, (low, median, high) in tissues.items():
            lines.append(
                f"| {name} | {tissue} | {design[tissue]:g} | {low:.2f} | {median:.2f} | {high:.2f} | {known[tissue]} |"
            )
    lines += [
        "",
        "Ligaments have one thickness to first order: it is where the two largest f differ by less than half of it "
        "times the gradient of their difference. Where that gradient nearly vanishes (neighbours that grow alike) they "
        "thicken, and a textured border stretches or squeezes them by the slope of its displacement.",
        "",
    ]
    return "\n".join(lines)


def _kinds(reports: list[dict[str, Any]]) -> list[str]:
    return [kind for kind in reports[0]["compartments"] if all(kind in r["compartment_volume_cm3"] for r in reports)]


def _percentiles(values: np.ndarray) -> list[float]:
    return [round(float(v), 3) for v in np.percentile(values, [5, 50, 95])]


if __name__ == "__main__":
    assert set(RELATIVE_VOLUME) == set(Region)
    sys.exit(main())
