"""All measures of one case folder."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import Report
from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid
from simcore.core.progress import Progress, part, silent
from simcore.quality import literature, values
from simcore.quality.case_files import CaseFiles
from simcore.quality.texture import SMALLEST_ROI_PIXELS, regions_inside, texture
from simcore.quality.volume_analysis import VolumeAnalysis

FULL_THICKNESS = (0.9, 0.75, 0.5)
"""Fractions of the largest thickness of the breast inside which the texture of projections is measured: the first
that leaves room for a region. Towards its border the breast thins, which is shape and not texture."""


def analyse(folder: Path, progress: Progress = silent) -> Report:
    """Quality measures of a case as ``tomosim simulate --out`` writes it.

    returns: JSON-ready: "projections" (beta, values, clipping of every view), "volume" (see VolumeAnalysis.report),
        "checks" (published ranges).
    raises: SpecError where the folder is not a whole case.
    """
    case = CaseFiles(folder)
    slope, intercept = case.volume_values
    volume = VolumeAnalysis(case.volume_grid, slope, intercept)
    manifest = case.manifest
    volume.run(case.slices(), part(progress, 0.0, 0.7))
    views = _projections(case, volume, part(progress, 0.7, 1.0))
    report = volume.report()
    progress(1.0, "analysed")
    return {
        "schema": "tomosim-analysis/1",
        "case": {"name": manifest["specification"].get("name", ""), "software": manifest["software"]["version"]},
        "projections": views,
        "volume": report,
        "checks": literature.checks(_checked(manifest, views, report)),
    }


def _projections(case: CaseFiles, volume: VolumeAnalysis, progress: Progress) -> list[Report]:
    geometry = case.geometry
    middle = (volume.grid.corner[2] + volume.grid.upper[2]) / 2
    region = full_thickness(between_plates(volume.thickness_slices, volume.grid, case.manifest["results"]))
    views = []
    for view in range(geometry.views):
        progress(view / geometry.views, f"view {view + 1} of {geometry.views}")
        stored, open_field = case.projection(view)
        counts = values.value_counts(stored)
        integrals = np.log(open_field / np.maximum(stored, 1)).astype(np.float32)
        mask = shadow(region, volume.grid, geometry, view, middle)
        views.append(
            {
                "view": view,
                "angle_degrees": float(geometry.angles[view]),
                **texture(integrals, mask, geometry.detector.pixel).report(),
                "stored": values.summary(counts),
                "clipped_low": values.clipped(counts)["low"],
                "open_field_fraction": float(counts[round(open_field) :].sum() / counts.sum()),
            }
        )
    return views


def between_plates(thickness: NDArray[np.int32], grid: Grid, results: Report) -> NDArray[np.int32]:
    """Thickness in slices of ``grid``, but no more than the plates are apart: beside the rim of a fixed chest wall the
    breast reaches beyond them."""
    if "thickness_mm" not in results:
        return thickness
    return np.asarray(np.minimum(thickness, math.ceil(results["thickness_mm"] / grid.spacing[2] - 1e-6)), np.int32)


def full_thickness(thickness: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Where the breast has nearly its whole thickness: bool (ny, nx), in pixels of the volume."""
    largest = int(thickness.max(initial=0))
    mask = thickness > 0
    for fraction in FULL_THICKNESS:
        mask = thickness >= max(1.0, fraction * largest)
        if regions_inside(mask, SMALLEST_ROI_PIXELS):
            break
    return mask


def shadow(
    mask: NDArray[np.bool_], grid: Grid, geometry: AcquisitionGeometry, view: int, z: float
) -> NDArray[np.bool_]:
    """The shadow that a mask (ny, nx) on a plane at height z, mm, throws on the detector of a view, same type.

    A turning detector is taken as at rest: its few degrees move the shadow by less than a region's margin.
    """
    source = geometry.sources[view]
    towards = (z - 0.0) / source[2]
    x = geometry.detector.x_centres() * (1 - towards) + source[0] * towards
    y = geometry.detector.y_centres() * (1 - towards) + source[1] * towards
    column = np.floor((x - grid.corner[0]) / grid.spacing[0]).astype(np.int64)
    row = np.floor((y - grid.corner[1]) / grid.spacing[1]).astype(np.int64)
    ny, nx = mask.shape
    inside = ((row >= 0) & (row < ny))[:, None] & ((column >= 0) & (column < nx))
    values = mask[np.clip(row, 0, ny - 1)[:, None], np.clip(column, 0, nx - 1)]
    return np.asarray(values & inside)


def _checked(manifest: dict[str, Any], views: list[Report], volume: Report) -> dict[str, float | None]:
    """The quantities that have a published range."""
    tissue = volume["tissue_ml"]
    total = sum(tissue.values())
    results = manifest.get("results", {})
    return {
        "projection beta": views[len(views) // 2]["beta"],
        "slice beta": _mean([t["beta"] for t in volume["texture"]]),
        "skin thickness": volume["skin_line"].get("thickness_mm"),
        "glandularity": tissue.get("gland", 0.0) / total if total else None,
        "compressed thickness": results.get("thickness_mm"),
        "force": results.get("force_N"),
    }


def _mean(numbers: list[float | None]) -> float | None:
    known = [n for n in numbers if n is not None]
    return float(np.mean(known)) if known else None
