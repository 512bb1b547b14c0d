"""Contrast and contrast-to-noise ratio of an object, and of tissues against one another.

The noise of a simulation without quantum noise is the anatomical background: the standard deviation of the tissue
around the object (A. E. Burgess, F. L. Jacobson, P. F. Judy, "Human observer detection experiments with mammograms
and power-law noise", Med. Phys. 28 (2001) 419).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.core.grid import Grid
from simcore.quality.profiles import distances


@dataclass(frozen=True)
class Contrast:
    """An object against its background, in the unit of the image.

    difference: mean inside - mean of the background. noise: standard deviation of the background.
    """

    inside: float
    background: float
    noise: float

    @property
    def difference(self) -> float:
        return self.inside - self.background

    @property
    def relative(self) -> float:
        """Difference over background (Weber contrast); infinite on a background of 0."""
        return self.difference / self.background if self.background else math.inf

    @property
    def cnr(self) -> float:
        """Difference over noise; infinite without noise."""
        return self.difference / self.noise if self.noise else math.inf


def disk_contrast(
    image: NDArray[np.generic],
    grid: Grid,
    centre: tuple[float, float],
    radius_mm: float,
    margin_mm: float = 0.5,
    background_mm: float | None = None,
) -> Contrast:
    """A disk in one slice (ny, nx) against the ring around it.

    centre: (x, y), mm. margin_mm: left out on both sides of the disk's edge.
    background_mm: outer radius of the ring; twice that of the disk where not given.
    raises: ValueError where disk or ring hold no pixel.
    """
    outer = 2 * radius_mm if background_mm is None else background_mm
    distance = distances(grid, *centre)
    disk = np.asarray(image[distance <= radius_mm - margin_mm], np.float64)
    ring = np.asarray(image[(distance >= radius_mm + margin_mm) & (distance <= outer)], np.float64)
    if disk.size == 0 or ring.size < 2:
        raise ValueError(
            f"a disk of radius {radius_mm:g} mm with a margin of {margin_mm:g} mm and a ring up to {outer:g} mm hold "
            f"{disk.size} and {ring.size} pixels of {grid.spacing[0]:g} mm"
        )
    return Contrast(float(disk.mean()), float(ring.mean()), float(ring.std()))


class TissueValues:
    """Running mean and standard deviation of the values of every tissue, fed slice by slice.

    One row a slice, so that slow changes between slices do not count as noise.
    """

    def __init__(self, tissues: int) -> None:
        self._tissues = tissues
        self._slices: list[tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]] = []

    def add(self, values: NDArray[np.generic], labels: NDArray[np.uint8]) -> None:
        """values, labels: one-dimensional, of the voxels of one slice."""
        wide = np.asarray(values, np.float64)
        count, total, squares = (
            np.bincount(labels, weights, self._tissues).astype(np.float64) for weights in (None, wide, wide * wide)
        )
        self._slices.append((count, total, squares))

    def count(self, tissue: int) -> int:
        return int(sum(count[tissue] for count, _, _ in self._slices))

    def mean(self, tissue: int) -> float | None:
        """Over all slices; None where the tissue does not occur."""
        count = self.count(tissue)
        return float(sum(total[tissue] for _, total, _ in self._slices)) / count if count else None

    def contrast(self, tissue: int, against: int) -> Contrast | None:
        """One tissue against another, slice by slice; None where they never share a slice.

        Means and variances of the slices are weighted with the number of voxels of the rarer tissue of the slice;
        the noise is the root of the mean variance of the two tissues.
        """
        weights, means, variances = [], [], []
        for count, total, squares in self._slices:
            weight = min(count[tissue], count[against])
            if weight < 2:
                continue
            pair = [tissue, against]
            mean = total[pair] / count[pair]
            weights.append(weight)
            means.append(mean)
            variances.append(np.maximum(squares[pair] / count[pair] - mean**2, 0.0).mean())
        if not weights:
            return None
        inside, background = np.average(means, axis=0, weights=weights)
        return Contrast(float(inside), float(background), math.sqrt(float(np.average(variances, weights=weights))))
