"""What goes into the detection of a stack and what comes out."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import Report, frozen
from simcore.core.geometry import AcquisitionGeometry

FloatArray = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Expected:
    """Noise-free energy that the converter absorbs, primary and scatter together, float32.

    signal:   (views, ny, nx), keV a pixel. variance: the same, keV^2.
    flat:     (ny, nx) or (views, ny, nx), keV a pixel with nothing but the plates in the beam.
    flat_variance: in the shape of flat; needed where the flat field is of a number of frames.
    object_height_mm: middle of the breast above the detector, for the blur of the focal spot.
    rays_per_pixel_edge: the signal of a pixel is the mean over n x n rays.
    """

    signal: FloatArray
    variance: FloatArray
    flat: FloatArray
    flat_variance: FloatArray | None = None
    object_height_mm: float = 45.0
    rays_per_pixel_edge: int = 1

    def __post_init__(self) -> None:
        for array in (self.signal, self.variance, self.flat, self.flat_variance):
            if array is not None:
                frozen(array)

    def flat_of(self, view: int) -> FloatArray:
        """(ny, nx)"""
        return self.flat if self.flat.ndim == 2 else self.flat[view]

    def check(self, geometry: AcquisitionGeometry) -> None:
        """raises: ValueError naming what does not fit"""
        detector = geometry.detector
        one = (detector.ny, detector.nx)
        shape = (geometry.views, *one)
        for name, array, shapes in (
            ("signal", self.signal, [shape]),
            ("variance", self.variance, [shape]),
            ("flat", self.flat, [one, shape]),
            ("flat_variance", self.flat_variance, [self.flat.shape]),
        ):
            if array is None:
                continue
            if array.shape not in shapes:
                raise ValueError(f"{name} has shape {array.shape}; the geometry needs {' or '.join(map(str, shapes))}")
            if array.dtype != np.float32:
                raise ValueError(f"{name} is {array.dtype}; float32 is needed")
            lowest = float(array.min())
            if not lowest >= 0 or not np.isfinite(array.max()):
                raise ValueError(
                    f"{name} reaches from {lowest:g} to {array.max():g}; it must be finite and not below 0"
                )
        if not self.flat.min() > 0:
            raise ValueError("flat is 0 in some pixels: there nothing can be flat-fielded")


@dataclass(frozen=True, eq=False)
class DetectedStack:
    """What a detector gives.

    raw:        uint16 (views, ny, nx), DN.
    processed:  uint16 (views, ny, nx), flat-fielded (For Processing): open_field_value x signal over open field.
    dead:       int32 (n, 2), rows and columns of dead pixels.
    gain_DN_per_keV: of the mean pixel.
    open_field_value: of processed, where nothing but the plates is in the beam.
    report:     counts of what was cut, means, signal-to-noise ratios; see ``detect``.
    """

    raw: NDArray[np.uint16]
    processed: NDArray[np.uint16]
    dead: NDArray[np.int32]
    gain_DN_per_keV: float
    open_field_value: float
    geometry: AcquisitionGeometry
    report: Report = field(default_factory=dict)

    def __post_init__(self) -> None:
        for array in (self.raw, self.processed, self.dead):
            frozen(array)
