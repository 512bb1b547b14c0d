"""Headers and voxels of uploaded files: what is read, and what is refused with which words."""

from __future__ import annotations

import gzip
import io
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from simcore.core.errors import SpecError
from simcore.phantom.upload.formats.decoding import blocks, read_header
from simcore.phantom.upload.formats.header import Header
from simcore.phantom.upload.formats.joining import join, two_files
from simcore.phantom.upload.reading import RawHeader, Reading
from simcore.phantom.upload.values import labels_of
from tests.support import upload_files as files

OURS = ("+z", "+y", "+x")
RANDOM = np.random.default_rng(0).integers(0, 127, (5, 6, 7))


def read(data: bytes) -> tuple[Header, np.ndarray]:
    file = io.BytesIO(data)
    header = read_header(file)
    header.placed()
    voxels = np.empty(header.shape, header.dtype)
    for plane, row, part in blocks(file, header):
        voxels[plane : plane + part.shape[0], row : row + part.shape[1]] = part
        labels_of(part, header)
    return header, voxels


WRITERS: dict[str, Callable[[np.ndarray], bytes]] = {
    "nrrd raw": lambda v: files.as_nrrd(v, encoding="raw"),
    "nrrd gzip": files.as_nrrd,
    "nrrd bzip2": lambda v: files.as_nrrd(v, encoding="bzip2"),
    "mha": lambda v: files.as_metaimage(v, packed=False),
    "mha zlib": files.as_metaimage,
    "nii": lambda v: files.as_nifti(v, packed=False),
    "nii.gz": files.as_nifti,
}


@pytest.mark.parametrize("dtype", ["u1", "i1", "<u2", ">u2", "<i2", ">i4", "<u4", ">i8", "<u8", ">f4", "<f8"])
@pytest.mark.parametrize("name", WRITERS)
def test_every_format_gives_back_shape_spacing_and_voxels(name: str, dtype: str) -> None:
    labels = RANDOM.astype(dtype)
    header, voxels = read(WRITERS[name](labels))
    assert header.format == {"nr": "nrrd", "mh": "metaimage", "ni": "nifti"}[name[:2]]
    assert header.shape == (5, 6, 7)
    assert header.spacing_mm == (0.3, 0.2, 0.1)
    assert header.axes == OURS
    np.testing.assert_array_equal(voxels, RANDOM)


def test_large_files_come_in_pieces_and_gzip_in_several_members() -> None:
    labels = np.random.default_rng(1).integers(0, 255, (40, 300, 250)).astype("u1")
    data = files.as_nrrd(labels, encoding="raw")
    head = data[: len(data) - labels.size].replace(b"encoding: raw", b"encoding: gzip")
    members = b"".join(gzip.compress(part.tobytes()) for part in np.array_split(labels, 3))
    file = io.BytesIO(head + members)
    parts = list(blocks(file, read_header(file)))
    assert len(parts) > 2
    assert [first for first, _, _ in parts] == list(np.cumsum([0] + [len(p) for _, _, p in parts])[:-1])
    np.testing.assert_array_equal(np.concatenate([p for _, _, p in parts]), labels)


DIRECTIONS = {
    # Axes of the array, fastest first, in LPS -> ours, slowest first.
    "A L S": ([[0, -1, 0], [1, 0, 0], [0, 0, 1]], ("+z", "+y", "+x")),
    "L P S": ([[1, 0, 0], [0, 1, 0], [0, 0, 1]], None),
    "R P I": ([[-1, 0, 0], [0, 1, 0], [0, 0, -1]], ("-z", "-x", "-y")),
    "S A R": ([[0, 0, 1], [0, -1, 0], [-1, 0, 0]], ("-y", "+x", "+z")),
}


@pytest.mark.parametrize("name", DIRECTIONS)
def test_orientation_of_the_patient_becomes_our_axes(name: str) -> None:
    directions, expected = DIRECTIONS[name]
    labels = RANDOM.astype("u1")
    d = np.array(directions, float)
    vectors = " ".join("(" + ",".join(map(str, row * s)) + ")" for row, s in zip(d, (0.1, 0.2, 0.3), strict=True))
    space = f"space directions: {vectors}\nspace: left-posterior-superior"
    nrrd = files.as_nrrd(labels, more=space, without="spacings")
    meta = files.as_metaimage(labels, more="TransformMatrix = " + " ".join(map(str, d.ravel())), without="TransformM")
    ras = np.eye(4)
    ras[:3, :3] = (d * [-1, -1, 1]).T * [0.1, 0.2, 0.3]
    nifti = files.as_nifti(labels, affine=ras)
    for data in (nrrd, meta, nifti):
        header, voxels = read(data)
        # A unit matrix means nothing in NRRD and MetaImage; NIfTI says that it is that of the patient.
        assert header.axes == (expected or (("+z", "-x", "+y") if data is nifti else OURS))
        assert header.spacing_mm == pytest.approx((0.3, 0.2, 0.1))
        np.testing.assert_array_equal(voxels, RANDOM)


def test_orientation_of_a_nifti_by_its_quaternion() -> None:
    # A quarter turn about z: the first axis leads to A, the second to L (-R), the third to S.
    data = files.as_nifti(RANDOM.astype("u1"), quaternion=(0.0, 0.0, np.sqrt(0.5)))
    assert read(data)[0].axes == ("+z", "+y", "+x")
    assert read(files.as_nifti(RANDOM.astype("u1"), quaternion=(0.0, 0.0, 0.0)))[0].axes == ("+z", "+x", "-y")


def test_lengths_in_metres_become_millimetres() -> None:
    assert read(files.as_nifti(RANDOM.astype("u1"), spacing=(3e-4, 2e-4, 1e-4), units=1))[0].spacing_mm == (
        0.3,
        0.2,
        0.1,
    )


REFUSED = {
    "nothing": (b"", "no NRRD, MetaImage or NIfTI"),
    "text": (b"hello world, this is no volume" * 20, "no NRRD, MetaImage or NIfTI"),
    "gzip of anything": (gzip.compress(b"some voxels" * 100), "raw voxels need a header"),
    "nrrd without end": (b"NRRD0004\ntype: uchar\n", "no end"),
    "nrrd without sizes": (files.as_nrrd(RANDOM.astype("u1"), without="sizes"), "no 'sizes'"),
    "nrrd of floats": (files.as_nrrd(RANDOM + 0.5), "no whole number"),
    "nrrd with an odd encoding": (files.as_nrrd(RANDOM.astype("u1"), more="encoding: hex"), "raw, gzip or bzip2"),
    "nrrd in two files": (files.as_nrrd(RANDOM.astype("u1"), more="data file: a.raw"), "another file"),
    "nrrd, dimension": (files.as_nrrd(RANDOM.astype("u1"), more="dimension: 4"), "differ"),
    "nrrd of two axes": (files.as_nrrd(RANDOM.astype("u1"), more="dimension: 2\nsizes: 7 6"), "a volume has 3"),
    "nrrd, sizes": (files.as_nrrd(RANDOM.astype("u1"), more="sizes: 7 6 x"), "'x' is no number"),
    "nrrd, a broken size": (files.as_nrrd(RANDOM.astype("u1"), more="sizes: 7 6 5.5"), "no whole number"),
    "nrrd of no size": (files.as_nrrd(RANDOM.astype("u1"), more="sizes: 7 0 5"), "from 1 to"),
    "nrrd, spacing": (files.as_nrrd(RANDOM.astype("u1"), spacing=(0, 1, 1)), "above 0"),
    "nrrd, endian": (files.as_nrrd(RANDOM.astype("<u2"), without="endian"), "no 'endian'"),
    "nrrd, skip": (files.as_nrrd(RANDOM.astype("u1"), more="byte skip: -1"), "byte skip"),
    "oblique": (
        files.as_nrrd(
            RANDOM.astype("u1"), more="space: LPS\nspace directions: (.8,.6,0) (-.6,.8,0) (0,0,1)", without="spacings"
        ),
        "not parallel",
    ),
    "mha without its last tag": (b"ObjectType = Image\nNDims = 3\n", "no ElementDataFile"),
    "mha of floats": (files.as_metaimage(RANDOM + 0.5), "no whole number"),
    "mha in two files": (files.as_metaimage(RANDOM.astype("u1"), data_file="a.raw"), r"another file, 'a\.raw'"),
    "mha as text": (files.as_metaimage(RANDOM.astype("u1"), more="BinaryData = False"), "binary form"),
    "mha of colours": (files.as_metaimage(RANDOM.astype("u1"), more="ElementNumberOfChannels = 3"), "Channels = 3"),
    "nifti of floats": (files.as_nifti(RANDOM + 0.5), "no whole number"),
    "nifti of complex numbers": (files.as_nifti(RANDOM.astype("u1"), code=32), "datatype = 32"),
    "nifti, scaled": (files.as_nifti(RANDOM.astype("u1"), slope=0.3), r"scl_slope = 0\.3.* nibabel\.save"),
    "nifti in two files": (
        files.as_nifti(RANDOM.astype("u1"), packed=False).replace(b"n+1\0", b"ni1\0"),
        "second file",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_read_is_refused_with_the_reason(name: str) -> None:
    data, said = REFUSED[name]
    with pytest.raises(SpecError, match=said):
        read(data)


@pytest.mark.parametrize("name", WRITERS)
def test_too_few_and_too_many_voxels_are_refused(name: str) -> None:
    # Incompressible and longer than a piece, so that packed files lose voxels when they are cut.
    labels = np.random.default_rng(2).integers(0, 255, (30, 200, 200)).astype("u1")
    data = WRITERS[name](labels)
    for cut in (0.99, 0.5, 0.1):
        with pytest.raises(SpecError, match=r"ends after|cut short|unpacked"):
            read(data[: int(cut * len(data))])
    bomb = WRITERS[name](np.zeros((300, 200, 200), "u1"))
    for old, new in ((b"200 200 300", b"200 200 30"), (b"\x2c\x01\x01\x00", b"\x1e\x00\x01\x00")):
        if name == "nii.gz":
            bomb = gzip.compress(gzip.decompress(bomb).replace(old, new))
        else:
            bomb = bomb.replace(old, new, 1)
    with pytest.raises(SpecError, match="holds more than the 1200000 bytes"):
        read(bomb)


def test_a_bomb_is_never_unpacked_beyond_what_its_header_announces(monkeypatch: pytest.MonkeyPatch) -> None:
    unpacked = []
    original = zlib.decompressobj

    class Counting:
        def __init__(self, window: int) -> None:
            self.inner = original(window)

        def decompress(self, data: bytes, limit: int) -> bytes:
            piece = self.inner.decompress(data, limit)
            unpacked.append(len(piece))
            return piece

        def __getattr__(self, name: str) -> object:
            return getattr(self.inner, name)

    data = files.as_nrrd(np.zeros((2000, 200, 200), "u1")).replace(b"200 200 2000", b"200 200 30")
    monkeypatch.setattr("simcore.phantom.upload.formats.decoding.zlib.decompressobj", Counting)
    with pytest.raises(SpecError, match="holds more"):
        read(data)
    assert sum(unpacked) <= 1_200_000 + 2**20


@pytest.mark.parametrize("name", WRITERS)
def test_damaged_files_are_read_or_refused_and_nothing_else(name: str) -> None:
    random = np.random.default_rng(7)
    data = WRITERS[name](RANDOM.astype("<u2"))
    outcomes = {"read": 0, "refused": 0}
    for _ in range(400):
        damaged = bytearray(data)
        for _ in range(random.integers(1, 4)):
            where = int(random.integers(0, len(damaged)))
            kind = random.integers(0, 3)
            if kind == 0:
                damaged[where] = random.integers(0, 256)
            elif kind == 1:
                del damaged[where : where + int(random.integers(1, 20))]
            else:
                damaged[where:where] = bytes(random.integers(0, 256, random.integers(1, 20)).astype("u1"))
        try:
            read(bytes(damaged))
            outcomes["read"] += 1
        except SpecError:
            outcomes["refused"] += 1
    assert outcomes["refused"] > 40


def joined(path: Path) -> bytes:
    pair = two_files(path)
    assert pair is not None
    target = io.BytesIO()
    with open(pair[0], "rb") as voxels:
        join(pair[1], voxels, target)
    return target.getvalue()


@pytest.mark.parametrize("dtype", ["u1", ">u2"])
def test_a_header_and_the_voxels_beside_it_become_one_file(tmp_path: Path, dtype: str) -> None:
    labels = RANDOM.astype(dtype)
    raw = labels.tobytes()
    packed = {"a.raw": raw, "a.zraw": zlib.compress(raw), "a.raw.gz": gzip.compress(raw)}
    for name, data in packed.items():
        (tmp_path / name).write_bytes(data)
        (tmp_path / "a.mhd").write_bytes(files.as_metaimage(labels, packed=name == "a.zraw", data_file=name))
        header, voxels = read(joined(tmp_path / "a.mhd"))
        assert (header.shape, header.spacing_mm) == ((5, 6, 7), (0.3, 0.2, 0.1))
        np.testing.assert_array_equal(voxels, RANDOM)
    for name in ("a.raw", "a.raw.gz"):
        text = files.as_nrrd(labels, encoding="gzip" if name == "a.raw.gz" else "raw", more=f"data file: {name}")
        head = text[: text.index(b"\n\n") + 1]  # without the empty line, which a detached header may lack
        (tmp_path / "a.nhdr").write_bytes(head)
        header, voxels = read(joined(tmp_path / "a.nhdr"))
        assert (header.shape, header.spacing_mm) == ((5, 6, 7), (0.3, 0.2, 0.1))
        np.testing.assert_array_equal(voxels, RANDOM)
    assert two_files(tmp_path / "a.raw") is None


@pytest.mark.parametrize("name", ["gone.raw", "../a.raw", "/etc/passwd", "LIST", "a%03d.raw 1 5 1"])
def test_only_a_file_beside_the_header_is_taken_for_its_voxels(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "inner"
    folder.mkdir()
    (tmp_path / "a.raw").write_bytes(RANDOM.astype("u1").tobytes())
    (folder / "a.mhd").write_bytes(files.as_metaimage(RANDOM.astype("u1"), data_file=name))
    with pytest.raises(SpecError, match=r"not beside it|one file is needed"):
        two_files(folder / "a.mhd")


def test_raw_voxels_with_a_header_of_their_own() -> None:
    labels = RANDOM.astype("<i2")
    raw = RawHeader(shape=(5, 6, 7), spacing_mm=(0.3, 0.2, 0.1), dtype="int16", header_bytes=11)
    whole = b"x" * 11 + labels.tobytes()
    for data in (whole, gzip.compress(whole)):
        source, target = io.BytesIO(data), io.BytesIO()
        join(raw.header(source), source, target)
        header, voxels = read(target.getvalue())
        assert (header.format, header.spacing_mm) == ("nrrd", (0.3, 0.2, 0.1))
        np.testing.assert_array_equal(voxels, RANDOM)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "Invalid JSON"),
        ('{"raw": {"shape": [1, 2]}}', "raw.shape"),
        ('{"raw": {"shape": [1, 2, 3], "spacing_mm": [1, 1, 0]}}', "raw.spacing_mm.2"),
        ('{"axes": ["+x", "+x", "+z"]}', "each of x, y and z once"),
        ('{"tissues": {"1": "bone"}}', "'bone'"),
        ('{"tissues": "mine"}', "victre, tomosim"),
        ('{"colour": 1}', "colour"),
    ],
)
def test_a_wrong_reading_is_refused_by_field(text: str, said: str) -> None:
    with pytest.raises(SpecError) as caught:
        Reading.parse(text)
    assert said in str(caught.value)
    assert caught.value.problems
