"""SART, OS-SART and SIRT: x <- x + relaxation C A' R (p - A x), R and C the inverse row and column sums.

A is the interpolation of slices along rays, without the lengths of rays: both sides of each ray's equation are divided
by its length within one slice. Then row and column sums are products of one-dimensional ones (``corrections``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import ProjectionStack, Volume
from simcore.core.progress import Progress, silent
from simcore.reconstruction.body import Body
from simcore.reconstruction.kinds.sart import Sart
from simcore.reconstruction.kinds.sirt import Sirt
from simcore.reconstruction.methods.iterative import Correction, Measurement, iterate
from simcore.reconstruction.methods.subsets import subset_sums, view_sums
from simcore.reconstruction.operators.corrections import algebraic_residuals, correct_by_sums

FloatArray = NDArray[np.float32]


def algebraic_reconstruction(
    stack: ProjectionStack,
    spec: Sart | Sirt,
    body: Body,
    progress: Progress = silent,
) -> Volume:
    """See ``simcore.reconstruction.reconstruct``. report: misfit, sum of (residual)^2 / row sum before every pass.

    With all views in one subset the misfit never rises for 0 < relaxation < 2 (Gregor, Benson 2008).
    """
    return iterate(
        stack,
        spec,
        spec.iterations,
        spec.views_per_subset if isinstance(spec, Sart) else stack.geometry.views,
        body,
        lambda measurement: algebraic_correction(measurement, spec.relaxation, spec.non_negative),
        progress,
    )


def algebraic_correction(measurement: Measurement, relaxation: float, non_negative: bool) -> Correction:
    """One step of SART (a subset of one view), OS-SART or SIRT (a subset of all views)."""
    crossings = measurement.crossings
    floor = np.float32(0.0 if non_negative else -np.inf)

    def correct(volume: FloatArray, views: NDArray[np.int64]) -> float:
        shares = np.empty((len(views), *measurement.integrals.shape[1:]), np.float32)
        misfit = 0.0
        for share, view in zip(shares, views, strict=True):
            crossings.project(volume, int(view), share)
            sums = view_sums(crossings, int(view))
            squares = algebraic_residuals(share, measurement.integrals[view], sums.along_y, sums.along_x, sums.lengths)
            misfit += float(squares.sum())
        subset = subset_sums(crossings, views)
        correct_by_sums(shares, subset.gathering, subset.along_y, subset.along_x, np.float32(relaxation), floor, volume)
        return misfit

    return correct
