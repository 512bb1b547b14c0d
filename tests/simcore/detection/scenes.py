"""Stacks with a signal that is known everywhere."""

import numpy as np

from simcore.core.geometry import AcquisitionGeometry, Detector
from simcore.detection.spec import DetectionSpec, ElectronicNoise, FixedPattern, NoNoise
from simcore.detection.stack import Expected

PLAIN = DetectionSpec(focal_spot_mm=0.0, bits=16, gain_DN_per_keV=0.5, offset_DN=100.0)
"""The ideal detector with quantum noise and nothing else."""
SILENT = PLAIN.with_(noise=NoNoise())
KEV = 20.0


def geometry(
    views: int = 1, ny: int = 256, nx: int = 256, pixel: float = 0.1, half: float = 0.0
) -> AcquisitionGeometry:
    """Tube angles over +-half degrees about a pivot on the detector, 660 mm away."""
    angles = np.linspace(-half, half, views) if views > 1 else np.array([half])
    turn = np.deg2rad(angles)
    sources = 660.0 * np.stack([np.zeros(views), np.sin(turn), np.cos(turn)], axis=1)
    return AcquisitionGeometry(angles, sources, Detector(ny, nx, pixel), np.zeros(views), 0.0, 660.0, 20.0)


def uniform(place: AcquisitionGeometry, quanta: float, keV: float = KEV, flat: float | None = None) -> Expected:
    """So many absorbed photons a pixel of one energy."""
    shape = (place.views, place.detector.ny, place.detector.nx)
    signal = np.full(shape, quanta * keV, np.float32)
    open_field = np.full(shape[1:], quanta * keV if flat is None else flat, np.float32)
    return Expected(signal, np.float32(keV) * signal, open_field)


def noisy(**changes: object) -> DetectionSpec:
    return PLAIN.with_(**changes)


ELECTRONICS = ElectronicNoise(sigma=2000.0)
SPOTTED = FixedPattern(serial=3, gain_spread=0.03, column_spread=0.01, dead_fraction=0.001, dead_columns=2)
