"""The geometry is rebuilt from standard attributes alone, as a third party would, and compared with the truth.

The readers here are written from PS3.3 (C.8.31.6.1, C.8.11.7.1, C.7.6.2.1.1) and use nothing of simcore.dicom.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pydicom
import pytest
from numpy.typing import NDArray
from pydicom.dataset import Dataset

from simcore.core.geometry import AcquisitionGeometry
from tests.support.dicom_case import SmallCase, make_case

Vector = NDArray[np.float64]
TOLERANCE = 1e-6
"""mm"""

POSITIONS = [("L", "CC", 0.0), ("R", "CC", 0.3), ("L", "MLO", 0.3), ("R", "MLO", 0.0)]
HEAD_OF_TUBE = {"LCC": 0.0, "RCC": 0.0, "LMLO": -45.0, "RMLO": 45.0}
"""Tilt of the gantry towards the left of the patient: the tube stands over the other breast."""


def turn(degrees: float) -> NDArray[np.float64]:
    """About Y, from +Z towards +X."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def tilt(degrees: float) -> NDArray[np.float64]:
    """About X, from +Z towards +Y."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[1, 0, 0], [0, c, s], [0, -s, c]])


def read_isocenter(iso: Dataset, distance: float, spacing: list[float], j: int, i: int) -> tuple[Vector, Vector]:
    """Source and centre of pixel [j, i] in the gantry system, mm."""
    source = turn(iso.XRaySourceIsocenterPrimaryAngle) @ tilt(iso.XRaySourceIsocenterSecondaryAngle) @ [0, 0, distance]
    orientation = np.array(iso.DetectorActiveAreaOrientation)
    local = (
        np.array(iso.DetectorActiveAreaTLHCPosition)
        + orientation[:3] * i * spacing[1]
        + orientation[3:] * j * spacing[0]
    )
    reference = [getattr(iso, f"Detector{axis}PositionToIsocenter") for axis in "XYZ"]
    turned = turn(iso.DetectorIsocenterPrimaryAngle) @ tilt(iso.DetectorIsocenterSecondaryAngle) @ local
    return source, reference + turned


def truth_in_gantry(point: Vector, geometry: AcquisitionGeometry, tilt_to_left: float) -> Vector:
    """The detector frame upright: +y to the left, +x away from, +z up; X to the right. Then the gantry's tilt."""
    x, y, z = point
    left, up = y, z - geometry.isocenter_height
    c, s = np.cos(np.deg2rad(tilt_to_left)), np.sin(np.deg2rad(tilt_to_left))
    return np.array([-(c * left + s * up), x, -s * left + c * up])


@pytest.fixture(scope="module", params=POSITIONS, ids=lambda p: f"{p[0]}{p[1]}-turning-{p[2]}")
def case_and_folder(
    request: pytest.FixtureRequest, exported: Callable[[SmallCase], Path]
) -> tuple[SmallCase, Path, float]:
    laterality, view, turning = request.param
    case = make_case(laterality=laterality, view=view, turning=turning)
    return case, exported(case), HEAD_OF_TUBE[laterality + view]


CORNERS = [(0, 0), (0, 47), (63, 0), (63, 47)]


def test_multi_frame(case_and_folder: tuple[SmallCase, Path, float]) -> None:
    case, folder, tilt_to_left = case_and_folder
    g = case.stack.geometry
    d = pydicom.dcmread(folder / "projections.dcm")
    properties = d.SharedFunctionalGroupsSequence[0].FramePixelDataPropertiesSequence[0]
    spacing = [float(s) for s in properties.ImagerPixelSpacing]
    for k, frame in enumerate(d.PerFrameFunctionalGroupsSequence):
        iso = frame.IsocenterReferenceSystemSequence[0]
        distance = frame.XRayGeometrySequence[0].DistanceSourceToIsocenter
        for j, i in CORNERS:
            source, pixel = read_isocenter(iso, distance, spacing, j, i)
            # Distance Source to Isocenter is a 32-bit number.
            expected = truth_in_gantry(g.sources[k], g, tilt_to_left)
            np.testing.assert_allclose(source, expected, atol=1e-4)
            expected = truth_in_gantry(g.pixel_position(k, j, i), g, tilt_to_left)
            np.testing.assert_allclose(pixel, expected, atol=TOLERANCE)


def test_one_file_a_view(case_and_folder: tuple[SmallCase, Path, float]) -> None:
    """By the mammography attributes: the source in the frame of the detector, and the detector's tilt."""
    case, folder, tilt_to_left = case_and_folder
    g = case.stack.geometry
    for k in range(g.views):
        d = pydicom.dcmread(folder / f"projections/{k + 1:04d}.dcm")
        assert d.InstanceNumber == k + 1
        # Detector angles: the beam leans towards higher columns, towards lower rows positive.
        row, column = np.deg2rad([float(d.DetectorPrimaryAngle), float(d.DetectorSecondaryAngle)])
        towards_source = np.array([-np.sin(row), np.cos(row) * np.sin(column), np.cos(row) * np.cos(column)])
        source = float(d.DistanceSourceToDetector) * towards_source
        origin, e_y = g.detector_frame(k)
        vector = g.sources[k] - origin
        expected = [vector[0], vector @ e_y, vector @ np.cross([1, 0, 0], e_y)]
        np.testing.assert_allclose(source, expected, atol=TOLERANCE)
        assert [float(s) for s in d.ImagerPixelSpacing] == [g.detector.pixel] * 2
        assert d.PositionerPrimaryAngleDirection == "CC"
        tilt_of_detector = float(d.PositionerPrimaryAngle) - float(d.DetectorSecondaryAngle)
        assert tilt_of_detector == pytest.approx(g.detector_angles[k] + tilt_to_left, abs=1e-9)
        # The complete form, as in the multi-frame object.
        iso = d.IsocenterReferenceSystemSequence[0]
        for j, i in CORNERS:
            source, pixel = read_isocenter(
                iso, d.DistanceSourceToIsocenter, [float(s) for s in d.ImagerPixelSpacing], j, i
            )
            np.testing.assert_allclose(source, truth_in_gantry(g.sources[k], g, tilt_to_left), atol=1e-4)
            expected_pixel = truth_in_gantry(g.pixel_position(k, j, i), g, tilt_to_left)
            np.testing.assert_allclose(pixel, expected_pixel, atol=TOLERANCE)


def test_distances_along_the_beam(case_and_folder: tuple[SmallCase, Path, float]) -> None:
    """Support and paddle lie where the beam crosses their planes."""
    case, folder, _ = case_and_folder
    g = case.stack.geometry
    for k in range(g.views):
        d = pydicom.dcmread(folder / f"projections/{k + 1:04d}.dcm")
        origin, _ = g.detector_frame(k)
        beam = (origin - g.sources[k]) / float(d.DistanceSourceToDetector)
        support = g.sources[k] + float(d.DistanceSourceToPatient) * beam
        paddle = g.sources[k] + float(d.DistanceSourceToEntrance) * beam
        assert support[2] == pytest.approx(22.0, abs=TOLERANCE)
        assert paddle[2] == pytest.approx(62.0, abs=TOLERANCE)
        ratio = float(d.DistanceSourceToDetector) / float(d.DistanceSourceToPatient)
        assert float(d.EstimatedRadiographicMagnificationFactor) == pytest.approx(ratio)


def voxel_in_patient(d: Dataset, k: int, j: int, i: int) -> Vector:
    shared = d.SharedFunctionalGroupsSequence[0]
    cosines = np.array(shared.PlaneOrientationSequence[0].ImageOrientationPatient, dtype=float)
    spacing = [float(s) for s in shared.PixelMeasuresSequence[0].PixelSpacing]
    position = d.PerFrameFunctionalGroupsSequence[k].PlanePositionSequence[0].ImagePositionPatient
    return np.array(position, dtype=float) + cosines[:3] * spacing[1] * i + cosines[3:] * spacing[0] * j


@pytest.mark.parametrize("name", ["tomosynthesis.dcm", "labels.dcm"])
def test_voxels_in_the_patient_and_in_the_gantry(case_and_folder: tuple[SmallCase, Path, float], name: str) -> None:
    case, folder, tilt_to_left = case_and_folder
    grid = case.volume.grid
    d = pydicom.dcmread(folder / name)
    volume = pydicom.dcmread(folder / "tomosynthesis.dcm")
    assert d.FrameOfReferenceUID == volume.FrameOfReferenceUID
    mapping = np.array(volume.ImageToEquipmentMappingMatrix, dtype=float).reshape(4, 4)
    for k, j, i in [(0, 0, 0), (8, 0, 44), (3, 60, 0), (8, 60, 44)]:
        patient = voxel_in_patient(d, k, j, i)
        gantry = (mapping @ [*patient, 1.0])[:3]
        point = np.array([grid.centres(axis)[n] for axis, n in zip("xyz", (i, j, k), strict=True)])
        np.testing.assert_allclose(gantry, truth_in_gantry(point, case.stack.geometry, tilt_to_left), atol=TOLERANCE)
    shared = d.SharedFunctionalGroupsSequence[0].PixelMeasuresSequence[0]
    assert float(shared.SpacingBetweenSlices) == grid.spacing[2]


@pytest.mark.parametrize(
    ("laterality", "view", "letters"),
    [("L", "CC", ["A", "L"]), ("R", "CC", ["A", "L"]), ("L", "MLO", ["A", "HL"]), ("R", "MLO", ["A", "FL"])],
)
def test_patient_orientation(
    exported: Callable[[SmallCase], Path], laterality: str, view: str, letters: list[str]
) -> None:
    """Columns run to the left of the patient; in an oblique view the outer side of the breast lies lower."""
    folder = exported(make_case(laterality=laterality, view=view, views=1))
    for name in ("projections/0001.dcm", "projections.dcm", "labels.dcm"):
        assert list(pydicom.dcmread(folder / name).PatientOrientation) == letters
    orientation = pydicom.dcmread(folder / "tomosynthesis.dcm").SharedFunctionalGroupsSequence[0]
    cosines = np.array(orientation.PlaneOrientationSequence[0].ImageOrientationPatient, dtype=float)
    h = np.sqrt(0.5)
    along_columns = {"LCC": [1, 0, 0], "RCC": [1, 0, 0], "LMLO": [h, 0, h], "RMLO": [h, 0, -h]}
    np.testing.assert_allclose(cosines, [0, -1, 0, *along_columns[laterality + view]], atol=1e-12)


def test_oblique_tube_stands_over_the_other_breast(exported: Callable[[SmallCase], Path]) -> None:
    """Upper slices of an oblique volume lie higher and more to the middle: right for a left breast."""
    for laterality, sign in (("L", -1), ("R", 1)):
        folder = exported(make_case(laterality=laterality, view="MLO", views=1))
        d = pydicom.dcmread(folder / "tomosynthesis.dcm")
        left, posterior, head = voxel_in_patient(d, 8, 0, 0) - voxel_in_patient(d, 0, 0, 0)
        assert np.sign(left) == sign
        assert posterior == 0
        assert head > 0
