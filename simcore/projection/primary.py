"""The projection stage with a spectrum: a compressed phantom, an acquisition and a beam in, the primary signal out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import Phantom, Primary
from simcore.core.geometry import AcquisitionGeometry
from simcore.core.progress import Progress
from simcore.projection.integrals import basis_integrals
from simcore.projection.spec import AcquisitionSpec
from simcore.projection.spectral import Beam, pixel_sums
from simcore.projection.stage import bounds, placed

OPEN_CELL_MM = 5.0
"""The signal without breast is smooth: means over cells of about this edge are enough."""


def project_primary(
    phantom: Phantom,
    acquisition: AcquisitionSpec,
    basis: NDArray[np.float64],
    beam: Beam,
    progress: Progress,
) -> Primary:
    """See simcore.projection.project_spectrum."""
    geometry, borders, _, shadows, beyond = placed(phantom, acquisition, np.abs(basis).sum(axis=0))
    detector = geometry.detector
    signal = np.empty((geometry.views, detector.ny, detector.nx), np.float32)
    ratio = np.empty(signal.shape, np.float16)
    variance = np.empty(signal.shape[1:], np.float32)
    integrals = np.empty((len(basis), *signal.shape[1:]), np.float32)
    for view in range(geometry.views):
        progress(view / geometry.views, f"view {view + 1} of {geometry.views}")
        basis_integrals(phantom, geometry, view, basis, borders=borders, out=integrals)
        pixel_sums(integrals, beam, geometry, view, signal[view], variance)
        np.divide(variance, signal[view], out=variance)
        ratio[view] = variance
    open_signal, open_variance = open_field(geometry, beam)
    progress(1.0, "projected")
    report = {
        "energies_keV": beam.energies_keV.tolist(),
        "least_transmission": float(np.min(signal.min(axis=(1, 2)) / open_signal.max(axis=(1, 2)))),
        "truncated": bool(beyond),
        "shadow_mm": bounds(shadows),
    }
    return Primary(signal, ratio, open_signal, open_variance, geometry, report)


def open_field(geometry: AcquisitionGeometry, beam: Beam) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Signal and variance of a pixel without breast, float32 (views, rows, columns), over coarse cells."""
    detector = geometry.detector
    rows, columns = (max(4, round(n * detector.pixel / OPEN_CELL_MM)) for n in (detector.ny, detector.nx))
    # The middle of a cell of 5 mm stands for its mean within 1e-5.
    j = (np.arange(rows) + 0.5) * detector.ny / rows - 0.5
    i = (np.arange(columns) + 0.5) * detector.nx / columns - 0.5
    sums = np.empty((2, geometry.views, rows, columns))
    for view in range(geometry.views):
        down = j[:, None] * detector.pixel * geometry.detector_frame(view)[1][:, None, None]
        across = i * detector.pixel * geometry.column_direction(view)[:, None, None]
        ray = (geometry.pixel_position(view, 0, 0) - geometry.sources[view])[:, None, None] + down + across
        length = np.sqrt(np.sum(ray**2, axis=0))
        cosine = np.abs(np.tensordot(geometry.normal(view), ray, 1)) / length
        shares = np.exp(-beam.plates[:, None, None] * (length / np.abs(ray[2])))
        solid = detector.pixel**2 * cosine / length**2 * np.interp(cosine, beam.cosines, beam.absorption)
        sums[:, view] = np.tensordot(beam.weights, shares, 1) * solid
    signal, variance = sums.astype(np.float32)
    return signal, variance
