"""From noisy maps of scatter to smooth ones, by a model of where photons scatter and not by a blur.

    M = sum over s of G_s * (P t) (1, x, y^2, y)  +  sum over s of G_s * (P t_plates)

P the primary, t the optical thickness along its ray: P t is about how often photons scatter there; G_s spreads by s
mm. Plates have terms of their own, since they stand elsewhere. With views on an arc the coefficients are quadratics of
the angle, so that all views share their photons. Weighted least squares with a weak ridge over the
whole detector (over the shadow alone the maps are 10 % off beside it); what the model leaves is
smoothed as the ratio of the maps, in the plane and over neighbouring views.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from simcore.transport.primary import PrimaryMaps

FloatArray = NDArray[np.float64]
SPREADS_MM = (4.0, 10.0, 20.0, 40.0, 80.0)
WEIGHT_MM = 20.0
RATIO_MM = 15.0
RATIO_VIEWS = 2.0
RIDGE = 1e-3
SCALE_MM = 100.0
SHARED_FROM = 4
"""Views from which on they are fitted together."""
LEAST = 1e-6
LEAST_WEIGHT = 1e-3


def denoised(signal: FloatArray, maps: PrimaryMaps, sides: tuple[float, float], along: FloatArray | None) -> FloatArray:
    """Smooth maps.

    signal: (views, rows, columns), scatter with its noise. maps: of the same shape. sides: of a cell, mm.
    along:  (views,), position of the source along its way in any unit; None fits each view by itself.
    returns: the same shape.
    """
    if along is None or len(signal) < SHARED_FROM or not np.ptp(along) > 0:
        return np.concatenate([_fitted(signal[v : v + 1], maps.of(v), sides, None) for v in range(len(signal))])
    return _fitted(signal, maps, sides, along)


def _fitted(signal: FloatArray, maps: PrimaryMaps, sides: tuple[float, float], along: FloatArray | None) -> FloatArray:
    mean = _spread(signal, WEIGHT_MM, sides)
    if not mean.max() > 0:
        return mean
    # The variance of a map of counts goes with the signal.
    weight = 1 / np.sqrt(np.maximum(mean, LEAST_WEIGHT * mean.max())).ravel()
    columns = list(_terms(maps, sides, along))
    rows = np.stack([column.ravel() * weight for column in columns])
    norms = np.sqrt(np.einsum("ij,ij->i", rows, rows))
    norms[norms == 0] = 1.0
    rows /= norms[:, None]
    # einsum, not a matrix product of BLAS: its sums do not depend on the number of threads.
    normal = np.einsum("ik,jk->ij", rows, rows) + RIDGE / rows.shape[1] * np.eye(len(rows))
    coefficients = np.linalg.solve(normal, np.einsum("ik,k->i", rows, signal.ravel() * weight)) / norms
    model = np.zeros_like(signal)
    for coefficient, column in zip(coefficients, columns, strict=True):
        model += coefficient * column
    model = np.maximum(model, LEAST * mean.max())
    return np.asarray(model * _smooth(signal, sides) / _smooth(model, sides))


def _terms(maps: PrimaryMaps, sides: tuple[float, float], along: FloatArray | None) -> Iterator[FloatArray]:
    rows, columns = maps.signal.shape[1:]
    y = ((np.arange(rows) + 0.5) * sides[0] - rows * sides[0] / 2)[:, None] / SCALE_MM
    x = ((np.arange(columns) + 0.5) * sides[1])[None, :] / SCALE_MM
    powers: list[FloatArray] = [np.ones(1)]
    if along is not None:
        place = 2 * (along - along.min()) / np.ptp(along) - 1
        powers = [place**power for power in range(3)]
    breast, plates = maps.signal * maps.tissue, maps.signal * maps.plates
    for spread in SPREADS_MM:
        for factor in (np.ones_like(x), x, y * y, y):
            term = _spread(breast * factor, spread, sides)
            yield from (term * power[:, None, None] for power in powers)
        if plates.any():
            term = _spread(plates, spread, sides)
            yield from (term * power[:, None, None] for power in powers)


def _smooth(maps: FloatArray, sides: tuple[float, float]) -> FloatArray:
    from scipy.ndimage import gaussian_filter1d

    smooth = _spread(maps, RATIO_MM, sides)
    if len(maps) < SHARED_FROM:
        return smooth
    return np.asarray(gaussian_filter1d(smooth, RATIO_VIEWS, axis=0, mode="nearest"))


def _spread(maps: FloatArray, spread: float, sides: tuple[float, float]) -> FloatArray:
    """The maps spread by a Gaussian in the plane, nothing coming from outside."""
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(maps, (0, spread / sides[0], spread / sides[1]), mode="constant"))
