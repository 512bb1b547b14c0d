"""One pass over the slices of a reconstructed volume with the tissue of every voxel as the truth."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from simcore.core.artifacts import Report
from simcore.core.grid import Grid
from simcore.core.progress import Progress
from simcore.core.tissues import MAX_TISSUES, Tissue
from simcore.quality import values
from simcore.quality.contrast import Contrast, TissueValues
from simcore.quality.skin import skin_line, skin_thickness
from simcore.quality.texture import texture

ERODE_MM = 1.0
"""Voxels nearer than this to another tissue do not count as tissue: resolution and interpolation mix them."""
SKIN_MARGIN_MM = 5.0
"""Distance of the texture's regions from skin and air."""
TEXTURE_SLICES = 5

Labels = NDArray[np.uint8]
Slices = Iterable[tuple[NDArray[np.uint16], Labels]]


class VolumeAnalysis:
    """Measures of one volume, fed slice by slice from the breast support upwards.

    grid: of the volume; slope, intercept: attenuation [1/mm] = slope x stored value + intercept.
    """

    def __init__(self, grid: Grid, slope: float, intercept: float) -> None:
        self.grid, self.slope, self.intercept = grid, slope, intercept
        self.thickness_slices = np.zeros(grid.shape[1:], np.int32)
        """Slices that the breast fills above each pixel, int32 (ny, nx)."""
        self._voxels = np.zeros(MAX_TISSUES, np.int64)
        self._counts = {name: np.zeros(values.LEVELS, np.int64) for name in ("breast", "air")}
        self._tissues = TissueValues(MAX_TISSUES)
        self._textures: list[Report] = []
        self._skin: Report = {}

    def run(self, slices: Slices, progress: Progress) -> None:
        """Reads all slices once."""
        depth = self.grid.shape[0]
        near = max(1, round(ERODE_MM / self.grid.spacing[2]))
        window: deque[tuple[int, NDArray[np.uint16], Labels, Labels]] = deque(maxlen=2 * near + 1)
        textured = set(np.rint(np.linspace(0.25, 0.75, TEXTURE_SLICES) * (depth - 1)).astype(int).tolist())
        for k, (stored, labels) in enumerate(slices):
            progress(k / depth, f"slice {k + 1} of {depth}")
            self._add(stored, labels)
            if k in textured:
                self._textures.append({"slice": k, **self._texture(stored, labels)})
            if k == depth // 2:
                self._skin = self._skin_line(stored, labels)
            window.append((k, stored, labels, uniform(labels, self.grid, ERODE_MM)))
            if len(window) == window.maxlen:
                self._add_tissues(window, near)

    def _add(self, stored: NDArray[np.uint16], labels: Labels) -> None:
        breast = labels != Tissue.AIR
        self.thickness_slices += breast
        self._voxels += np.bincount(labels.ravel(), minlength=MAX_TISSUES)
        self._counts["breast"] += values.value_counts(stored[breast])
        self._counts["air"] += values.value_counts(stored[~breast])

    def _add_tissues(self, window: deque[tuple[int, NDArray[np.uint16], Labels, Labels]], middle: int) -> None:
        """The voxels of the window's middle slice whose neighbours in all its slices are of the same tissue."""
        _, stored, labels, _ = window[middle]
        inside = np.logical_and.reduce([(even != 0) & (other == labels) for _, _, other, even in window])
        self._tissues.add(stored[inside], labels[inside])

    def _texture(self, stored: NDArray[np.uint16], labels: Labels) -> Report:
        """beta of the slice in regions well below the skin."""
        inside = (labels != Tissue.AIR) & (labels != Tissue.SKIN)
        inner = eroded(inside, self.grid, SKIN_MARGIN_MM)
        return texture(stored, inner, self.grid.spacing[0]).report()

    def _skin_line(self, stored: NDArray[np.uint16], labels: Labels) -> Report:
        pixel = self.grid.spacing[0]
        line = skin_line(stored, labels != Tissue.AIR, pixel)
        overshoot = line.overshoot
        return {
            "rows": line.rows,
            "border_mm": line.border_mm,
            "overshoot_per_mm": None if overshoot is None else self.slope * overshoot,
            "thickness_mm": skin_thickness(labels, Tissue.SKIN, pixel),
        }

    def report(self) -> Report:
        """Everything measured, JSON-ready; attenuation in 1/mm."""
        return {
            "voxel_mm": list(self.grid.spacing),
            "slices": self.grid.shape[0],
            "tissue_ml": self.tissue_ml(),
            "values_per_mm": {
                name: values.summary(counts, self.slope, self.intercept) for name, counts in self._counts.items()
            },
            "clipped": values.clipped(self._counts["breast"]),
            "tissue_mean_per_mm": self._tissue_means(),
            "gland_against_adipose": self._contrast(Tissue.GLAND, Tissue.ADIPOSE),
            "mass_against_adipose": self._contrast(Tissue.MASS, Tissue.ADIPOSE),
            "texture": self._textures,
            "skin_line": self._skin,
        }

    def tissue_ml(self) -> dict[str, float]:
        """Volume of every tissue but air that occurs, ml."""
        ml = self.grid.voxel_volume / 1000.0
        return {t.name.lower(): int(self._voxels[t]) * ml for t in Tissue if t and self._voxels[t]}

    def _tissue_means(self) -> dict[str, float]:
        means = {t.name.lower(): self._tissues.mean(t) for t in Tissue}
        return {name: self.slope * m + self.intercept for name, m in means.items() if m is not None}

    def _contrast(self, tissue: Tissue, against: Tissue) -> Report | None:
        contrast = self._tissues.contrast(tissue, against)
        if contrast is None:
            return None
        scaled = Contrast(
            self.slope * contrast.inside + self.intercept,
            self.slope * contrast.background + self.intercept,
            self.slope * contrast.noise,
        )
        return {
            "difference_per_mm": scaled.difference,
            "noise_per_mm": scaled.noise,
            "cnr": scaled.cnr if scaled.noise else None,
            "voxels": self._tissues.count(tissue),
        }


def uniform(labels: Labels, grid: Grid, radius_mm: float) -> Labels:
    """1 where all labels of a slice within a square of ``radius_mm`` are the same and not air, else 0."""
    lowest = highest = labels
    for axis, spacing in ((0, grid.spacing[1]), (1, grid.spacing[0])):
        size = 2 * max(1, round(radius_mm / spacing)) + 1
        lowest = minimum_filter1d(lowest, size, axis)
        highest = maximum_filter1d(highest, size, axis)
    return np.asarray((lowest == highest) & (labels != Tissue.AIR), np.uint8)


def eroded(mask: NDArray[np.bool_], grid: Grid, radius_mm: float) -> NDArray[np.bool_]:
    """The mask less everything within a square of ``radius_mm`` of its outside; the chest wall is no border."""
    result = mask.view(np.uint8)
    for axis, spacing in ((0, grid.spacing[1]), (1, grid.spacing[0])):
        result = minimum_filter1d(result, 2 * max(1, round(radius_mm / spacing)) + 1, axis, mode="nearest")
    return np.asarray(result, np.bool_)
