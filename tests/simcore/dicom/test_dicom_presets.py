"""Every preset, left and right, CC and MLO: source, pixels and voxels are where the attributes alone say they are.

All combinations run with ``-m sweep`` (make validate); the tests run a part of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pydicom
import pytest
from _pytest.mark.structures import ParameterSet
from pydicom.dataset import Dataset

from simcore import presets
from simcore.core.artifacts import Compression, Phantom, ProjectionStack, Volume
from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid
from simcore.dicom import check
from simcore.projection import AcquisitionSpec, geometry_of
from tests.support.dicom_case import ALL_EXTRAS, SmallCase, make_case

from .test_dicom_geometry import Vector, read_isocenter, truth_in_gantry, voxel_in_patient

TOLERANCE = 1e-3
"""mm"""
POSITIONS = [("L", "CC", 0.0), ("R", "CC", 0.0), ("L", "MLO", -45.0), ("R", "MLO", 45.0)]


def _acquisitions() -> dict[AcquisitionSpec, str]:
    """Each acquisition once: many presets share theirs."""
    names: dict[AcquisitionSpec, str] = {}
    for name in presets.names():
        names.setdefault(presets.get(name).acquisition, name)
    return names


ACQUISITIONS = _acquisitions()


def small(
    acquisition: AcquisitionSpec, laterality: str, view: str, extras: tuple[str, ...] | list[str] = ()
) -> SmallCase:
    """The acquisition with its pixel size and poses, but few pixels (odd and even as before)."""
    detector = acquisition.detector
    few = detector.with_(pixels_x=8 + detector.pixels_x % 2, pixels_y=10 + detector.pixels_y % 2)
    geometry = geometry_of(acquisition.with_(detector=few))
    ny, nx = geometry.detector.ny, geometry.detector.nx
    grid = Grid((3, ny, nx), (few.pixel_mm, few.pixel_mm, 1.0), (0.0, -ny * few.pixel_mm / 2, geometry.support_height))
    case = make_case(laterality=laterality, view=view, extras=extras)
    return SmallCase(
        spec=case.spec,
        case=case.case,
        stack=ProjectionStack(np.full((geometry.views, ny, nx), 50000, np.uint16), 60000.0, geometry),
        volume=Volume(np.full(grid.shape, 21000, np.uint16), grid, 1e-5, -0.2),
        phantom=Phantom(np.full((2, 2, 2), 5, np.uint8), Grid((2, 2, 2), (2.0, 2.0, 2.0), (0.0, -2.0, 0.0))),
        compression=Compression(np.zeros((1, 3)), (0.0, 60.0), 100.0, "converged"),
    )


def _cases() -> list[ParameterSet]:
    """Every acquisition in every position. The quick ones: each system in one position, the turning detector in all."""
    cases = []
    for number, (acquisition, name) in enumerate(ACQUISITIONS.items()):
        for turn, (laterality, view, tilt) in enumerate(POSITIONS):
            # The paper's acquisitions differ in range and number of views alone.
            quick = not name.startswith("paper-cup-c-20") and turn == number % len(POSITIONS)
            marks = [] if quick or acquisition.detector_range_degrees else [pytest.mark.sweep]
            case = (acquisition, laterality, view, tilt)
            cases.append(pytest.param(*case, id=f"{name}-{laterality}{view}", marks=marks))
    return cases


CASES = _cases()


def corners(geometry: AcquisitionGeometry) -> Iterator[tuple[int, int]]:
    for j in (0, geometry.detector.ny - 1):
        for i in (0, geometry.detector.nx - 1):
            yield j, i


@pytest.mark.parametrize(("acquisition", "laterality", "view", "tilt"), CASES)
def test_source_pixels_and_voxels(
    tmp_path: Path, acquisition: AcquisitionSpec, laterality: str, view: str, tilt: float
) -> None:
    case = small(acquisition, laterality, view)
    case.export(tmp_path)
    g = case.stack.geometry
    multi = pydicom.dcmread(tmp_path / "projections.dcm", stop_before_pixels=True)
    shared = multi.SharedFunctionalGroupsSequence[0].FramePixelDataPropertiesSequence[0]
    spacing = [float(s) for s in shared.ImagerPixelSpacing]
    for k, frame in enumerate(multi.PerFrameFunctionalGroupsSequence):
        single = pydicom.dcmread(tmp_path / f"projections/{k + 1:04d}.dcm", stop_before_pixels=True)
        beam = single.DistanceSourceToDetector * towards_source(single)
        for j, i in corners(g):
            expected_source = truth_in_gantry(g.sources[k], g, tilt)
            expected_pixel = truth_in_gantry(g.pixel_position(k, j, i), g, tilt)
            for iso, distance in (
                (frame.IsocenterReferenceSystemSequence[0], frame.XRayGeometrySequence[0].DistanceSourceToIsocenter),
                (single.IsocenterReferenceSystemSequence[0], single.DistanceSourceToIsocenter),
            ):
                source, pixel = read_isocenter(iso, distance, spacing, j, i)
                np.testing.assert_allclose(source, expected_source, atol=TOLERANCE)
                np.testing.assert_allclose(pixel, expected_pixel, atol=TOLERANCE)
            # By the mammography attributes alone: from the pixel to the source, in the axes of the detector.
            dy, dx = (float(s) for s in single.ImagerPixelSpacing)
            from_edge = np.array([(i + 0.5) * dx, (j - (single.Rows - 1) / 2) * dy, 0.0])
            np.testing.assert_allclose(beam - from_edge, pixel_to_source(g, k, j, i), atol=TOLERANCE)
    volume = pydicom.dcmread(tmp_path / "tomosynthesis.dcm")
    mapping = np.array(volume.ImageToEquipmentMappingMatrix, dtype=float).reshape(4, 4)
    grid = case.volume.grid
    for k, j, i in [(k, *corner) for k in (0, grid.shape[0] - 1) for corner in corners(g)]:
        gantry = (mapping @ [*voxel_in_patient(volume, k, j, i), 1.0])[:3]
        point = np.array([grid.centres(axis)[n] for axis, n in zip("xyz", (i, j, k), strict=True)])
        np.testing.assert_allclose(gantry, truth_in_gantry(point, g, tilt), atol=TOLERANCE)


@pytest.mark.sweep
@pytest.mark.parametrize(("acquisition", "laterality", "view", "tilt"), CASES)
def test_every_object_of_every_preset_conforms(
    tmp_path: Path, acquisition: AcquisitionSpec, laterality: str, view: str, tilt: float
) -> None:
    small(acquisition, laterality, view, extras=ALL_EXTRAS).export(tmp_path)
    verdicts = check.verdicts(sorted(tmp_path.rglob("*.dcm")))
    assert [str(v) for v in verdicts if not v.ok or v.warnings] == []
    assert {v.object_name for v in verdicts} >= {"ParametricMap", "CTImage", "Comprehensive3DSR", "Segmentation"}


def towards_source(single: Dataset) -> Vector:
    """Unit vector against the beam, in the axes (columns' direction is y) of the detector."""
    row, column = np.deg2rad([float(single.DetectorPrimaryAngle), float(single.DetectorSecondaryAngle)])
    return np.array([-np.sin(row), np.cos(row) * np.sin(column), np.cos(row) * np.cos(column)])


def pixel_to_source(g: AcquisitionGeometry, k: int, j: int, i: int) -> Vector:
    vector = g.sources[k] - g.pixel_position(k, j, i)
    _, e_y = g.detector_frame(k)
    return np.array([vector[0], vector @ e_y, vector @ np.cross([1.0, 0.0, 0.0], e_y)])
