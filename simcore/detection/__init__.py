"""The detector: from absorbed energy to raw and flat-fielded numbers.

detection.response gives what a photon leaves in the converter: the weights of signal and variance.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from simcore.core.progress import Progress, silent
from simcore.detection.spec import DetectionSpec
from simcore.detection.systems import detector_of, systems

if TYPE_CHECKING:  # whoever reads a specification needs no numerics
    from simcore.core.geometry import AcquisitionGeometry
    from simcore.detection.stack import DetectedStack, Expected

__all__ = ["DetectionSpec", "detect", "detector_of", "systems"]


def detect(
    expected: Expected,
    spec: DetectionSpec,
    geometry: AcquisitionGeometry,
    seed: int,
    progress: Progress = silent,
) -> DetectedStack:
    """Raw and flat-fielded numbers of every view.

    expected: noise-free signal, its variance, open field. seed: of the case; with ``noise.realisation`` it decides the
        noise. The fixed pattern hangs on ``pattern.serial`` alone.
    report: gain_DN_per_keV, electronic_keV, largest_DN, dead_pixels, and of every view in ``views``: saturated_pixels,
        pixels_at_zero, mean_DN, snr (median over pixels, noise-free), fewest_quanta, processed_above, processed_below;
        ``remarks``: sentences on what was cut.
    raises: SpecError where the exposure saturates the detector, or a table does not fit its pixels; ValueError where
        arrays do not fit the geometry.
    """
    # Here and not above: the specification is read where nothing may load compiled code.
    from simcore.detection.stage import detect_views

    return detect_views(expected, spec, geometry, seed, progress)
