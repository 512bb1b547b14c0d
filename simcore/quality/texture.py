"""Texture of breast images: the exponent beta of a power law, spectrum ~ 1 / f^beta.

Protocol of the published values (A. E. Burgess, F. L. Jacobson, P. F. Judy, "Human observer detection experiments
with mammograms and power-law noise", Med. Phys. 28 (2001) 419; L. Chen, J. M. Boone et al., "Anatomical complexity
in breast parenchyma and its implications for optimal breast imaging strategies", Med. Phys. 39 (2012) 1435): squares
of 256 x 256 pixels, detrended, Hann window, periodogram averaged over all directions, straight line through
(ln f, ln power) between 0.2 and 0.7 per mm. The size of a pixel decides how many frequencies lie in that band, so
every result names it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from simcore.core.artifacts import Report

BAND = (0.2, 0.7)
"""Frequencies of the fit, 1/mm."""
ROI_PIXELS = 256
SMALLEST_ROI_PIXELS = 32
MIN_FREQUENCIES = 4
"""A straight line through fewer rings of frequencies says nothing."""

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Texture:
    """Exponents of the regions of one image.

    betas:      float64 (rois,); empty where no region fits into the mask.
    roi_pixels: edge of a region, pixels. pixel_mm: edge of a pixel, mm.
    """

    betas: FloatArray
    roi_pixels: int
    pixel_mm: float

    def report(self) -> Report:
        """Mean and standard deviation over the regions, and what was measured; beta is None without a region."""
        measured = len(self.betas) > 0
        return {
            "beta": float(self.betas.mean()) if measured else None,
            "beta_std": float(self.betas.std(ddof=1)) if len(self.betas) > 1 else None,
            "rois": len(self.betas),
            "roi_pixels": self.roi_pixels,
            "roi_mm": self.roi_pixels * self.pixel_mm,
            "pixel_mm": self.pixel_mm,
        }


def detrended(image: NDArray[np.generic]) -> FloatArray:
    """The image less the plane that fits it best (least squares); same shape."""
    values = np.asarray(image, np.float64)
    rows, columns = (np.arange(n) - (n - 1) / 2 for n in values.shape)
    # On a full rectangle rows, columns and the constant are orthogonal, so each slope is a projection.
    centred = values - values.mean()
    down = (rows @ centred).sum() / (values.shape[1] * (rows @ rows))
    across = (centred @ columns).sum() / (values.shape[0] * (columns @ columns))
    return np.asarray(centred - down * rows[:, None] - across * columns)


def periodogram(image: NDArray[np.generic], pixel_mm: float) -> FloatArray:
    """|Fourier transform|^2 of the detrended, Hann-windowed image per area, mm^2 x unit^2, in the order of fft2.

    The mean over independent images of white noise of variance v is v pixel_mm^2 at every frequency (but the lowest,
    which detrending removes).
    """
    values = detrended(image)
    window = np.outer(*(np.sin(np.pi * (np.arange(n) + 0.5) / n) ** 2 for n in values.shape))
    spectrum = scipy.fft.fft2(values * window)
    return np.asarray((spectrum.real**2 + spectrum.imag**2) * pixel_mm**2 / (window**2).sum())


def ring_average(power: FloatArray, pixel_mm: float) -> tuple[FloatArray, FloatArray]:
    """Mean of a square spectrum over rings one frequency step wide: (mean frequency [1/mm], mean power) per ring.

    power: float64 (n, n) in the order of fft2. Rings reach from the first step to the Nyquist frequency.
    """
    n = power.shape[0]
    if power.shape != (n, n):
        raise ValueError(f"spectrum has shape {power.shape}; a square one is needed")
    frequency = scipy.fft.fftfreq(n, pixel_mm)
    radius = np.hypot(frequency[:, None], frequency)
    ring = np.rint(radius * n * pixel_mm).astype(np.int64)
    inside = (ring >= 1) & (ring < n // 2)
    count = np.bincount(ring[inside])[1:]
    mean_frequency = np.bincount(ring[inside], radius[inside])[1:] / count
    return mean_frequency, np.bincount(ring[inside], power[inside])[1:] / count


def power_law_exponent(roi: NDArray[np.generic], pixel_mm: float, band: tuple[float, float] = BAND) -> float:
    """beta of one square region; shape (n, n), any unit.

    raises: ValueError where fewer than MIN_FREQUENCIES rings of frequencies lie in the band, or the region is flat.
    """
    frequency, power = ring_average(periodogram(roi, pixel_mm), pixel_mm)
    inside = (frequency >= band[0]) & (frequency <= band[1])
    if inside.sum() < MIN_FREQUENCIES:
        raise ValueError(
            f"{roi.shape[0]} pixels of {pixel_mm:g} mm give {inside.sum()} frequencies in {band[0]:g}..{band[1]:g} "
            f"per mm; at least {MIN_FREQUENCIES} are needed: take a larger region or smaller pixels"
        )
    if not np.all(power[inside] > 0):
        raise ValueError("the region is flat: it has no texture")
    slope, _ = np.polyfit(np.log(frequency[inside]), np.log(power[inside]), 1)
    return -float(slope)


def regions_inside(mask: NDArray[np.bool_], size: int) -> list[tuple[slice, slice]]:
    """Squares of ``size`` pixels that lie wholly in the mask, on a lattice of half their size, row by row.

    The lattice starts at the corner of the mask's bounding box, so the choice depends on the mask alone.
    """
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        return []
    total = np.pad(np.cumsum(np.cumsum(mask, axis=0, dtype=np.int64), axis=1), ((1, 0), (1, 0)))
    regions = []
    for top in range(int(rows[0]), int(rows[-1]) + 2 - size, size // 2):
        for left in range(int(columns[0]), int(columns[-1]) + 2 - size, size // 2):
            bottom, right = top + size, left + size
            if total[bottom, right] - total[top, right] - total[bottom, left] + total[top, left] == size * size:
                regions.append((slice(top, bottom), slice(left, right)))
    return regions


def texture(image: NDArray[np.generic], mask: NDArray[np.bool_], pixel_mm: float) -> Texture:
    """beta of all regions of an image inside a mask of the same shape.

    Regions have 256 x 256 pixels; where none fits, half as many along each edge, and so on down to 32.
    """
    size = ROI_PIXELS
    while not (regions := regions_inside(mask, size)) and size > SMALLEST_ROI_PIXELS:
        size //= 2
    betas = []
    for region in regions:
        try:
            betas.append(power_law_exponent(image[region], pixel_mm))
        except ValueError:
            continue
    return Texture(np.array(betas), size, pixel_mm)
