"""Lesions, and the objects on request: what they hold, read with highdicom and pydicom."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import highdicom
import numpy as np
import pydicom
import pytest
from numpy.typing import NDArray
from pydicom.pixels import pixel_array

from simcore.core.artifacts import Phantom, Volume
from simcore.core.errors import ExportError
from simcore.core.grid import Grid
from simcore.dicom.display import AIR, display_view, hung, synthetic_view
from simcore.dicom.extras import EXTRAS
from simcore.dicom.lesions import find_lesions
from simcore.dicom.objects.ct import water_per_mm
from simcore.dicom.spec import ExportSpec
from simcore.projection import PhysicsSpec, attenuation_per_mm
from tests.support.dicom_case import ALL_EXTRAS, SmallCase, make_case

WINDOWS = {"LCC": "lcc", "RMLO": "rmlo"}


@pytest.fixture(scope="module", params=[("L", "CC"), ("R", "MLO")], ids=lambda p: "".join(p))
def case_and_folder(request: pytest.FixtureRequest, exported: Callable[[SmallCase], Path]) -> tuple[SmallCase, Path]:
    laterality, view = request.param
    case = make_case(laterality=laterality, view=view, lesions=True, extras=ALL_EXTRAS)
    return case, exported(case)


def owner_by_definition(case: SmallCase) -> dict[str, set[tuple[int, int, int]]]:
    """The voxels of the volume of each lesion, one phantom voxel and one volume voxel at a time."""
    grid, volume = case.phantom.grid.moved(z=22.0), case.volume.grid
    leaves = [e for e in case.phantom.truth if "parts" not in e]
    owners: dict[str, set[tuple[int, int, int]]] = {}

    def owner(point: NDArray[np.float64], tissue: str) -> str:
        near = [e for e in leaves if e["tissue"] == tissue]
        best = min(near, key=lambda e: float(np.linalg.norm(point - np.add(e["centre_mm"], (0, 0, 22.0)))))
        return str(best.get("part_of", best["id"]))

    names = {5: "mass", 6: "calcification"}
    of_voxel = {}
    for k, j, i in np.argwhere(case.phantom.labels >= 5):
        point = np.array([grid.centres(axis)[n] for axis, n in zip("xyz", (i, j, k), strict=True)])
        name = owner(point, names[int(case.phantom.labels[k, j, i])])
        of_voxel[int(k), int(j), int(i)] = name
        index = np.floor((point - volume.corner) / volume.spacing).astype(int)[::-1]
        if np.all(index >= 0) and np.all(index < volume.shape):
            owners.setdefault(name, set()).add(tuple(int(n) for n in index))
    for index in np.ndindex(*volume.shape):
        point = np.array([volume.centres(axis)[n] for axis, n in zip("xyz", index[::-1], strict=True)])
        source = tuple(int(n) for n in np.floor((point - grid.corner) / grid.spacing).astype(int)[::-1])
        if source in of_voxel:
            owners[of_voxel[source]].add(index)
    return owners


def test_every_extra_has_its_writer() -> None:
    allowed = ExportSpec.model_json_schema()["properties"]["extra_objects"]["items"]["enum"]
    assert set(EXTRAS) == set(allowed) == set(ALL_EXTRAS)


def test_lesion_segments(case_and_folder: tuple[SmallCase, Path]) -> None:
    case, folder = case_and_folder
    expected = owner_by_definition(case)
    d = pydicom.dcmread(folder / "lesions.dcm")
    labels = [s.SegmentLabel for s in d.SegmentSequence]
    assert labels == ["mass-1", "mass-2", "calcifications-1"]
    segments: dict[str, set[tuple[int, int, int]]] = {label: set() for label in labels}
    heights = {
        tuple(f.PlanePositionSequence[0].ImagePositionPatient): k
        for k, f in enumerate(pydicom.dcmread(folder / "tomosynthesis.dcm").PerFrameFunctionalGroupsSequence)
    }
    for frame, groups in zip(pixel_array(d), d.PerFrameFunctionalGroupsSequence, strict=True):
        label = labels[groups.SegmentIdentificationSequence[0].ReferencedSegmentNumber - 1]
        k = heights[tuple(groups.PlanePositionSequence[0].ImagePositionPatient)]
        source = groups.DerivationImageSequence[0].SourceImageSequence[0]
        assert source.ReferencedFrameNumber == k + 1
        segments[label] |= {(k, int(j), int(i)) for j, i in np.argwhere(frame)}
    assert segments == expected
    # A calcification of one voxel, 2 mm high, lies between the centres of slices 5 mm apart.
    assert len({k for k, _, _ in segments["calcifications-1"]}) == 2


def test_highdicom_reads_the_segmentation(case_and_folder: tuple[SmallCase, Path]) -> None:
    case, folder = case_and_folder
    segmentation = highdicom.seg.segread(folder / "lesions.dcm")
    assert segmentation.number_of_segments == 3
    expected = owner_by_definition(case)
    for number, name in enumerate(("mass-1", "mass-2", "calcifications-1"), start=1):
        volume = segmentation.get_volume(segment_numbers=[number], combine_segments=True)
        assert int(np.count_nonzero(volume.array)) == len(expected[name])


def test_truth_table(case_and_folder: tuple[SmallCase, Path]) -> None:
    case, folder = case_and_folder
    rows = list(csv.DictReader((folder / "truth.csv").open()))
    d = pydicom.dcmread(folder / "tomosynthesis.dcm", stop_before_pixels=True)
    expected = owner_by_definition(case)
    assert len(rows) == 3
    for row, name in zip(rows, ("mass-1", "mass-2", "calcifications-1"), strict=True):
        k, j, i = np.array(sorted(expected[name])).T
        assert (row["PatientID"], row["StudyUID"]) == (d.PatientID, d.StudyInstanceUID)
        assert row["View"] == WINDOWS[case.spec.laterality + case.spec.view]
        assert int(row["Slice"]) == (k.min() + k.max()) // 2
        assert (int(row["StoredX"]), int(row["StoredY"])) == (i.min(), j.min())
        assert (int(row["Width"]), int(row["Height"])) == (np.ptp(i) + 1, np.ptp(j) + 1)
        assert int(row["VolumeSlices"]) == d.NumberOfFrames == 9


def test_lesions_without_truth_are_one_a_tissue(tmp_path: Path) -> None:
    case = make_case(lesions=True)
    unnamed = replace(case, phantom=replace(case.phantom, truth=()))
    unnamed.export(tmp_path)
    d = pydicom.dcmread(tmp_path / "lesions.dcm")
    assert [s.SegmentLabel for s in d.SegmentSequence] == ["mass", "calcification"]


def test_a_breast_without_lesions(tmp_path: Path) -> None:
    case = make_case(lesions=True, extras=["report"])
    labels = np.minimum(case.phantom.labels, 1)
    names = replace(case, phantom=replace(case.phantom, labels=labels, truth=())).export(tmp_path)
    assert not {"lesions.dcm", "report.dcm"} & set(names)
    assert (tmp_path / "truth.csv").read_text().count("\n") == 1


def test_report(case_and_folder: tuple[SmallCase, Path]) -> None:
    _, folder = case_and_folder
    report = highdicom.sr.srread(folder / "report.dcm")
    segments = pydicom.dcmread(folder / "lesions.dcm").SegmentSequence
    groups = report.content.get_volumetric_roi_measurement_groups()
    numbers = []
    for group, segment in zip(groups, segments, strict=True):
        assert group.tracking_uid == segment.TrackingUID
        assert group.tracking_identifier == segment.TrackingID
        finding = segment.SegmentedPropertyTypeCodeSequence[0]
        assert group.finding_type.value == finding.CodeValue
        assert (
            group.finding_sites[0].laterality.meaning
            == {"l": "Left", "r": "Right"}[
                pydicom.dcmread(folder / "projections/0001.dcm", stop_before_pixels=True).ImageLaterality.lower()
            ]
        )
        measured = group.get_measurements()[0]
        assert measured.unit.value == "mm3"
        value = measured[0].MeasuredValueSequence[0]
        assert float(value.NumericValue) == value.FloatingPointValue
        numbers.append(measured.value)
    # Voxels of 8 mm3: 4 x 4 x 4, 2 x 2 x 2, and two.
    assert numbers == pytest.approx([512.0, 64.0, 16.0])


def test_views_for_presentation(case_and_folder: tuple[SmallCase, Path]) -> None:
    """Turned so that the chest wall stands where readers expect it, outer side on top, bright on black."""
    case, folder = case_and_folder
    left = case.spec.laterality == "L"
    for view in range(case.stack.geometry.views):
        d = pydicom.dcmread(folder / f"presentation/{view + 1:04d}.dcm")
        expected = display_view(case.stack.data[view], 60000.0, 0.85)
        np.testing.assert_array_equal(pixel_array(d), expected[::-1] if left else expected[:, ::-1])
        assert list(d.PatientOrientation) == (["A", "R"] if left else ["P", "FL"])
        assert (d.PhotometricInterpretation, d.PresentationLUTShape) == ("MONOCHROME2", "IDENTITY")
        assert (d.BitsStored, d.VOILUTFunction, d.PresentationIntentType) == (12, "LINEAR", "FOR PRESENTATION")
        source = d.SourceImageSequence[0].ReferencedSOPInstanceUID
        raw = pydicom.dcmread(folder / f"projections/{view + 1:04d}.dcm", stop_before_pixels=True)
        assert source == raw.SOPInstanceUID
        assert d.PositionerPrimaryAngle == raw.PositionerPrimaryAngle
        # What tells where pixels lie against the beam does not hold for turned pixels.
        assert "DetectorPrimaryAngle" not in d
        assert "IsocenterReferenceSystemSequence" not in d


def test_what_a_display_view_shows() -> None:
    """Air is black; a dense spot is brighter than fat; the thin rim of a breast is nearly as bright as its middle."""
    y, x = np.mgrid[-80:80, 0:120].astype(float)
    inside = np.maximum(1 - (x / 100) ** 2 - (y / 70) ** 2, 0.0)
    thickness = 50.0 * np.minimum(np.sqrt(inside) * 1.6, 1.0)
    spot = np.hypot(x - 40, y) < 6
    signal = np.rint(60000 * np.exp(-0.05 * thickness - 0.03 * 10 * spot)).astype(np.uint16)
    image = display_view(signal, 60000.0, 0.5)
    breast = 0.05 * thickness > AIR
    assert not image[~breast].any()
    assert image[breast].min() > 0
    assert image[80, 40] > 1.1 * image[80, 20]
    rim = image[80, 94]
    assert 0.05 * thickness[80, 94] < 0.6 * 0.05 * thickness[80, 20]
    assert rim > 0.6 * image[80, 20]


def test_plates_in_the_beam_are_not_shown(tmp_path: Path) -> None:
    """Beside the breast the view is black although the plates take a part of the beam."""
    case = make_case(views=1, extras=["presentation"])
    data = case.stack.data.copy()
    data[:, :, 30:] = 60000 * np.exp(-0.3)
    data[:, :, :30] = 20000
    replace(case, stack=replace(case.stack, data=data, slab_integral=0.3)).export(tmp_path)
    image = hung(pixel_array(tmp_path / "presentation/0001.dcm"), "L")
    assert image[:, :30].all()
    assert not image[:, 30:].any()


def test_a_blank_view_is_black() -> None:
    assert not display_view(np.full((20, 30), 60000, np.uint16), 60000.0, 0.5).any()


@pytest.mark.parametrize("laterality", ["L", "R"])
def test_hung_images(laterality: str) -> None:
    """The chest wall (column 0) of a left breast stays left; its outer side (higher rows, patient left) goes up."""
    image = np.arange(6).reshape(2, 3)
    expected = [[3, 4, 5], [0, 1, 2]] if laterality == "L" else [[2, 1, 0], [5, 4, 3]]
    np.testing.assert_array_equal(hung(image, laterality), expected)


def test_synthetic_view_shows_what_lies_in_any_slice() -> None:
    grid = make_case().volume.grid
    data = np.random.default_rng(5).integers(19000, 21000, grid.shape).astype(np.uint16)
    data[2, 30, 20] = 40000
    data[7, 40, 10] = 40000
    breast = np.ones(grid.shape[1:], np.bool_)
    breast[:, 45:] = False
    image = synthetic_view(Volume(data, grid, 1e-5, -0.2), breast)
    brightest = np.argsort(image, axis=None)[-2:]
    assert {divmod(int(n), image.shape[1]) for n in brightest} == {(30, 20), (40, 10)}
    assert not image[:, 45:].any()


def test_synthetic_view_lies_over_the_volume(case_and_folder: tuple[SmallCase, Path]) -> None:
    """Its corners are those of the slices, half way up, and its pixels lie in the order that it says."""
    case, folder = case_and_folder
    d = pydicom.dcmread(folder / "synthetic_2d.dcm")
    breast = (pixel_array(folder / "labels.dcm") > 0).any(axis=0)
    expected = synthetic_view(case.volume, breast)
    shown = d.pixel_array != 0
    np.testing.assert_array_equal(shown, (expected[::-1] if case.spec.laterality == "L" else expected[:, ::-1]) != 0)
    volume = pydicom.dcmread(folder / "tomosynthesis.dcm")
    assert list(d.ImageType) == ["DERIVED", "PRIMARY", "TOMOSYNTHESIS", "GENERATED_2D"]

    def corners(dataset: pydicom.Dataset, frames: list[int]) -> NDArray[np.float64]:
        shared = dataset.SharedFunctionalGroupsSequence[0]
        row = np.array(shared.PlaneOrientationSequence[0].ImageOrientationPatient[:3], float)
        column = np.array(shared.PlaneOrientationSequence[0].ImageOrientationPatient[3:], float)
        dy, dx = (float(s) for s in shared.PixelMeasuresSequence[0].PixelSpacing)
        positions = [
            np.array(dataset.PerFrameFunctionalGroupsSequence[k].PlanePositionSequence[0].ImagePositionPatient, float)
            for k in frames
        ]
        first = np.mean(positions, axis=0)
        ends = [(j, i) for j in (0, dataset.Rows - 1) for i in (0, dataset.Columns - 1)]
        points = np.array([first + row * dx * i + column * dy * j for j, i in ends])
        return points[np.lexsort(np.round(points, 6).T)]

    np.testing.assert_allclose(corners(d, [0]), corners(volume, [0, 8]), atol=1e-6)


def test_ct_slices(case_and_folder: tuple[SmallCase, Path]) -> None:
    case, folder = case_and_folder
    files = sorted((folder / "ct").glob("*.dcm"))
    assert len(files) == 9
    volume = highdicom.spatial.get_series_volume_positions([pydicom.dcmread(f) for f in files])
    assert volume[0] == pytest.approx(case.volume.grid.spacing[2])
    tomosynthesis = pydicom.dcmread(folder / "tomosynthesis.dcm")
    for k, file in enumerate(files):
        d = pydicom.dcmread(file)
        np.testing.assert_array_equal(pixel_array(d), case.volume.data[k])
        frame = tomosynthesis.PerFrameFunctionalGroupsSequence[k]
        assert list(d.ImagePositionPatient) == list(frame.PlanePositionSequence[0].ImagePositionPatient)
        assert d.FrameOfReferenceUID == tomosynthesis.FrameOfReferenceUID
        attenuation = case.volume.slope * case.volume.data[k] + case.volume.intercept
        hu = float(d.RescaleSlope) * case.volume.data[k] + float(d.RescaleIntercept)
        np.testing.assert_allclose(hu, 1000 * (attenuation / 0.08096 - 1), rtol=1e-9)


def test_water() -> None:
    assert water_per_mm(20.0) == pytest.approx(0.08096)
    assert water_per_mm(np.sqrt(20.0 * 30.0)) == pytest.approx(np.sqrt(0.08096 * 0.03756))
    with pytest.raises(ExportError, match="from 10 to 150 keV"):
        water_per_mm(9.0)


def test_attenuation_map(case_and_folder: tuple[SmallCase, Path]) -> None:
    case, folder = case_and_folder
    labels = pixel_array(folder / "labels.dcm")
    expected = np.array(case.case.attenuation_per_mm, np.float32)[labels]
    parametric = highdicom.pm.ParametricMap.from_dataset(pydicom.dcmread(folder / "attenuation.dcm"))
    np.testing.assert_array_equal(parametric.pixel_array, expected)
    read = parametric.get_volume(apply_real_world_transform=True)
    assert read.array.max() == pytest.approx(float(expected.max()))
    mapping = parametric.SharedFunctionalGroupsSequence[0].RealWorldValueMappingSequence[0]
    assert mapping.MeasurementUnitsCodeSequence[0].CodeValue == "/mm"


def test_attenuation_map_needs_the_coefficients(tmp_path: Path) -> None:
    case = make_case(extras=["attenuation"])
    with pytest.raises(ExportError, match="leave 'attenuation' out"):
        replace(case, case=replace(case.case, attenuation_per_mm=())).export(tmp_path)


def test_the_pipeline_tells_the_coefficients_it_projects_with() -> None:
    table = attenuation_per_mm(PhysicsSpec(attenuation="johns-yaffe-20keV"))
    assert table[:3] == (0.0, 0.0456, 0.0802)


def voxels_by_name(labels: NDArray[np.uint8], truth: list[dict]) -> dict[str, int]:
    """Voxels of each lesion of a volume of its own voxels, which must all be of one lesion."""
    grid = Grid(labels.shape, (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    lesions = find_lesions(Phantom(labels, grid, truth=tuple(truth)), 0.0, grid)
    together = np.concatenate([lesion.voxels for lesion in lesions])
    assert len(np.unique(together, axis=0)) == len(together) == np.count_nonzero(labels >= 5)
    return {lesion.name: len(lesion.voxels) for lesion in lesions}


def test_a_small_mass_beside_a_large_one_takes_none_of_its_voxels() -> None:
    labels = np.zeros((20, 40, 40), np.uint8)
    labels[2:18, 2:34, 2:18] = 5
    labels[9:11, 36:38, 9:11] = 5
    entries = [
        {"id": "large", "tissue": "mass", "centre_mm": [10.0, 18.0, 10.0], "size_mm": [16.0, 32.0, 16.0]},
        {"id": "small", "tissue": "mass", "centre_mm": [10.0, 37.0, 10.0], "size_mm": [2.0, 2.0, 2.0]},
    ]
    assert voxels_by_name(labels, entries) == {"large": 16 * 32 * 16, "small": 8}
    touching = labels.copy()
    touching[9:11, 34:36, 9:11] = 5
    assert voxels_by_name(touching, entries) == {"large": 16 * 32 * 16 + 8, "small": 8}


def test_voxels_that_touch_by_a_corner_belong_together() -> None:
    labels = np.zeros((5, 30, 30), np.uint8)
    labels[2, 2:10, 2:10] = 5
    labels[2, 10, 10] = 5
    labels[2, 14:16, 14:16] = 5
    entries = [
        {"id": "own", "tissue": "mass", "centre_mm": [6.0, 6.0, 2.5], "size_mm": [8.0, 8.0, 1.0]},
        {"id": "other", "tissue": "mass", "centre_mm": [15.0, 15.0, 2.5], "size_mm": [30.0, 30.0, 30.0]},
    ]
    assert voxels_by_name(labels, entries) == {"own": 65, "other": 4}


def test_a_mass_around_its_own_centre_and_one_that_broke_off() -> None:
    labels = np.zeros((5, 30, 30), np.uint8)
    labels[2, 2:20, 2:20] = 5
    labels[2, 5:17, 5:20] = 0  # a C about its centre
    labels[2, 25:28, 25:28] = 5
    labels[2, 22, 22] = 5
    entries = [
        {"id": "c", "tissue": "mass", "centre_mm": [9.0, 11.0, 2.5], "size_mm": [18.0, 18.0, 1.0]},
        {"id": "block", "tissue": "mass", "centre_mm": [26.5, 26.5, 2.5], "size_mm": [3.0, 3.0, 1.0]},
    ]
    counts = voxels_by_name(labels, entries)
    assert counts == {"c": 18 * 18 - 12 * 15 + 1, "block": 9}


def test_segments_that_no_element_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("simcore.dicom.objects.lesion_segmentation.MAX_BYTES", 1000)
    with pytest.raises(ExportError, match=r"3 lesions hold \d+ bytes in 7 frames; .* at most 1000: use thicker slices"):
        make_case(lesions=True).export(tmp_path)
