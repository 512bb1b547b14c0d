"""Maximum likelihood for transmission by separable paraboloidal surrogates.

Counts y of mean b exp(-l), l = A x, have the negative log-likelihood sum of b exp(-l) + y l. Each term is bounded from
above by a parabola that touches it at the present l, with the least curvature that keeps it above for all l >= 0,

    c(l) = 2 b (1 - exp(-l) - l exp(-l)) / l^2,

and the sum of parabolas by one that is separable in the voxels (H. Erdogan, J. A. Fessler, Phys. Med. Biol. 44 (1999)
2835, equations 15, 21 and 26). Its minimum is the next volume:

    x <- x + A' (b exp(-l) - y) / A' (c (A 1)).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import ProjectionStack, Volume
from simcore.core.progress import Progress, silent
from simcore.reconstruction.body import Body
from simcore.reconstruction.kinds.ml import MaximumLikelihood
from simcore.reconstruction.methods.iterative import Correction, Measurement, iterate
from simcore.reconstruction.methods.subsets import view_sums
from simcore.reconstruction.operators.corrections import correct_by_curvature, likelihood_terms

FloatArray = NDArray[np.float32]


def maximum_likelihood(
    stack: ProjectionStack, spec: MaximumLikelihood, body: Body, progress: Progress = silent
) -> Volume:
    """See ``simcore.reconstruction.reconstruct``. report: misfit, the distance of the log-likelihood from that of the
    measured values themselves before every pass, per quantum of the open beam.

    With all views in one subset, relaxation 1 and non_negative the likelihood never falls.
    """
    return iterate(
        stack,
        spec,
        spec.iterations,
        spec.views_per_subset or stack.geometry.views,
        body,
        lambda measurement: likelihood_correction(measurement, spec.relaxation, spec.non_negative),
        progress,
    )


def likelihood_correction(measurement: Measurement, relaxation: float, non_negative: bool) -> Correction:
    crossings = measurement.crossings
    floor = np.float32(0.0 if non_negative else -np.inf)

    def correct(volume: FloatArray, views: NDArray[np.int64]) -> float:
        slopes = np.empty((len(views), *measurement.integrals.shape[1:]), np.float32)
        curvatures = np.empty_like(slopes)
        misfit = 0.0
        for slope, curvature, view in zip(slopes, curvatures, views, strict=True):
            crossings.project(volume, int(view), slope)
            sums = view_sums(crossings, int(view))
            distances = likelihood_terms(
                slope, measurement.integrals[view], sums.along_y, sums.along_x, sums.lengths, curvature
            )
            misfit += float(distances.sum())
        correct_by_curvature(slopes, curvatures, crossings.gathering(views), np.float32(relaxation), floor, volume)
        return misfit

    return correct
