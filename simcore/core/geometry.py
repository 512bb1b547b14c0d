"""The geometry of an acquisition, as a value.

Detector frame: origin on the detector surface at the middle of its chest-wall edge; +x from chest wall to nipple,
+y along the tube travel, +z from detector to source; mm. See docs/conventions.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

AT_REST = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
"""The pose of a detector at rest: middle of its chest-wall edge, direction of its rows index, of its columns index."""


@dataclass(frozen=True)
class Detector:
    """A flat detector, ny x nx square pixels; at rest it lies in z = 0 with its chest-wall edge on x = 0.

    ny: pixels along y (tube travel); nx: pixels along x (chest wall to nipple); pixel: edge, mm.
    At rest pixel [j, i] has its centre at x = (i + 1/2) pixel, y = (j - (ny - 1)/2) pixel, z = 0.
    """

    ny: int
    nx: int
    pixel: float

    def x_centres(self) -> NDArray[np.float64]:
        """mm, shape (nx,)"""
        return (np.arange(self.nx, dtype=np.float64) + 0.5) * self.pixel

    def y_centres(self) -> NDArray[np.float64]:
        """mm, shape (ny,)"""
        return (np.arange(self.ny, dtype=np.float64) - (self.ny - 1) / 2) * self.pixel


@dataclass(frozen=True)
class AcquisitionGeometry:
    """Source and detector pose of every view.

    angles:          (views,) degrees: the tube angle about the isocenter in the y-z plane, positive towards +y.
    sources:         (views, 3) focal spot (x, y, z), mm, in the detector frame.
    detector:        pixels.
    detector_angles: (views,) degrees: turn of the detector about the x axis through the isocenter in the same
                     sense as the tube; 0 for a stationary detector.
    isocenter_height: height of the isocenter (pivot) above the detector surface, mm.
    source_to_detector: source-to-image distance of the central view, mm.
    support_height:  top of the breast support above the detector surface, mm: the compressed breast rests there.
    detector_poses:  (views, 3, 3) where the detector stands anywhere: of each view the middle of its chest-wall edge,
                     mm, and the unit vectors along which its rows and its columns are counted; None where it turns by
                     detector_angles. With poses, detector_angles are the turns of the row vectors.
    """

    angles: NDArray[np.float64]
    sources: NDArray[np.float64]
    detector: Detector
    detector_angles: NDArray[np.float64]
    isocenter_height: float
    source_to_detector: float
    support_height: float
    detector_poses: NDArray[np.float64] | None = None

    @property
    def views(self) -> int:
        return len(self.angles)

    @property
    def stationary(self) -> bool:
        """True where the detector lies at rest in every view."""
        return all(self.at_rest(view) for view in range(self.views))

    def at_rest(self, view: int) -> bool:
        """True where the detector lies in z = 0 with its chest-wall edge on x = 0, its middle on y = 0."""
        if self.detector_poses is None:
            return bool(self.detector_angles[view] == 0)
        return np.array_equal(self.detector_poses[view], AT_REST)

    def detector_frame(self, view: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(origin, y direction) of the detector of one view, each (3,): the middle of its chest-wall edge in mm and
        the unit vector of its rows index."""
        if self.detector_poses is not None:
            return self.detector_poses[view, 0], self.detector_poses[view, 1]
        a = np.deg2rad(self.detector_angles[view])
        h = self.isocenter_height
        # A turn that moves the tube towards +y moves what is below the isocenter towards -y.
        return np.array([0.0, -h * np.sin(a), h - h * np.cos(a)]), np.array([0.0, np.cos(a), -np.sin(a)])

    def column_direction(self, view: int) -> NDArray[np.float64]:
        """The unit vector of the columns index of the detector of one view, (3,): (1, 0, 0) without poses."""
        return np.array([1.0, 0.0, 0.0]) if self.detector_poses is None else self.detector_poses[view, 2]

    def normal(self, view: int) -> NDArray[np.float64]:
        """The unit vector from the detector towards the side that the source stands on, (3,)."""
        return np.cross(self.column_direction(view), self.detector_frame(view)[1])

    def pixel_position(self, view: int, j: float, i: float) -> NDArray[np.float64]:
        """Centre of pixel [j, i] of a view, (x, y, z), mm."""
        origin, e_y = self.detector_frame(view)
        d = self.detector
        position: NDArray[np.float64] = (
            origin + (i + 0.5) * d.pixel * self.column_direction(view) + (j - (d.ny - 1) / 2) * d.pixel * e_y
        )
        return position

    def obliquity(self, view: int) -> NDArray[np.float64]:
        """Length over height of the ray to every pixel of a view, (ny, nx)."""
        d = self.detector
        first = self.pixel_position(view, 0, 0) - self.sources[view]
        rows = np.arange(d.ny)[:, None] * d.pixel * self.detector_frame(view)[1][:, None, None]
        columns = np.arange(d.nx) * d.pixel * self.column_direction(view)[:, None, None]
        x, y, z = (first[axis] + rows[axis] + columns[axis] for axis in range(3))
        return np.asarray(np.sqrt(x * x + y * y + z * z) / np.abs(z))

    def to_dict(self) -> dict[str, Any]:
        """JSON for people who reconstruct without DICOM (geometry.json) and for the store."""
        return {
            "schema": "tomosim-geometry/1",
            "units": {"length": "mm", "angle": "degree"},
            "frame": "origin: detector surface, middle of chest-wall edge; +x chest wall to nipple, "
            "+y tube travel, +z detector to source",
            "source_to_detector": self.source_to_detector,
            "isocenter_height": self.isocenter_height,
            "support_height": self.support_height,
            "detector": {"ny": self.detector.ny, "nx": self.detector.nx, "pixel": self.detector.pixel},
            "views": [
                {
                    "index": k,
                    "angle": float(self.angles[k]),
                    "source": [float(c) for c in self.sources[k]],
                    "detector_angle": float(self.detector_angles[k]),
                    "first_pixel_centre": [float(c) for c in self.pixel_position(k, 0, 0)],
                    "row_step": [float(c) for c in self.detector_frame(k)[1] * self.detector.pixel],
                    "column_step": [float(c) for c in self.column_direction(k) * self.detector.pixel],
                    **self._pose(k),
                }
                for k in range(self.views)
            ],
        }

    def _pose(self, view: int) -> dict[str, Any]:
        if self.detector_poses is None:
            return {}
        names = ("detector_origin", "row_direction", "column_direction")
        return dict(zip(names, self.detector_poses[view].tolist(), strict=True))

    @classmethod
    def from_dict(cls, d: dict[str, Any]) -> AcquisitionGeometry:
        v = d["views"]
        return cls(
            angles=np.array([x["angle"] for x in v], dtype=np.float64),
            sources=np.array([x["source"] for x in v], dtype=np.float64),
            detector=Detector(**d["detector"]),
            detector_angles=np.array([x["detector_angle"] for x in v], dtype=np.float64),
            isocenter_height=d["isocenter_height"],
            source_to_detector=d["source_to_detector"],
            support_height=d["support_height"],
            detector_poses=np.array(
                [[x["detector_origin"], x["row_direction"], x["column_direction"]] for x in v], dtype=np.float64
            )
            if "detector_origin" in v[0]
            else None,
        )
