"""From the detector frame to the coordinate systems of DICOM.

Gantry (isocenter) system, PS3.3 C.8.31.6.1: origin on the isocenter, +X to the right of a patient who stands facing
the equipment, +Y from front to rear (chest wall to nipple), +Z up. With the gantry upright (CC view) it is our
frame turned: (X, Y, Z) = (-y, x, z - isocenter height). For an oblique view source, support and detector turn
together by the gantry angle about Y, positive from +Z towards +X. A tube angle that is positive towards our +y is
therefore negative in the gantry system.

Patient system (left, posterior, head), same origin: the patient stands facing the equipment, whatever the view, so
(L, P, H) = (-X, -Y, Z).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import Dataset

from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid
from simcore.dicom.common import item
from simcore.dicom.spec import ExportSpec
from simcore.dicom.values import decimal

Vector = NDArray[np.float64]

PATIENT_TO_GANTRY = (-1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0)
"""Image to Equipment Mapping Matrix, row by row."""

_TIE = 1e-6
"""Direction cosines closer than this count as equal: at 45 degrees head or feet is named first, as is the custom."""


def gantry_angle(spec: ExportSpec) -> float:
    """Turn of the gantry about Y, degrees, positive towards the right of the patient.

    An oblique view is taken from the upper inner to the lower outer side: the tube stands on the side of the other
    breast, which is to the right for a left breast.
    """
    if spec.view == "CC":
        return 0.0
    return spec.oblique_angle_degrees if spec.laterality == "L" else -spec.oblique_angle_degrees


def _turn(degrees: float) -> NDArray[np.float64]:
    """Rotation matrix about Y, from +Z towards +X."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


@dataclass(frozen=True)
class Frames:
    """The maps between detector frame, gantry and patient for one acquisition and view position."""

    geometry: AcquisitionGeometry
    gantry_degrees: float

    def gantry_direction(self, direction: Sequence[float] | Vector) -> Vector:
        """A vector (x, y, z) of the detector frame in the gantry system."""
        x, y, z = direction
        turned: Vector = _turn(self.gantry_degrees) @ np.array([-y, x, z])
        return turned

    def gantry_point(self, point: Sequence[float] | Vector) -> Vector:
        """A point (x, y, z) of the detector frame, mm, in the gantry system, mm."""
        x, y, z = point
        return self.gantry_direction((x, y, z - self.geometry.isocenter_height))

    def patient_direction(self, direction: Sequence[float] | Vector) -> Vector:
        """A vector of the detector frame as (left, posterior, head)."""
        return self.gantry_direction(direction) * (-1.0, -1.0, 1.0)

    def patient_point(self, point: Sequence[float] | Vector) -> Vector:
        """A point of the detector frame, mm, as (left, posterior, head), mm."""
        return self.gantry_point(point) * (-1.0, -1.0, 1.0)

    def patient_orientation(self) -> list[str]:
        """Letters for the direction of the rows (along x) and of the columns (along y) of every image."""
        return [_letters(self.patient_direction(d)) for d in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))]

    def image_orientation(self) -> list[str]:
        """Image Orientation (Patient): the direction cosines of rows and columns."""
        cosines = [*self.patient_direction((1.0, 0.0, 0.0)), *self.patient_direction((0.0, 1.0, 0.0))]
        return [decimal(c) for c in cosines]

    def image_position(self, grid: Grid, k: int) -> list[str]:
        """Image Position (Patient) of slice ``k``: the centre of its first voxel, mm."""
        first = [float(grid.centres("x")[0]), float(grid.centres("y")[0]), float(grid.centres("z")[k])]
        return [decimal(c) for c in self.patient_point(first)]

    # Images turned as mammograms are hung (simcore.dicom.display.hung): a left breast has the order of its rows
    # reversed, a right one that of its columns.

    def hung_orientation(self, laterality: str) -> list[str]:
        """``patient_orientation`` of a turned image."""
        return [_letters(self.patient_direction(d)) for d in _hung_directions(laterality)]

    def hung_image_orientation(self, laterality: str) -> list[str]:
        """``image_orientation`` of a turned image."""
        rows, columns = _hung_directions(laterality)
        return [decimal(c) for c in (*self.patient_direction(rows), *self.patient_direction(columns))]

    def hung_image_position(self, grid: Grid, laterality: str) -> list[str]:
        """Image Position (Patient) of a turned image half way up ``grid``."""
        x, y = grid.centres("x"), grid.centres("y")
        z = (grid.corner[2] + grid.upper[2]) / 2
        first = (float(x[0]), float(y[-1]), z) if laterality == "L" else (float(x[-1]), float(y[0]), z)
        return [decimal(c) for c in self.patient_point(first)]


def _hung_directions(laterality: str) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Direction of the rows and of the columns of a turned image in the detector frame."""
    return ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0)) if laterality == "L" else ((-1.0, 0.0, 0.0), (0.0, 1.0, 0.0))


def _letters(direction: Vector) -> str:
    """The anatomical letters of a direction (left, posterior, head), the dominant one first."""
    names = (("L", "R"), ("P", "A"), ("H", "F"))
    axes = [axis for axis in (2, 1, 0) if abs(direction[axis]) > _TIE]
    axes.sort(key=lambda axis: -round(abs(float(direction[axis])) / _TIE))
    return "".join(names[axis][int(direction[axis] < 0)] for axis in axes)


@dataclass(frozen=True)
class Beam:
    """The X-ray beam vector of a view: from the source to the middle of the chest-wall edge of the detector.

    length:             mm (Distance Source to Detector).
    support, entrance:  mm from the source along the beam to the breast support and to the paddle.
    primary, secondary: Positioner angles, degrees: tube towards the left of the patient (counter-clockwise, as our
                        tube angle), and towards the patient's back positive.
    row, column:        Detector angles, degrees: beam tilted towards higher columns, towards lower rows positive.
    """

    length: float
    support: float
    entrance: float
    primary: float
    secondary: float
    row: float
    column: float

    @property
    def magnification(self) -> float:
        """Source-to-detector over source-to-support distance."""
        return self.length / self.support


def beam(frames: Frames, view: int, thickness: float) -> Beam:
    """The beam of a view; thickness: distance of the plates, mm."""
    g = frames.geometry
    source = g.sources[view]
    origin, e_y = g.detector_frame(view)
    vector = source - origin
    length = float(np.linalg.norm(vector))
    per_height = length / float(source[2] - origin[2])
    room = frames.gantry_direction(vector)
    return Beam(
        length=length,
        support=per_height * float(source[2] - g.support_height),
        entrance=per_height * float(source[2] - g.support_height - thickness),
        primary=-float(np.rad2deg(np.arctan2(room[0], room[2]))),
        secondary=-float(np.rad2deg(np.arcsin(room[1] / length))),
        row=-float(np.rad2deg(np.arcsin(vector @ g.column_direction(view) / length))),
        column=float(np.rad2deg(np.arctan2(vector @ e_y, vector @ g.normal(view)))),
    )


def source_distance(frames: Frames, view: int) -> float:
    """Distance of the source from the isocenter, mm."""
    return float(np.linalg.norm(frames.gantry_point(frames.geometry.sources[view])))


def isocenter_item(frames: Frames, view: int) -> Dataset:
    """The item of the Isocenter Reference System Sequence of a view: source angles, support and detector pose.

    The detector reference point is the middle of the chest-wall edge of the detector.
    """
    g = frames.geometry
    source = frames.gantry_point(g.sources[view])
    support = frames.gantry_point((0.0, 0.0, g.support_height))
    reference = frames.gantry_point(g.detector_frame(view)[0])
    values: dict[str, Any] = {
        "XRaySourceIsocenterPrimaryAngle": np.rad2deg(np.arctan2(source[0], source[2])),
        "XRaySourceIsocenterSecondaryAngle": np.rad2deg(np.arctan2(source[1], np.hypot(source[0], source[2]))),
        "BreastSupportIsocenterPrimaryAngle": frames.gantry_degrees,
        "BreastSupportIsocenterSecondaryAngle": 0.0,
    }
    primary, secondary, columns, rows = _detector_system(frames, view)
    values["DetectorIsocenterPrimaryAngle"] = primary
    values["DetectorIsocenterSecondaryAngle"] = secondary
    for axis, s, d in zip("XYZ", support, reference, strict=True):
        values[f"BreastSupport{axis}PositionToIsocenter"] = s
        values[f"Detector{axis}PositionToIsocenter"] = d
    values = {name: float(value) + 0.0 for name, value in values.items()}
    # In the detector system +X is our -y and +Y our +x: the first pixel lies at the right end of the chest wall.
    first = g.detector.pixel / 2 * columns - (g.detector.ny - 1) / 2 * g.detector.pixel * rows
    return item(
        **values,
        DetectorActiveAreaTLHCPosition=[float(c) + 0.0 for c in first],
        DetectorActiveAreaOrientation=[float(c) + 0.0 for c in (*columns, *rows)],
    )


def _detector_system(frames: Frames, view: int) -> tuple[float, float, Vector, Vector]:
    """Angles of the detector about the isocenter, degrees, and in the system that they turn to, the unit vectors along
    which its columns and its rows are counted."""
    g = frames.geometry
    if g.detector_poses is None:
        turned = frames.gantry_degrees - float(g.detector_angles[view])
        return turned, 0.0, np.array([0.0, 1.0, 0.0]), np.array([-1.0, 0.0, 0.0])
    normal = frames.gantry_direction(g.normal(view))
    primary = float(np.rad2deg(np.arctan2(normal[0], normal[2])))
    secondary = float(np.rad2deg(np.arcsin(np.clip(normal[1], -1.0, 1.0))))
    c, s = np.cos(np.deg2rad(secondary)), np.sin(np.deg2rad(secondary))
    # Back to the detector system: first the turn about Y, then the tilt about X from +Z towards +Y.
    back = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]) @ _turn(-primary)
    columns, rows = (back @ frames.gantry_direction(d) for d in (g.column_direction(view), g.detector_frame(view)[1]))
    return primary, secondary, columns, rows


def detector_motion(geometry: AcquisitionGeometry) -> str:
    """Type of Detector Motion: the reference point of a turning detector moves unless the pivot lies in it."""
    if geometry.detector_poses is not None:
        return "STATIONARY" if np.all(geometry.detector_poses == geometry.detector_poses[0]) else "COMPLEX_STEP"
    if geometry.stationary:
        return "STATIONARY"
    return "ROTATION_STEP" if geometry.isocenter_height == 0 else "COMPLEX_STEP"
