"""The filter of every view along the tube travel, and the weights that turn it into attenuation.

Filters (T. Mertelmeier, J. Orman, W. Haerer, M. K. Dudam, "Optimizing filtered backprojection reconstruction for a
breast tomosynthesis prototype device", Proc. SPIE 6142 (2006) 61420F; the design is that of G. Lauritsch and
W. Haerer, "Theoretical framework for filtered back projection in tomosynthesis", Proc. SPIE 3338 (1998) 1127)::

    H(f_y, f_z) = |f_y|                                    inverse of projection and backprojection (ramp)
                  x (1 + cos(pi f_y / A)) / 2,  |f_y| < A   spectral filter, a Hann window
                  x (1 + cos(pi f_z / B)) / 2,  |f_z| < B   slice thickness filter, a Hann window

A view taken at the tube angle a knows the object's spectrum on f_z = f_y tan(a) alone (central slice theorem), so
the slice thickness filter is one along f_y as well, different for every view. A is ``hann_cutoff`` times the Nyquist
frequency of the detector, B ``slice_cutoff`` times that of the slices, 1 / (2 slice_mm).

Normalisation: not a free scale as in the paper but the inversion formula of parallel rays,

    mu(r) = sum over lines (theta, s) of p(theta, s) h(r.n - s) ds dtheta,

written for the coordinates at hand, tube angle a and detector coordinate v: with source (s_y, s_z), pivot height c,
distance L from source to detector pixel, and a slice at z,

    ds dtheta = |S'.n| s_z / L^2 da dv,   S'.n L = (s_z - c) s_z - s_y (v - s_y),
    h(r.n - s) = L^2 / (s_z - z)^2 h(v_r - v)              (the ramp is homogeneous of degree -2)

(on an arc; any other path in the plane x = 0 has another S' = dS/da),

    mu(r) = sum over views  da m(z)^2  [ p(v) w(v) * h ](v_r),   w = (S'.n L) / (s_z L),  m = s_z / (s_z - z).

Off the plane x = 0 the same holds with L to the pixel itself (the cosine weight of L. A. Feldkamp, L. C. Davis,
J. W. Kress, J. Opt. Soc. Am. A 1 (1984) 612): exact for objects that do not change along x.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from simcore.core.errors import GeometryError
from simcore.core.geometry import AcquisitionGeometry
from simcore.kernels import njit
from simcore.reconstruction.filter.fourier import convolve_columns
from simcore.reconstruction.kinds.fbp import FilteredBackprojection

FloatArray = NDArray[np.float32]
ARC_MM = 1e-6
"""Sources whose distances from the isocenter differ by less lie on an arc."""
WINDOWS = {"hann": 0.5, "hamming": 0.54}
"""Apodisation of the ramp: value of the window half way to its cutoff."""


def angular_steps(angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """The part of the angular range that each view stands for, radian, (views,): half the distance of its two
    neighbours; a whole step for the first and last view.

    angles: degrees, in any order, at least two.
    """
    order = np.argsort(angles, kind="stable")
    steps = np.empty(len(angles))
    steps[order] = np.gradient(np.deg2rad(angles[order]))
    return steps


def padded_length(ny: int) -> int:
    """Length of the Fourier transforms: no wrap-around of a filter as long as the detector."""
    return int(scipy.fft.next_fast_len(2 * ny - 1, real=True))


def frequency_response(
    length: int, pixel: float, spec: FilteredBackprojection, tan_angle: float, magnification: float
) -> FloatArray:
    """Ramp x window x slice thickness at the frequencies of a real transform, 1/mm, float32 (length // 2 + 1,).

    length: padded length of a column. pixel: mm. tan_angle: of the view's tube angle about the pivot.
    magnification: of the middle of the volume; turns frequencies on the detector into those of the object.
    Without a ramp (filter "none") the response has no unit.
    """
    frequency = scipy.fft.rfftfreq(length, pixel)
    response = np.ones_like(frequency)
    if spec.filter != "none":
        response = _ramp(length, pixel) / (1.0 + (spec.regularisation_mm * frequency) ** 2)
    if spec.filter in WINDOWS:
        response *= _window(frequency, spec.hann_cutoff / (2 * pixel), WINDOWS[spec.filter])
    if spec.slice_thickness_filter:
        depth_frequency = frequency * magnification * abs(tan_angle)
        response *= _window(depth_frequency, spec.slice_cutoff / (2 * spec.slice_mm), WINDOWS["hann"])
    return response.astype(np.float32)


def _ramp(length: int, pixel: float) -> NDArray[np.float64]:
    """|f| as the transform of its band-limited kernel (A. C. Kak, M. Slaney, Principles of Computerized Tomographic
    Imaging, 1988, equation 3.61): sampling |f| itself would lose the mean value."""
    lag = np.minimum(np.arange(length), length - np.arange(length))
    kernel = np.zeros(length)
    kernel[lag % 2 == 1] = -1.0 / (np.pi * lag[lag % 2 == 1] * pixel) ** 2
    kernel[0] = 1.0 / (4.0 * pixel**2)
    return np.asarray(scipy.fft.rfft(kernel).real * pixel)


def _window(frequency: NDArray[np.float64], cutoff: float, middle: float) -> NDArray[np.float64]:
    """middle + (1 - middle) cos(pi f / cutoff) below the cutoff, zero from there on."""
    return np.where(frequency < cutoff, middle + (1.0 - middle) * np.cos(np.pi * frequency / cutoff), 0.0)


def ray_weights(geometry: AcquisitionGeometry, view: int, columns: slice) -> FloatArray:
    """w = (S'.n L) / (s_z L) for the pixels of some detector columns, float32 (ny, columns)."""
    _, source_y, source_z = geometry.sources[view]
    across = geometry.detector.y_centres() - source_y
    along_y, along_z = _motion(geometry, view)
    numerator = np.abs(along_y * source_z + along_z * across) / source_z
    squared = (across**2 + source_z**2).astype(np.float32)
    x = geometry.detector.x_centres()[columns]
    return np.asarray(_over_length(numerator.astype(np.float32), squared, (x**2).astype(np.float32)))


@njit(cache=True, nogil=True, error_model="numpy")
def _over_length(numerator: FloatArray, squared: FloatArray, x_squared: FloatArray) -> FloatArray:
    """numerator / sqrt(squared + x_squared), (rows, columns)."""
    weights = np.empty((len(numerator), len(x_squared)), np.float32)
    for j in range(len(numerator)):
        for i in range(len(x_squared)):
            weights[j, i] = numerator[j] / np.sqrt(squared[j] + x_squared[i])
    return weights


def _motion(geometry: AcquisitionGeometry, view: int) -> tuple[float, float]:
    """S', the change of the source's y and z with the tube angle, mm per radian; of a listed path by differences.

    raises: GeometryError where a path that is no arc has two views at one angle.
    """
    y, z = geometry.sources[:, 1], geometry.sources[:, 2] - geometry.isocenter_height
    if np.ptp(np.hypot(y, z)) < ARC_MM:
        return float(z[view]), -float(y[view])
    order = np.argsort(geometry.angles, kind="stable")
    angles = np.deg2rad(geometry.angles[order])
    if np.any(np.diff(angles) < 1e-9):
        raise GeometryError(
            "two views stand at the same tube angle on a path that is no arc about the isocenter; filtered "
            "back-projection needs different angles there: move a source_mm, or take an iterative reconstruction"
        )
    at = int(np.flatnonzero(order == view)[0])
    ends: Literal[1, 2] = 2 if len(angles) > 2 else 1
    y_motion, z_motion = (np.gradient(c[order], angles, edge_order=ends)[at] for c in (y, z))
    return float(y_motion), float(z_motion)


def chord_weights(geometry: AcquisitionGeometry, view: int, columns: slice, thickness_mm: float) -> FloatArray:
    """One over the length of rays between two planes parallel to the detector, 1/mm, float32 (ny, columns).

    thickness_mm: distance of the planes.
    """
    x, y, z = geometry.sources[view]
    across = (geometry.detector.y_centres() - y)[:, None] ** 2 + (geometry.detector.x_centres()[columns] - x) ** 2
    return np.asarray(z / (thickness_mm * np.sqrt(across + z**2)), np.float32)


def filter_columns(
    weighted: FloatArray, response: FloatArray, length: int, out: FloatArray, extend: bool = False
) -> None:
    """Every column of float32 (ny, columns) convolved with the filter, into ``out``, of the same shape.

    extend: beyond the detector the values of its edges go on, fading out; else they are zero there.
    """
    convolve_columns(_extended(weighted, length) if extend else weighted, response, length, out)


def _extended(columns: FloatArray, length: int) -> FloatArray:
    """float32 (length, n): beyond its last row each column fades out by a cosine, then in to its first, as the
    transform goes round."""
    ny = columns.shape[0]
    beyond = length - ny
    fading = np.cos(np.pi * (np.arange(beyond) + 0.5) / beyond).astype(np.float32)[:, None]
    extension = np.maximum(fading, 0) * columns[-1] + np.maximum(-fading, 0) * columns[0]
    return np.concatenate([columns, extension])
