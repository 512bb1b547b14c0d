"""JPEG-LS and RLE give back every pixel; frames are found by the offset table; writing holds a few frames at most."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pydicom
import pytest
from pydantic import ValidationError
from pydicom.encaps import get_frame
from pydicom.pixels import pixel_array

from simcore.core.errors import ExportError
from simcore.dicom import ExportSpec
from simcore.dicom.common import Instance, item, set_pixels
from simcore.dicom.common import write as write_to
from simcore.dicom.pixels import MadeFrames
from simcore.dicom.run_length import run_length_frame
from tests.support.dicom_case import ALL_EXTRAS, SmallCase, make_case

SYNTAXES = {"jpeg-ls": pydicom.uid.JPEGLSLossless, "rle": pydicom.uid.RLELossless}


def write(path, *content):
    with open(path, "wb") as file:
        write_to(file, *content)


@pytest.fixture(scope="module")
def plain(exported: Callable[[SmallCase], Path]) -> Path:
    return exported(make_case(views=2, extras=["presentation", "synthetic-2d", "ct"], lesions=True))


@pytest.mark.parametrize("encoding", SYNTAXES)
def test_every_image_has_the_same_pixels(exported: Callable[[SmallCase], Path], plain: Path, encoding: str) -> None:
    folder = exported(
        make_case(views=2, extras=["presentation", "synthetic-2d", "ct"], lesions=True, encoding=encoding)
    )
    encoded = 0
    for file in sorted(plain.rglob("*.dcm")):
        other = folder / file.relative_to(plain)
        np.testing.assert_array_equal(pixel_array(other), pixel_array(file), err_msg=file.name)
        d = pydicom.dcmread(other)
        if d.Modality != "SEG":
            assert d.file_meta.TransferSyntaxUID == SYNTAXES[encoding]
            assert d.LossyImageCompression == "00"
            encoded += 1
    assert encoded == 2 + 1 + 1 + 2 + 1 + 9


@pytest.mark.parametrize("encoding", SYNTAXES)
def test_a_frame_is_found_by_its_offset(
    exported: Callable[[SmallCase], Path], small_case: SmallCase, encoding: str
) -> None:
    d = pydicom.dcmread(exported(make_case(encoding=encoding)) / "tomosynthesis.dcm")
    assert pydicom.encaps.parse_basic_offsets(d.PixelData)[0] == 0
    assert len(pydicom.encaps.parse_basic_offsets(d.PixelData)) == 9
    frames = list(pydicom.encaps.generate_frames(d.PixelData, number_of_frames=9))
    assert get_frame(d.PixelData, 7, number_of_frames=9) == frames[7]
    np.testing.assert_array_equal(pixel_array(d, index=7), small_case.volume.data[7])


@pytest.mark.parametrize("encoding", SYNTAXES)
@pytest.mark.parametrize("bits", [10, 12, 14, 16])
def test_extreme_values_of_all_depths(tmp_path: Path, encoding: str, bits: int) -> None:
    """Noise over the whole range, and the two ends."""
    frames = np.random.default_rng(bits).integers(0, 2**bits, (3, 17, 31)).astype(np.uint16)
    frames[1] = 0
    frames[2] = 2**bits - 1
    instance = set_pixels(_bare(), frames, bits)
    write(tmp_path / "image.dcm", instance, make_case().case, encoding)
    np.testing.assert_array_equal(pixel_array(tmp_path / "image.dcm"), frames)


@pytest.mark.parametrize("columns", [1, 2, 127, 128, 129, 300])
def test_run_lengths_of_two_bytes(columns: int) -> None:
    frame = np.random.default_rng(columns).integers(0, 3, (5, columns)).astype(np.uint16) * 257
    frame[1] = 40000
    decoded = pydicom.pixels.decoders.rle._rle_decode_frame(run_length_frame(frame), 5, columns, 1, 16, ">")
    np.testing.assert_array_equal(np.frombuffer(decoded, "<u2").reshape(5, columns), frame)


def test_two_runs_of_an_encoded_case_give_the_same_bytes(exported: Callable[[SmallCase], Path]) -> None:
    """With every object on request."""
    arguments = {"encoding": "jpeg-ls", "views": 2, "lesions": True, "extras": ALL_EXTRAS}
    first, second = (exported(make_case(**arguments)) for _ in range(2))  # type: ignore[arg-type]
    for file in (f for f in first.rglob("*.*") if f.is_file()):
        assert file.read_bytes() == (second / file.relative_to(first)).read_bytes()


@pytest.mark.parametrize("encoding", ["none", *SYNTAXES])
def test_writing_holds_a_few_frames_at_most(tmp_path: Path, encoding: str) -> None:
    """64 frames of 0.5 MB: 32 MB are written, a small part of it is held."""
    frame = np.random.default_rng(1).integers(0, 2**14, (512, 512)).astype(np.uint16)
    instance = set_pixels(_bare(frames=64), MadeFrames(64, lambda k: frame + np.uint16(k)), 16)
    write(tmp_path / "once.dcm", set_pixels(_bare(frames=1), frame[None], 16), make_case().case, encoding)  # compiles
    tracemalloc.start()
    try:
        write(tmp_path / "image.dcm", instance, make_case().case, encoding)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 16 * frame.nbytes
    np.testing.assert_array_equal(pixel_array(tmp_path / "image.dcm", index=63), frame + 63)


def _bare(frames: int = 3) -> pydicom.Dataset:
    return item(
        SOPClassUID=pydicom.uid.BreastTomosynthesisImageStorage,
        SOPInstanceUID="2.25.1",
        NumberOfFrames=frames,
        PhotometricInterpretation="MONOCHROME2",
    )


def test_what_cannot_be_written_is_refused(tmp_path: Path) -> None:
    large = MadeFrames(5000, lambda _: np.zeros((1000, 1000), np.uint16))
    with pytest.raises(ExportError, match="10000000000 bytes"):
        write(tmp_path / "large.dcm", set_pixels(_bare(), large, 16), make_case().case, "none")
    signed = MadeFrames(1, lambda _: np.zeros((4, 4), np.int16))
    with pytest.raises(ExportError, match="int16"):
        write(tmp_path / "signed.dcm", Instance(_bare(), signed), make_case().case, "none")
    with pytest.raises(ValidationError, match="encoding"):
        ExportSpec.model_validate({"encoding": "jpeg2000"})
    with pytest.raises(ValidationError, match="each may stand once"):
        ExportSpec.model_validate({"extra_objects": ["ct", "ct"]})
