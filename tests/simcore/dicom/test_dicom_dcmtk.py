"""An independent toolkit reads the files: dcmtk dumps every object and converts frames to the same pixels."""

import subprocess
from pathlib import Path

import numpy as np
import pydicom
import pytest
from pydicom.pixels import pixel_array

from tests.support.dicom_case import ALL_EXTRAS, make_case
from tests.support.services import need

pytestmark = pytest.mark.needs_dcmtk

DECODERS = {"rle": "dcmdrle", "jpeg-ls": "dcmdjpls"}


def export(folder: Path, encoding: str = "none") -> dict[str, Path]:
    need("dcmdrle", "dcmtk")
    names = make_case(views=2, lesions=True, encoding=encoding, extras=ALL_EXTRAS).export(folder)
    return {name: folder / name for name in names if name.endswith(".dcm")}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return export(tmp_path_factory.mktemp("case"))


def run(*command: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([str(c) for c in command], check=True, capture_output=True, text=True)


@pytest.mark.parametrize("encoding", DECODERS)
def test_encoded_frames_are_decoded_to_the_same_pixels(files: dict[str, Path], tmp_path: Path, encoding: str) -> None:
    encoded = export(tmp_path / "case", encoding)
    decoded = 0
    for name, path in encoded.items():
        syntax = pydicom.dcmread(path, stop_before_pixels=True).file_meta.TransferSyntaxUID
        if syntax not in (pydicom.uid.RLELossless, pydicom.uid.JPEGLSLossless):
            continue
        tool = "dcmdrle" if syntax == pydicom.uid.RLELossless else "dcmdjpls"
        run(tool, path, tmp_path / "plain.dcm")
        plain = pydicom.dcmread(tmp_path / "plain.dcm")
        assert plain.file_meta.TransferSyntaxUID == pydicom.uid.ExplicitVRLittleEndian
        np.testing.assert_array_equal(plain.pixel_array, pixel_array(files[name]), err_msg=name)
        decoded += 1
    assert decoded == 2 + 1 + 1 + 1 + 2 + 1 + 9


def test_every_object_is_read_without_complaint(files: dict[str, Path]) -> None:
    for name, path in files.items():
        dump = run("dcmdump", "-q", "+L", path)
        assert dump.stderr == "", name
        kind = {"attenuation.dcm": "FloatPixelData", "report.dcm": "ContentSequence"}.get(name, "PixelData")
        assert kind in dump.stdout, name


def test_the_report_is_rendered(files: dict[str, Path]) -> None:
    page = run("dsr2html", files["report.dcm"]).stdout
    assert "Imaging Measurement Report" in page
    assert "512" in page
    assert "Calcification of breast" in page


def pnm(path: Path) -> np.ndarray:
    """An ASCII grey map."""
    words = [w for line in path.read_text().splitlines() if not line.startswith("#") for w in line.split()]
    assert words[0] == "P2"
    columns, rows = int(words[1]), int(words[2])
    return np.array(words[4:], dtype=np.int64).reshape(rows, columns)


def test_frames_of_the_volume_become_pictures(files: dict[str, Path], tmp_path: Path) -> None:
    """Without a window a picture holds the stored values, of the whole range of 16 bits."""
    run("dcm2pnm", "+opw", "+Fa", "+Fn", files["tomosynthesis.dcm"], tmp_path / "slice")
    expected = pixel_array(files["tomosynthesis.dcm"])
    pictures = sorted(tmp_path.glob("slice*"), key=lambda p: int("".join(filter(str.isdigit, p.name))))
    assert len(pictures) == 9
    for picture, frame in zip(pictures, expected, strict=True):
        np.testing.assert_array_equal(pnm(picture), frame)


def test_the_window_of_a_view_is_applied_as_meant(files: dict[str, Path], tmp_path: Path) -> None:
    path = files["presentation/0001.dcm"]
    run("dcm2pnm", "+opb", "+Wi", "1", path, tmp_path / "view.pgm")
    d = pydicom.dcmread(path)
    centre, width = float(d.WindowCenter), float(d.WindowWidth)
    # PS3.3 C.11.2.1.2.1
    shown = np.clip(((d.pixel_array - (centre - 0.5)) / (width - 1) + 0.5) * 255, 0, 255)
    assert np.abs(pnm(tmp_path / "view.pgm") - shown).max() <= 1.0


def test_the_projections_are_shown_bright_where_dense(files: dict[str, Path], tmp_path: Path) -> None:
    """MONOCHROME1: the raw signal is turned over for display (dcmtk rounds by its own way)."""
    path = files["projections/0001.dcm"]
    run("dcm2pnm", "+opw", path, tmp_path / "raw.pgm")
    np.testing.assert_allclose(pnm(tmp_path / "raw.pgm"), 65535 - pixel_array(path).astype(np.int64), atol=1)
