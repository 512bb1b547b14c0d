"""What headers of people's files say: units, skips, lists, tilts, and what replaces it; and blocks of voxels."""

from __future__ import annotations

import bz2
import gzip
import io
import re
import time
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest

from simcore import estimate, phantom
from simcore.core.errors import ResourceLimitError, SpecError
from simcore.phantom.upload import registry
from simcore.phantom.upload.formats import decoding
from simcore.phantom.upload.formats.decoding import blocks, read_header
from simcore.phantom.upload.formats.header import Header
from simcore.phantom.upload.formats.joining import join, two_files
from simcore.phantom.upload.reading import Reading
from simcore.phantom.upload.spec import UploadedPhantom
from simcore.phantom.upload.values import labels_of
from simcore.presets import get
from simcore.store.store import Store
from tests.support import upload_files as files

RANDOM = np.random.default_rng(0).integers(0, 127, (5, 6, 7)).astype("u1")
BREAST = files.half_breast()


def head(data: bytes) -> Header:
    return read_header(io.BytesIO(data))


def labels(data: bytes) -> np.ndarray:
    file = io.BytesIO(data)
    header = read_header(file)
    result = np.zeros(header.shape, np.uint16)
    for plane, row, part in blocks(file, header):
        result[plane : plane + part.shape[0], row : row + part.shape[1]] = labels_of(part, header)
    return result


def refusal(data: bytes) -> str:
    with pytest.raises(SpecError) as caught:
        head(data).placed()
    return str(caught.value)


UNITS = {"mm": 1.0, "cm": 10.0, "um": 1e-3, "µm": 1e-3, "microns": 1e-3, "m": 1000.0, "nm": 1e-6, "inch": 25.4, "": 1.0}


@pytest.mark.parametrize("unit", UNITS)
def test_lengths_come_in_any_unit(unit: str) -> None:
    scale = UNITS[unit]
    edges = [f"{e / scale:.12g}" for e in (0.1, 0.2, 0.3)]
    quoted = f'"{unit}" "{unit}" "{unit}"'
    a, b, c = edges
    vectors = f"space directions: ({a},0,0) (0,{b},0) (0,0,{c})\nspace: LPS\nspace units: {quoted}"
    for data in (
        files.as_nrrd(RANDOM, more=vectors, without="spacings"),
        files.as_nrrd(RANDOM, more=f"spacings: {a} {b} {c}\nunits: {quoted}", without="spacings"),
        files.as_nrrd(RANDOM, more=f"spacings: {a} {b} {c}\nspace units: {quoted}", without="spacings"),
        files.as_metaimage(RANDOM, more=f"ElementSpacing = {a} {b} {c}\nDistanceUnits = {unit}", without="ElementSp"),
    ):
        assert head(data).spacing_mm == pytest.approx((0.3, 0.2, 0.1))
    for code, name in ((0, ""), (1, "m"), (2, "mm"), (3, "um")):
        if name == unit:
            data = files.as_nifti(RANDOM, spacing=(0.3 / scale, 0.2 / scale, 0.1 / scale), units=code)
            assert head(data).spacing_mm == pytest.approx((0.3, 0.2, 0.1))


def test_a_strange_unit_and_two_at_once_are_refused_unless_the_size_is_given() -> None:
    data = files.as_nrrd(RANDOM, more='units: "furlong" "furlong" "furlong"')
    assert "NRRD units = 'furlong' is no unit of length that is known (mm, cm, m, um, nm, in): give" in refusal(data)
    assert head(data).placed(spacing_mm=(1.0, 1.0, 1.0))[0] == (1.0, 1.0, 1.0)
    assert "one for all axes is needed" in refusal(files.as_nrrd(RANDOM, more='units: "mm" "mm" "cm"'))
    assert "DistanceUnits = 'mile'" in refusal(files.as_metaimage(RANDOM, more="DistanceUnits = mile"))
    assert "xyzt_units = 5" in refusal(files.as_nifti(RANDOM, units=5))


def test_directions_and_spacings_that_differ_are_refused() -> None:
    vectors = "space: LPS\nspace directions: (0.1,0,0) (0,0.2,0) (0,0,0.4)"
    assert "spacings [0.1, 0.2, 0.3]: give spacing_mm" in refusal(files.as_nrrd(RANDOM, more=vectors))


@pytest.mark.parametrize("size", [100_000, 3_000_000])
def test_headers_may_be_long(tmp_path: Path, size: int) -> None:
    comment = "\n".join(["# " + 98 * "x"] * (size // 100))
    np.testing.assert_array_equal(labels(files.as_nrrd(RANDOM, more=comment)), RANDOM)
    np.testing.assert_array_equal(labels(gzip.compress(files.as_nrrd(RANDOM, more=comment, encoding="raw"), 1)), RANDOM)
    meta = files.as_metaimage(RANDOM, more="Comment = " + size * "x")
    np.testing.assert_array_equal(labels(meta), RANDOM)
    (tmp_path / "a.raw").write_bytes(RANDOM.tobytes())
    header = files.as_nrrd(RANDOM, encoding="raw", more=comment + "\ndata file: a.raw")
    (tmp_path / "a.nhdr").write_bytes(header[: header.index(b"\n\n") + 2])
    assert two_files(tmp_path / "a.nhdr") is not None


def test_lines_are_skipped_before_unpacking_and_bytes_after() -> None:
    whole = files.as_nrrd(RANDOM, encoding="raw", more="line skip: 2\nbyte skip: 3")
    start = whole[: len(whole) - RANDOM.size]
    np.testing.assert_array_equal(labels(start + b"one\ntwo\nabc" + RANDOM.tobytes()), RANDOM)
    for encoding, pack in (("gzip", gzip.compress), ("bzip2", bz2.compress)):
        packed = start.replace(b"encoding: raw", f"encoding: {encoding}".encode())
        np.testing.assert_array_equal(labels(packed + b"one\ntwo\n" + pack(b"abc" + RANDOM.tobytes())), RANDOM)
    from_end = files.as_nrrd(RANDOM, encoding="raw", more="byte skip: -1")
    start = from_end[: len(from_end) - RANDOM.size]
    np.testing.assert_array_equal(labels(start + 1000 * b"x" + RANDOM.tobytes()), RANDOM)
    assert "only where encoding is raw" in refusal(files.as_nrrd(RANDOM, more="byte skip: -1"))
    assert "byte skip = -2" in refusal(files.as_nrrd(RANDOM, encoding="raw", more="byte skip: -2"))
    with pytest.raises(SpecError, match="line 1 has no end"):
        labels(files.as_nrrd(np.full_like(RANDOM, 5), encoding="raw", more="line skip: 1"))


def test_header_size_of_a_metaimage() -> None:
    data = files.as_metaimage(RANDOM, packed=False, more="HeaderSize = -1")
    np.testing.assert_array_equal(labels(data[: -RANDOM.size] + 99 * b"x" + RANDOM.tobytes()), RANDOM)
    assert "HeaderSize = -1: 0, or from" in refusal(files.as_metaimage(RANDOM, more="HeaderSize = -1"))
    assert "HeaderSize = -5" in refusal(files.as_metaimage(RANDOM, packed=False, more="HeaderSize = -5"))


def test_several_members_and_streams_wherever_a_piece_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    raw = files.as_nrrd(RANDOM, encoding="raw")
    start = raw[: len(raw) - RANDOM.size]
    parts = [RANDOM.tobytes()[:50], b"", RANDOM.tobytes()[50:]]
    for encoding, pack in (("gzip", gzip.compress), ("bzip2", bz2.compress)):
        data = start.replace(b"encoding: raw", f"encoding: {encoding}".encode()) + b"".join(map(pack, parts))
        for piece in (1, 2, 3, 7, 64, 1 << 20):
            monkeypatch.setattr(decoding, "PIECE", piece)
            np.testing.assert_array_equal(labels(data), RANDOM)


@pytest.mark.parametrize("axes", [("+z", "+y", "+x"), ("-x", "+z", "-y"), ("+y", "-x", "+z")])
@pytest.mark.parametrize("piece", [1, 100, 3000])
def test_a_plane_larger_than_a_piece_comes_in_rows(
    monkeypatch: pytest.MonkeyPatch, axes: tuple[str, str, str], piece: int
) -> None:
    order = ["zyx".index(axis[1]) for axis in axes]
    turned = np.ascontiguousarray(
        BREAST.transpose(order)[tuple(slice(None, None, 1 if a[0] == "+" else -1) for a in axes)]
    )

    def load(voxels: np.ndarray, leading: tuple[str, str, str]) -> np.ndarray:
        spec = UploadedPhantom(sha256=64 * "0", shape=voxels.shape, spacing_mm=(1.0, 1.0, 1.0), axes=leading)
        return phantom.load(spec, io.BytesIO(files.as_nrrd(voxels))).labels

    expected = load(BREAST, ("+z", "+y", "+x"))
    monkeypatch.setattr(decoding, "PIECE", piece)
    np.testing.assert_array_equal(load(turned, axes), expected)


def test_slopes_that_give_whole_numbers_are_taken() -> None:
    for stored, slope in ((RANDOM * 2.0, 0.5), (RANDOM * 10.0, 0.1), (RANDOM * 1.0, float("nan")), (RANDOM * 1.0, 0.0)):
        np.testing.assert_array_equal(labels(files.as_nifti(stored.astype("<i4"), slope=slope)), RANDOM)
    with pytest.raises(SpecError, match=r"scl_slope = 0\.01 .* turn the stored 1 into 0\.01, which is no whole"):
        labels(files.as_nifti(np.ones((3, 3, 3), "u1"), slope=0.01))


@pytest.mark.parametrize("value", [0.5, 1e-5, np.nan, np.inf, 1e300])
def test_numbers_that_are_no_labels_are_named(value: float) -> None:
    voxels = RANDOM.astype("f8")
    voxels[2, 3, 4] = value
    said = (
        r"names no tissue for 1e\+300, and none can"
        if value == 1e300
        else f"one is {value:.9g}, which is no whole number within 1e-06"
    )
    with pytest.raises(SpecError, match=said):
        labels(files.as_nrrd(voxels))
    voxels[2, 3, 4] = 3 + 1e-7
    assert labels(files.as_nrrd(voxels))[2, 3, 4] == 3


def test_a_function_of_intensity_in_a_metaimage_is_refused() -> None:
    data = files.as_metaimage(RANDOM, more="ElementToIntensityFunctionSlope = 2")
    assert "ElementToIntensityFunctionSlope = 2: remove it where the stored values are the labels" in refusal(data)


def test_a_volume_beyond_measure_is_refused_at_once_with_the_voxel_size_that_would_do() -> None:
    start = time.perf_counter()
    data = files.as_nrrd(RANDOM, more="sizes: 4000 4000 2000\nspacings: 0.05 0.05 0.1", without="spacings")
    assert "resample it to voxels of 0.062 x 0.062 x 0.124 mm" in refusal(data)
    assert "resample it to voxels of 0.2 x 0.4 x 0.6 mm" in refusal(files.as_nrrd(RANDOM, more="sizes: 40000 40 20"))
    assert time.perf_counter() - start < 1.0


@pytest.mark.parametrize("limit", [1_000_000_000, 4_000_000_000])
@pytest.mark.parametrize(
    "part",
    [
        UploadedPhantom(sha256=64 * "0", shape=(2164, 2150, 2150), spacing_mm=(0.1, 0.1, 0.1)),
        UploadedPhantom(sha256=64 * "0", shape=(2164, 2150, 1075), spacing_mm=(0.1, 0.1, 0.2)),
        get("tiny").phantom.with_(voxel_mm=0.05, volume_ml=2000.0),
    ],
)
def test_too_many_voxels_are_refused_with_a_size_that_then_suffices(limit: int, part: object) -> None:
    tiny = get("tiny")
    case = tiny.with_(phantom=part, acquisition=tiny.acquisition.with_(truncation="allow"))
    with pytest.raises(ResourceLimitError, match=r"use larger voxels \(.* mm would do\)") as caught:
        estimate.check(case, limit)
    edges = [float(e) for e in re.search(r"voxels \((.*) mm would", str(caught.value))[1].split(" x ")]
    factor = edges[0] / part.edges_mm[0]
    assert estimate.check(case.with_(phantom=part.with_coarser_voxels(factor)), limit).memory_bytes > limit / 2


def test_air_around_a_breast_needs_no_memory() -> None:
    tiny = get("tiny")
    part = UploadedPhantom(
        sha256=64 * "0", shape=(2164, 2150, 2150), spacing_mm=(0.1, 0.1, 0.1), extent_mm=(60.0, 90.0, 80.0)
    )
    case = tiny.with_(phantom=part, acquisition=tiny.acquisition.with_(truncation="allow"))
    assert estimate.check(case, 4_000_000_000).memory_bytes < 2e9


@pytest.mark.parametrize("speck", [False, True])
def test_a_volume_is_never_held_whole(tmp_path: Path, speck: bool) -> None:
    voxels = np.zeros((400, 500, 500), np.uint8)  # 100 MB
    if speck:
        voxels[0, 0, 499] = voxels[399, 499, 499] = 1
    voxels[200 : 200 + BREAST.shape[0], 100 : 100 + BREAST.shape[1], 50 : 50 + BREAST.shape[2]] = BREAST
    (tmp_path / "a.nrrd").write_bytes(files.as_nrrd(voxels, spacing=(2.0, 2.0, 2.0)))
    shape = voxels.shape
    del voxels
    store = Store(tmp_path / "store", min_free_bytes=0)
    tracemalloc.start()
    try:
        upload = registry.add_file(store, tmp_path / "a.nrrd")
        with registry.open_file(store, upload.spec) as file:
            loaded = phantom.load(upload.spec, file)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert upload.spec.shape == shape
    assert loaded.labels.size < 50_000
    assert peak < 50e6
    said = upload.spec.with_(extent_mm=(10.0, 70.0, 60.0))  # less than there is: its needs would be too small
    with pytest.raises(SpecError, match=r"phantom\.extent_mm = .*10\.0.*the tissue is 50 x 74 x 62 mm .*that, or none"):
        registry.require(store, said)
    with pytest.raises(SpecError, match=r"phantom\.extent_mm = .*10\.0.*the tissue is 50 x 74 x 62 mm; that, or none"):
        phantom.load(said, io.BytesIO((tmp_path / "a.nrrd").read_bytes()))


def test_a_matrix_of_a_metaimage_that_is_none_is_not_ignored() -> None:
    data = files.as_metaimage(RANDOM, more="TransformMatrix = 1 0 0 1", without="TransformMatrix")
    assert "TransformMatrix = '1 0 0 1': 9 numbers, or give axes" in refusal(data)
    assert head(data).placed(axes=("+z", "+y", "+x"))[1] == ("+z", "+y", "+x")


def test_a_header_with_its_voxels_behind_it_may_be_called_as_if_they_were_elsewhere(tmp_path: Path) -> None:
    for name, data in (("a.mhd", files.as_metaimage(RANDOM)), ("a.nhdr", files.as_nrrd(RANDOM))):
        (tmp_path / name).write_bytes(data)
        assert two_files(tmp_path / name) is None
        np.testing.assert_array_equal(labels((tmp_path / name).read_bytes()), RANDOM)


def test_voxels_in_a_folder_below_are_found_and_nothing_above(tmp_path: Path) -> None:
    (tmp_path / "inner" / "data").mkdir(parents=True)
    (tmp_path / "inner" / "data" / "a.raw").write_bytes(RANDOM.tobytes())
    (tmp_path / "above.raw").write_bytes(RANDOM.tobytes())
    for name, allowed in (("data/a.raw", True), ("../above.raw", False), (str(tmp_path / "above.raw"), False)):
        (tmp_path / "inner" / "a.mhd").write_bytes(files.as_metaimage(RANDOM, packed=False, data_file=name))
        if not allowed:
            with pytest.raises(SpecError, match=r"which is not beside it: put 'above\.raw' into the folder of a\.mhd"):
                two_files(tmp_path / "inner" / "a.mhd")
            continue
        voxels, header = two_files(tmp_path / "inner" / "a.mhd")
        target = io.BytesIO()
        with open(voxels, "rb") as source:
            join(header, source, target)
        np.testing.assert_array_equal(labels(target.getvalue()), RANDOM)
        assert header.remarks == ()


def test_zlib_that_metaio_takes_either_way() -> None:
    data = files.as_metaimage(RANDOM)
    packed = zlib.compress(RANDOM.tobytes())
    assert data.endswith(packed)
    np.testing.assert_array_equal(labels(data.replace(packed, gzip.compress(RANDOM.tobytes()))), RANDOM)


@pytest.mark.parametrize(
    ("spacing", "said"),
    [
        ((1.0, 0.9, 0.8), r"tissue is 10 ml .*10\.04 l in cm and less than 0\.001 ml in um: .*--confirm-size"),
        ((10.0, 9.0, 8.0), r"tissue is 10\.04 l .*a breast has from 20 ml to 5 l.* 1\.004e\+04 l in cm and less"),
    ],
)
def test_an_unlikely_size_is_to_be_confirmed(tmp_path: Path, spacing: tuple[float, float, float], said: str) -> None:
    store = Store(tmp_path / "store", min_free_bytes=0)
    (tmp_path / "a.nrrd").write_bytes(files.as_nrrd(BREAST, spacing=spacing))
    with pytest.raises(SpecError, match=said) as caught:
        registry.add_file(store, tmp_path / "a.nrrd")
    assert caught.value.code == "upload-unlikely-size"
    assert registry.uploads(store) == []
    assert registry.add_file(store, tmp_path / "a.nrrd", Reading(confirm_size=True)).spec.spacing_mm == spacing


def test_headers_that_would_take_for_ever_are_refused_at_once() -> None:
    start = time.perf_counter()
    long = 800_000 * "( "
    assert "'space directions' has" in refusal(files.as_nrrd(RANDOM, more=f"space: LPS\nspace directions: {long}"))
    assert "'transformmatrix' has" in refusal(files.as_metaimage(RANDOM, more=f"TransformMatrix = {long}"))
    assert "no ElementDataFile" in refusal(b"NDims = 3\n" + 400_000 * b"\n \n")
    assert "line skip = 1000000000: from 0 to 10000" in refusal(files.as_nrrd(RANDOM, more="line skip: 1000000000"))
    assert "byte skip = 1000000000000: from 0 to" in refusal(files.as_nrrd(RANDOM, more="byte skip: 1000000000000"))
    assert "a zip archive: unpack it" in refusal(b"PK\x03\x04" + 100 * b"x" + b"PK\5\6" + 8 * b"\0" + 10 * b"\xff")
    assert time.perf_counter() - start < 10.0


def test_what_is_said_replaces_what_the_file_says_and_is_remarked(tmp_path: Path) -> None:
    store = Store(tmp_path / "store", min_free_bytes=0)
    (tmp_path / "a.nrrd").write_bytes(files.as_nrrd(BREAST, spacing=(1.0, 1.0, 1.0)))
    reading = Reading(spacing_mm=(2.0, 2.0, 2.0), axes=("-z", "+y", "+x"))
    upload = registry.add_file(store, tmp_path / "a.nrrd", reading)
    assert upload.remarks[:2] == (
        "axes: -z,+y,+x as given, not +z,+y,+x as in the file",
        "voxels of 2 x 2 x 2 mm as given, not 1 x 1 x 1 as in the file",
    )
    assert registry.get(store, upload.sha256).remarks == upload.remarks
