"""Listed focal spots and detectors in any pose: rebuilt from standard attributes alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pydicom
import pytest

from simcore.core.geometry import AT_REST
from simcore.dicom import check
from tests.support.dicom_case import SmallCase, make_case

from .test_dicom_geometry import CORNERS, HEAD_OF_TUBE, TOLERANCE, read_isocenter, truth_in_gantry


def posed_case(laterality: str, view: str) -> SmallCase:
    """Spots out of order and beside the plane of the chest wall, each with its own pose of the detector."""
    rng = np.random.default_rng(7)
    poses = []
    for _ in range(4):
        # A random turn of some degrees, and about its own normal by more.
        q, _ = np.linalg.qr(np.eye(3) + 0.08 * rng.standard_normal((3, 3)))
        q *= np.sign(np.diag(q))
        a = rng.uniform(-0.6, 0.6)
        columns, rows = np.cos(a) * q[:, 0] + np.sin(a) * q[:, 1], np.cos(a) * q[:, 1] - np.sin(a) * q[:, 0]
        poses.append(np.stack([rng.uniform(-20, 0, 3), rows, columns]))
    case = make_case(laterality=laterality, view=view)
    sources = np.array([[0.0, 90, 610], [12.5, -200, 570], [-8, 0, 640], [0, 100, 600], [3, 30, 655]])
    angles = np.rad2deg(np.arctan2(sources[:, 1], sources[:, 2] - 40.0))
    geometry = replace(case.stack.geometry, sources=sources, angles=angles, detector_poses=np.stack([*poses, AT_REST]))
    return replace(case, stack=replace(case.stack, geometry=geometry))


@pytest.mark.parametrize(("laterality", "view"), [("L", "CC"), ("R", "MLO")])
def test_any_pose_is_rebuilt(exported: Callable[[SmallCase], Path], laterality: str, view: str) -> None:
    case = posed_case(laterality, view)
    tilt_to_left = HEAD_OF_TUBE[laterality + view]
    g = case.stack.geometry
    folder = exported(case)
    d = pydicom.dcmread(folder / "projections.dcm")
    assert d.TypeOfDetectorMotion == "COMPLEX_STEP"
    spacing = [
        float(s) for s in d.SharedFunctionalGroupsSequence[0].FramePixelDataPropertiesSequence[0].ImagerPixelSpacing
    ]
    indices = []
    for k, frame in enumerate(d.PerFrameFunctionalGroupsSequence):
        indices.append(frame.FrameContentSequence[0].DimensionIndexValues)
        iso = frame.IsocenterReferenceSystemSequence[0]
        distance = frame.XRayGeometrySequence[0].DistanceSourceToIsocenter
        for j, i in CORNERS:
            source, pixel = read_isocenter(iso, distance, spacing, j, i)
            np.testing.assert_allclose(source, truth_in_gantry(g.sources[k], g, tilt_to_left), atol=1e-4)
            expected = truth_in_gantry(g.pixel_position(k, j, i), g, tilt_to_left)
            np.testing.assert_allclose(pixel, expected, atol=TOLERANCE)
    assert sorted(indices) == [1, 2, 3, 4, 5]
    assert np.argsort(indices).tolist() == np.argsort(g.angles).tolist()
    for k in range(g.views):
        one = pydicom.dcmread(folder / f"projections/{k + 1:04d}.dcm")
        row, column = np.deg2rad([float(one.DetectorPrimaryAngle), float(one.DetectorSecondaryAngle)])
        towards = np.array([-np.sin(row), np.cos(row) * np.sin(column), np.cos(row) * np.cos(column)])
        origin, e_y = g.detector_frame(k)
        vector = g.sources[k] - origin
        e_x = g.column_direction(k)
        expected = [vector @ e_x, vector @ e_y, vector @ np.cross(e_x, e_y)]
        np.testing.assert_allclose(float(one.DistanceSourceToDetector) * towards, expected, atol=TOLERANCE)
    assert [str(v) for v in check.verdicts(sorted(folder.rglob("*.dcm"))) if not v.ok] == []


def test_plates_are_told(exported: Callable[[SmallCase], Path]) -> None:
    case = make_case()
    folder = exported(replace(case, stack=replace(case.stack, slab_integral=0.25)))
    text = pydicom.dcmread(folder / "projections.dcm").private_block(0x0099, "TOMOSIM 1")[0x01].value
    assert '"slab_integral": 0.25' in text
