"""Pixels, values and labels come back as they went in; equal arguments give equal bytes, changed ones new identity."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import highdicom
import numpy as np
import pydicom
import pytest
from numpy.typing import NDArray
from pydicom.pixels import pixel_array

from simcore.core.artifacts import Compression, Phantom, ProjectionStack
from simcore.core.errors import ExportError
from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid
from simcore.dicom import CaseDescription
from simcore.dicom.resampling import encode_labels, nearest, sample
from tests.support.dicom_case import SmallCase, make_case, make_phantom


def labels_by_definition(case: SmallCase) -> NDArray[np.uint8]:
    """The label of the phantom voxel that holds each centre of the volume, one by one."""
    grid, source = case.volume.grid, case.phantom.grid.moved(z=case.stack.geometry.support_height)
    out = np.zeros(grid.shape, np.uint8)
    for k, z in enumerate(grid.centres("z")):
        for j, y in enumerate(grid.centres("y")):
            for i, x in enumerate(grid.centres("x")):
                index = [int(np.floor((p - c) / s)) for p, c, s in zip((x, y, z), source.corner, source.spacing)]  # noqa: B905
                if all(0 <= f < n for f, n in zip(index[::-1], source.shape)):  # noqa: B905
                    out[k, j, i] = case.phantom.labels[index[2], index[1], index[0]]
    return out


def in_file_order(volume: highdicom.Volume, file: Path) -> NDArray[np.generic]:
    """highdicom orders slices so that its axes are right-handed; its affine says where the first one lies."""
    frames = pydicom.dcmread(file, stop_before_pixels=True).PerFrameFunctionalGroupsSequence
    first, last = (np.array(frames[k].PlanePositionSequence[0].ImagePositionPatient, float) for k in (0, -1))
    if np.allclose(volume.affine[:3, 3], first):
        return volume.array
    np.testing.assert_allclose(volume.affine[:3, 3], last)
    return volume.array[::-1]


@pytest.fixture(scope="module")
def folder(exported: Callable[[SmallCase], Path], small_case: SmallCase) -> Path:
    return exported(small_case)


def test_names_are_those_on_disk(tmp_path: Path, small_case: SmallCase) -> None:
    names = small_case.export(tmp_path / "new" / "folder")
    assert names[:5] == [f"projections/{n:04d}.dcm" for n in range(1, 6)]
    assert names[5:9] == ["projections.dcm", "tomosynthesis.dcm", "labels.dcm", "lesions.dcm"]
    assert names[9:] == ["truth.csv", "file_paths.csv"]
    on_disk = {str(f.relative_to(tmp_path / "new/folder")) for f in (tmp_path / "new").rglob("*") if f.is_file()}
    assert on_disk == set(names)


def test_projections(folder: Path, small_case: SmallCase) -> None:
    np.testing.assert_array_equal(pixel_array(folder / "projections.dcm"), small_case.stack.data)
    for view in range(5):
        file = folder / f"projections/{view + 1:04d}.dcm"
        np.testing.assert_array_equal(pixel_array(file), small_case.stack.data[view])
    d = pydicom.dcmread(folder / "projections.dcm")
    shared = d.SharedFunctionalGroupsSequence[0]
    assert shared.FramePixelDataPropertiesSequence[0].PixelIntensityRelationship == "LIN"
    assert (d.BitsStored, d.PhotometricInterpretation) == (16, "MONOCHROME1")


def test_volume_and_its_values(folder: Path, small_case: SmallCase) -> None:
    volume = small_case.volume
    np.testing.assert_array_equal(pixel_array(folder / "tomosynthesis.dcm"), volume.data)
    file = folder / "tomosynthesis.dcm"
    image = highdicom.imread(file)
    stored = image.get_volume(apply_real_world_transform=False, apply_modality_transform=False, dtype=np.uint16)
    np.testing.assert_array_equal(in_file_order(stored, file), volume.data)
    assert stored.spacing == pytest.approx((5.0, 0.9, 0.85))
    attenuation = in_file_order(image.get_volume(apply_real_world_transform=True), file)
    np.testing.assert_allclose(attenuation, volume.slope * volume.data + volume.intercept, rtol=1e-6)


def test_labels(folder: Path, small_case: SmallCase) -> None:
    expected = labels_by_definition(small_case)
    assert set(np.unique(expected)) == set(range(10))
    np.testing.assert_array_equal(pixel_array(folder / "labels.dcm"), expected)
    segmentation = highdicom.seg.segread(folder / "labels.dcm")
    read = in_file_order(segmentation.get_volume(combine_segments=True), folder / "labels.dcm")
    np.testing.assert_array_equal(read, expected)
    numbers = [s.SegmentNumber for s in segmentation.SegmentSequence]
    assert numbers == list(range(10))
    assert segmentation.file_meta.TransferSyntaxUID == pydicom.uid.RLELossless


def test_window_shows_the_breast(exported: Callable[[SmallCase], Path]) -> None:
    """Values of the breast lie in 20000..24000 here, of the air beside it at 0 and 60000: they must not count."""
    case = make_case()
    tissue = labels_by_definition(case)
    data = np.where(tissue > 0, case.volume.data, np.where(tissue.cumsum().reshape(tissue.shape) % 2, 0, 60000))
    d = pydicom.dcmread(
        exported(replace(case, volume=replace(case.volume, data=data.astype(np.uint16)))) / "tomosynthesis.dcm"
    )
    voi = d.SharedFunctionalGroupsSequence[0].FrameVOILUTSequence[0]
    low, high = (float(voi.WindowCenter) + sign * float(voi.WindowWidth) / 2 for sign in (-1, 1))
    assert 20000 <= low < 20050
    assert 23950 < high <= 24001


def rows_of_all_kinds(columns: int) -> Phantom:
    """Rows of noise, of long runs, of pairs and of one value."""
    random = np.random.default_rng(columns)
    labels = np.zeros((3, 7, columns), np.uint8)
    labels[0, 0] = random.integers(0, 10, columns)
    labels[0, 1] = 7
    labels[0, 2] = np.arange(columns) // 2 % 10
    labels[0, 3] = np.arange(columns) // 3 % 10
    labels[0, 4, -1] = 3
    labels[1] = np.sort(random.integers(0, 10, (7, columns)), axis=1)
    labels[2] = random.integers(0, 2, (7, columns))
    return Phantom(labels, Grid(labels.shape, (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)))


@pytest.mark.parametrize("columns", [1, 2, 3, 127, 128, 129, 130, 385])
def test_run_lengths(columns: int) -> None:
    """Of all lengths about 128; decoded by pydicom."""
    phantom = rows_of_all_kinds(columns)
    encoded = encode_labels(phantom, nearest(phantom.grid, phantom.grid))
    for frame, plane in zip(encoded.frames, phantom.labels, strict=True):
        assert len(frame) % 2 == 0
        decoded = pydicom.pixels.decoders.rle._rle_decode_frame(frame, 7, columns, 1, 8)
        np.testing.assert_array_equal(np.frombuffer(decoded, np.uint8).reshape(7, columns), plane)
    assert encoded.tissues == tuple(int(v) for v in np.unique(phantom.labels) if v)


def test_same_run_lengths_for_any_number_of_threads(threads: Callable[[int], None]) -> None:
    phantom = rows_of_all_kinds(385)
    frames = []
    for count in (1, 2):
        threads(count)
        frames.append(list(encode_labels(phantom, nearest(phantom.grid, phantom.grid)).frames))
    assert frames[0] == frames[1]


def test_sample_is_a_subset_of_the_labels() -> None:
    case = make_case()
    lookup = nearest(case.phantom.grid.moved(z=22.0), case.volume.grid)
    np.testing.assert_array_equal(sample(case.phantom, lookup, (2, 3, 4)), labels_by_definition(case)[::2, ::3, ::4])


def _digests(folder: Path) -> dict[str, str]:
    files = (f for f in folder.rglob("*") if f.is_file())
    return {str(f.relative_to(folder)): hashlib.sha256(f.read_bytes()).hexdigest() for f in files}


def _identifiers(folder: Path) -> set[str]:
    datasets = [pydicom.dcmread(f, stop_before_pixels=True) for f in folder.rglob("*.dcm")]
    return {d.SOPInstanceUID for d in datasets} | {d.StudyInstanceUID for d in datasets}


def test_two_runs_give_the_same_bytes(
    exported: Callable[[SmallCase], Path], small_case: SmallCase, folder: Path, tmp_path: Path
) -> None:
    """Also from memory maps, as the store gives them."""
    for name, array in (("stack", small_case.stack.data), ("volume", small_case.volume.data)):
        np.save(tmp_path / f"{name}.npy", array)
    mapped = replace(
        make_case(),
        stack=replace(small_case.stack, data=np.load(tmp_path / "stack.npy", mmap_mode="r")),
        volume=replace(small_case.volume, data=np.load(tmp_path / "volume.npy", mmap_mode="r")),
    )
    assert _digests(exported(mapped)) == _digests(folder)


def _one_pixel(case: SmallCase) -> SmallCase:
    data = case.stack.data.copy()
    data[2, 3, 4] ^= 1
    return replace(case, stack=replace(case.stack, data=data))


def _one_voxel(case: SmallCase) -> SmallCase:
    data = case.volume.data.copy()
    data[2, 3, 4] ^= 1
    return replace(case, volume=replace(case.volume, data=data))


def _one_label(case: SmallCase) -> SmallCase:
    labels = case.phantom.labels.copy()
    labels[10, 13, 5] = 1 + labels[10, 13, 5] % 9
    return replace(case, phantom=replace(case.phantom, labels=labels))


def _force(case: SmallCase) -> SmallCase:
    return replace(case, compression=Compression(np.zeros((4, 3)), (-20.0, 20.0), 98.0, "converged"))


def _laterality(case: SmallCase) -> SmallCase:
    return replace(case, spec=case.spec.with_(laterality="R"))


@pytest.mark.parametrize("change", [_one_pixel, _one_voxel, _one_label, _force, _laterality])
def test_changed_content_has_new_identity(
    exported: Callable[[SmallCase], Path], folder: Path, change: Callable[[SmallCase], SmallCase]
) -> None:
    """An archive would keep the old object under a known identifier."""
    changed = exported(change(make_case()))
    assert not _identifiers(changed) & _identifiers(folder)


def test_identifiers_are_unique_and_short(folder: Path) -> None:
    datasets = [pydicom.dcmread(f, stop_before_pixels=True) for f in folder.rglob("*.dcm")]
    assert len({d.SOPInstanceUID for d in datasets}) == 9
    assert len({d.SeriesInstanceUID for d in datasets}) == 5
    assert len({d.StudyInstanceUID for d in datasets}) == 1
    assert all(len(d.SOPInstanceUID) <= 64 and d.SOPInstanceUID.is_valid for d in datasets)
    volume = next(d for d in datasets if d.SOPClassUID == pydicom.uid.BreastTomosynthesisImageStorage)
    source = volume.XRay3DAcquisitionSequence[0].SourceImageSequence[0].ReferencedSOPInstanceUID
    assert source == pydicom.dcmread(folder / "projections.dcm", stop_before_pixels=True).SOPInstanceUID


def test_private_block_is_enough_to_reconstruct(folder: Path, small_case: SmallCase) -> None:
    def document(name: str) -> dict[str, object]:
        dataset = pydicom.dcmread(folder / name, stop_before_pixels=True)
        content: dict[str, object] = json.loads(dataset.private_block(0x0099, "TOMOSIM 1")[0x01].value)
        return content

    view = document("projections/0002.dcm")
    assert (view["open_field"], view["offset"], view["view"]) == (60000.0, 0.0, 1)
    geometry = AcquisitionGeometry.from_dict(view["geometry"])  # type: ignore[arg-type]
    np.testing.assert_array_equal(geometry.sources, small_case.stack.geometry.sources)
    assert document("projections.dcm")["energy_keV"] == 20.0
    assert document("labels.dcm")["truth"] == list(small_case.phantom.truth)
    assert document("tomosynthesis.dcm")["grid"] == small_case.volume.grid.to_dict()


def test_progress_rises_to_one(tmp_path: Path, small_case: SmallCase) -> None:
    from simcore import dicom

    fractions: list[float] = []
    c = small_case
    dicom.export(
        tmp_path, c.spec, c.case, c.stack, c.volume, c.phantom, c.compression, lambda f, _: fractions.append(f)
    )
    assert fractions == sorted(fractions)
    assert (fractions[0], fractions[-1]) == (0.0, 1.0)


def test_what_does_not_fit_is_refused(tmp_path: Path, small_case: SmallCase) -> None:
    narrow = replace(small_case, case=CaseDescription("00" * 32, 1, "0.1.0", 20.0, detector_bits=14))
    with pytest.raises(ExportError, match="detector_bits = 14"):
        narrow.export(tmp_path)
    short = ProjectionStack(small_case.stack.data[:3].copy(), 60000.0, small_case.stack.geometry)
    with pytest.raises(ExportError, match=r"\(3, 64, 48\)"):
        replace(small_case, stack=short).export(tmp_path)
    strange = make_phantom()
    labels = strange.labels.copy()
    labels[labels == 9] = 15
    with pytest.raises(ExportError, match=r"label 15.*9 duct"):
        replace(small_case, phantom=replace(strange, labels=labels)).export(tmp_path / "strange")


def test_bits_stored(tmp_path: Path, small_case: SmallCase) -> None:
    data = (small_case.stack.data // 4).astype(np.uint16)
    case = replace(
        small_case,
        stack=ProjectionStack(data, 15000.0, small_case.stack.geometry),
        case=CaseDescription("00" * 32, 1, "0.1.0", 20.0, detector_bits=14),
    )
    case.export(tmp_path)
    for name in ("projections.dcm", "projections/0001.dcm"):
        d = pydicom.dcmread(tmp_path / name)
        assert (d.BitsStored, d.HighBit) == (14, 13)


def test_a_phantom_may_reach_beyond_the_plates(exported: Callable[[SmallCase], Path]) -> None:
    """Its grid need not begin on the support: labels, lesions and boxes stay where they are."""
    case = make_case(lesions=True, extras=["synthetic-2d"])
    grid = case.phantom.grid
    labels = np.pad(case.phantom.labels, ((3, 2), (0, 0), (0, 0)))
    labels[:3, 5:9, 3:6] = labels[-2:, 5:9, 3:6] = 1  # hangs over the edge of the plates
    larger = Grid(labels.shape, grid.spacing, (grid.corner[0], grid.corner[1], grid.corner[2] - 3 * grid.spacing[2]))
    plain = exported(case)
    other = exported(replace(case, phantom=replace(case.phantom, labels=labels, grid=larger)))
    for name in ("labels.dcm", "lesions.dcm", "tomosynthesis.dcm"):
        expected = pixel_array(plain / name)
        if name == "labels.dcm":
            # The volume of this case begins 2 mm below the support: what hangs over is seen where it reaches.
            expected = labels_by_definition(replace(case, phantom=replace(case.phantom, labels=labels, grid=larger)))
        np.testing.assert_array_equal(pixel_array(other / name), expected)
    boxes = [[row.split(",")[2:] for row in (f / "truth.csv").read_text().splitlines()] for f in (plain, other)]
    assert boxes[0] == boxes[1]
