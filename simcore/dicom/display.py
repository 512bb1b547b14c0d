"""How images are made to be looked at: thickness evened out, detail raised, turned as mammograms are hung.

Stored values: DISPLAY_BITS bits, 0 is black and air, the breast lies above.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from simcore.core.artifacts import Volume

DISPLAY_BITS = 12

AIR = 0.05
"""Line integrals below this are air, or a rim of skin too thin to be seen."""
ROLL_OFF_MM = 6.0
"""Over this distance the thickness of the breast is taken to vary slowly (standard deviation of a Gaussian)."""
EVENED = 0.8
"""Part of the missing thickness that is made up for near the edge of the breast."""
DETAIL_MM = 1.0
DETAIL_GAIN = 0.6
"""Structures smaller than DETAIL_MM are raised by this part."""
SYNTHETIC_ROLL_OFF_MM = 15.0
SYNTHETIC_DETAIL_MM = 3.0
SYNTHETIC_DETAIL_GAIN = 0.25
"""Part of the brightest detail along z (smaller than SYNTHETIC_DETAIL_MM) in a synthetic view."""
_COARSE_MM = 1.0
"""Slow variations are computed on pixels of about this size."""

Image = NDArray[np.float32]


def display_view(signal: NDArray[np.uint16], background: float, pixel_mm: float) -> NDArray[np.uint16]:
    """A projection as a mammogram: dense tissue bright, thickness near the edge evened out, detail raised.

    background: signal beside the breast.
    """
    integrals = np.log(np.float32(background) / np.maximum(signal, 1).astype(np.float32))
    breast = integrals > AIR
    if not breast.any():
        return np.zeros(signal.shape, np.uint16)
    thickness = _local_mean(integrals, breast, ROLL_OFF_MM, pixel_mm)
    full = np.float32(np.percentile(thickness[breast][::16], 60))
    evened = integrals + np.float32(EVENED) * np.maximum(full - thickness, 0.0)
    raised = evened + np.float32(DETAIL_GAIN) * (evened - ndimage.gaussian_filter(evened, DETAIL_MM / pixel_mm))
    return _stored(raised, breast)


def synthetic_view(volume: Volume, breast: NDArray[np.bool_]) -> NDArray[np.uint16]:
    """The volume seen along z: the mean of the slices, and of their detail the brightest.

    breast: bool (rows, columns), pixels that the breast covers.
    """
    pixel = volume.grid.spacing[0]
    total = np.zeros(breast.shape, np.float32)
    brightest = np.zeros(breast.shape, np.float32)
    for plane in volume.data:
        values = plane.astype(np.float32) * np.float32(volume.slope) + np.float32(volume.intercept)
        total += values
        np.maximum(brightest, values - _local_mean(values, breast, SYNTHETIC_DETAIL_MM, pixel), out=brightest)
    mean = total / np.float32(len(volume.data))
    evened = mean - _local_mean(mean, breast, SYNTHETIC_ROLL_OFF_MM, pixel)
    return _stored(evened + np.float32(SYNTHETIC_DETAIL_GAIN) * brightest, breast)


def hung(image: NDArray[Any], laterality: str) -> NDArray[Any]:
    """Turned as mammograms are looked at: chest wall at the left for a left breast, at the right for a right one, the
    outer or upper side of the breast on top.

    image: rows from chest wall to nipple; columns along the tube travel, which goes to the left of the patient.
    """
    return np.ascontiguousarray(image[::-1] if laterality == "L" else image[:, ::-1])


def _local_mean(image: Image, mask: NDArray[np.bool_], sigma_mm: float, pixel_mm: float) -> Image:
    """Gaussian mean of what lies in the mask, full size."""
    factor = max(1, round(_COARSE_MM / pixel_mm))
    weights = _reduced(mask.astype(np.float32), factor)
    values = _reduced(image * mask, factor)
    sigma = sigma_mm / (factor * pixel_mm)
    smooth = ndimage.gaussian_filter(values, sigma, mode="nearest")
    smooth /= np.maximum(ndimage.gaussian_filter(weights, sigma, mode="nearest"), np.float32(1e-6))
    return _enlarged(smooth, factor, image.shape)


def _reduced(image: Image, factor: int) -> Image:
    """Means over factor x factor pixels; the last ones are repeated where the image ends within a block."""
    pad = [(0, -n % factor) for n in image.shape]
    padded = np.pad(image, pad, mode="edge")
    rows, columns = (n // factor for n in padded.shape)
    return np.asarray(padded.reshape(rows, factor, columns, factor).mean(axis=(1, 3), dtype=np.float32))


def _enlarged(image: Image, factor: int, shape: tuple[int, ...]) -> Image:
    """Linear between the centres of the blocks of ``_reduced``."""
    for axis in (0, 1):
        position = np.clip((np.arange(shape[axis]) + 0.5) / factor - 0.5, 0, image.shape[axis] - 1)
        lower = np.minimum(position.astype(np.int64), max(image.shape[axis] - 2, 0))
        upper = np.minimum(lower + 1, image.shape[axis] - 1)
        weight = np.expand_dims((position - lower).astype(np.float32), 1 - axis)
        image = image.take(lower, axis) * (1 - weight) + image.take(upper, axis) * weight
    return image


def _stored(image: Image, breast: NDArray[np.bool_]) -> NDArray[np.uint16]:
    """Values of the breast spread over a quarter to the whole of the range, air 0."""
    if not breast.any():
        return np.zeros(image.shape, np.uint16)
    low, high = np.percentile(image[breast][::4], (1.0, 99.9))
    top = 2**DISPLAY_BITS - 1
    scaled = 0.25 + 0.65 * (image - np.float32(low)) / np.float32(max(high - low, 1e-6))
    return np.where(breast, np.rint(np.clip(scaled, 0.05, 1.0) * top), 0).astype(np.uint16)


def display_window(image: NDArray[np.uint16]) -> tuple[float, float]:
    """Stored values (low, high) between which the breast shows."""
    inside = image[image > 0]
    if not inside.size:
        return 0.0, float(2**DISPLAY_BITS - 1)
    low, high = np.percentile(inside[::4], (1.0, 99.9))
    return float(low) - 0.25 * float(high - low), float(max(high, low + 1.0))
