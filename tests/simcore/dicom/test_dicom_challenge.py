"""Boxes and file paths as the challenge's reader takes them: every lesion lies in its box, left and right."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pydicom
import pytest
from numpy.typing import NDArray

from simcore.core.artifacts import Volume
from tests.support.dicom_case import SmallCase, make_case

from .challenge_reader import box_mask, read_boxes, read_image, window

VIEWS = [("L", "CC"), ("R", "CC"), ("L", "MLO"), ("R", "MLO")]


def reconstructed(case: SmallCase, **changes: object) -> SmallCase:
    """The case with a volume that shows its breast: bright at the chest wall, air beyond the nipple; the voxels of
    lesions brightest."""
    z, y, x = (case.volume.grid.centres(axis) for axis in "zyx")
    breast = ((x / 36) ** 2 + (y[:, None] / 25) ** 2)[None] < 1 - ((z[:, None, None] - 42) / 30) ** 2
    data = np.where(breast, 26000, 20000).astype(np.uint16)
    return replace(case, volume=Volume(data, case.volume.grid, 1e-5, -0.2), **changes)


def lesion_voxels(folder: Path) -> dict[str, NDArray[np.bool_]]:
    """Mask (slices, rows, columns) of every segment in the frame of the stored volume."""
    d = pydicom.dcmread(folder / "lesions.dcm")
    volume = pydicom.dcmread(folder / "tomosynthesis.dcm", stop_before_pixels=True)
    places = [tuple(f.PlanePositionSequence[0].ImagePositionPatient) for f in volume.PerFrameFunctionalGroupsSequence]
    masks = {n: np.zeros((len(places), d.Rows, d.Columns), np.bool_) for n in range(1, len(d.SegmentSequence) + 1)}
    for frame, pixels in zip(d.PerFrameFunctionalGroupsSequence, d.pixel_array, strict=True):
        number = frame.SegmentIdentificationSequence[0].ReferencedSegmentNumber
        masks[number][places.index(tuple(frame.PlanePositionSequence[0].ImagePositionPatient))] |= pixels > 0
    return {d.SegmentSequence[n - 1].SegmentLabel: mask for n, mask in masks.items()}


@pytest.mark.parametrize("encoding", ["none", "jpeg-ls", "rle"])
@pytest.mark.parametrize(("laterality", "view"), VIEWS)
def test_every_lesion_lies_in_its_box(tmp_path: Path, laterality: str, view: str, encoding: str) -> None:
    case = reconstructed(make_case(laterality=laterality, view=view, lesions=True, encoding=encoding))
    case.export(tmp_path)
    masks = lesion_voxels(tmp_path)
    rows = read_boxes(tmp_path / "truth.csv", tmp_path / "file_paths.csv")
    assert len(rows) == len(masks) == 3
    inside = total = 0
    for row, mask in zip(rows, masks.values(), strict=True):
        file = tmp_path / row["descriptive_path"]
        assert row["classic_path"] == row["descriptive_path"] == "tomosynthesis.dcm"
        k = int(row["Slice"])
        drawn = box_mask(mask.shape[1:], row)
        for image in (read_image(file, row["View"])[k], read_image(file, row["View"], k)):
            # What the reader shows of the lesion, turned as it turned the image.
            stored = pydicom.dcmread(file).pixel_array[k]
            is_turned = not np.array_equal(image, stored)
            assert is_turned == (laterality == "R")
            shown = np.flip(mask, axis=(-1, -2)) if is_turned else mask
            inside += int(np.count_nonzero(shown & drawn))
            total += int(np.count_nonzero(shown))
            # As small as it can be.
            occupied = np.argwhere(shown.any(axis=0))
            assert np.array_equal(occupied.min(axis=0), [int(row["Y"]), int(row["X"])])
            assert np.array_equal(np.ptp(occupied, axis=0) + 1, [int(row["Height"]), int(row["Width"])])
        stored_row = {**row, "X": row["StoredX"], "Y": row["StoredY"]}
        assert not np.any(mask & ~box_mask(mask.shape[1:], stored_row))
    assert inside == total > 100


def test_the_rule_of_the_issue(tmp_path: Path) -> None:
    """X' = columns - X - W, Y' = rows - Y - H for a right breast."""
    reconstructed(make_case(laterality="R", lesions=True)).export(tmp_path)
    d = pydicom.dcmread(tmp_path / "tomosynthesis.dcm", stop_before_pixels=True)
    for row in read_boxes(tmp_path / "truth.csv", tmp_path / "file_paths.csv"):
        assert int(row["X"]) == d.Columns - int(row["StoredX"]) - int(row["Width"])
        assert int(row["Y"]) == d.Rows - int(row["StoredY"]) - int(row["Height"])


def test_window_is_where_the_reader_looks(tmp_path: Path) -> None:
    reconstructed(make_case(views=1)).export(tmp_path)
    assert window(tmp_path / "tomosynthesis.dcm") == (26000.5, 1.0)


def test_volumes_that_mislead_the_reader_are_told(tmp_path: Path) -> None:
    """Slice 0 brighter at its far end: the reader turns the whole volume of a left breast, but not slice 4."""
    case = reconstructed(make_case(lesions=True))
    data = case.volume.data.copy()
    data[0] = data[0, :, ::-1]
    exported = replace(case, volume=replace(case.volume, data=data)).exported(tmp_path)
    assert any("truth.csv" in note and "StoredX" in note for note in exported.notes)
    rows = read_boxes(tmp_path / "truth.csv", tmp_path / "file_paths.csv")
    assert all((row["X"], row["Y"]) == (row["StoredX"], row["StoredY"]) for row in rows)
    file = tmp_path / "tomosynthesis.dcm"
    assert np.array_equal(read_image(file, "lcc", int(rows[0]["Slice"])), data[int(rows[0]["Slice"])])
    assert not np.array_equal(read_image(file, "lcc"), data)
    assert reconstructed(make_case(lesions=True)).exported(tmp_path / "plain").notes == ()


def test_what_is_not_there_is_told(tmp_path: Path) -> None:
    """A report was asked for and there is nothing to report; a lesion lies beyond a small volume."""
    case = make_case(lesions=True, extras=["report"])
    bare = replace(case, phantom=replace(case.phantom, labels=np.minimum(case.phantom.labels, 1), truth=()))
    exported = bare.exported(tmp_path / "bare")
    assert exported.left_out == dict.fromkeys(["lesions.dcm", "report.dcm"], "the volume holds no lesion")
    assert exported.report() == {"left_out": exported.left_out}
    assert reconstructed(case).exported(tmp_path / "whole").report() == {}
    low = replace(case.volume.grid, shape=(4, 61, 50))
    cut = replace(case, volume=Volume(case.volume.data[:4].copy(), low, 1e-5, -0.2)).exported(tmp_path / "cut")
    assert cut.left_out == {}
    assert [note for note in cut.notes if "beyond the volume" in note] == [
        "calcifications-1 lies beyond the volume: it has no box in truth.csv and no segment"
    ]


@pytest.mark.parametrize(("encoding", "takes"), [("none", False), ("jpeg-ls", True), ("rle", True)])
def test_encodings_that_the_reader_takes(tmp_path: Path, encoding: str, takes: bool) -> None:
    """It decompresses what it reads, and pydicom refuses that where nothing is compressed."""
    make_case(views=1, encoding=encoding).export(tmp_path)
    d = pydicom.dcmread(tmp_path / "tomosynthesis.dcm")
    if takes:
        d.decompress()
        assert d.pixel_array.shape == (9, 61, 50)
    else:
        with pytest.raises(ValueError, match="already uncompressed"):
            d.decompress()
