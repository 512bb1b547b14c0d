"""An independent toolkit reads the files: dcmtk decodes the labels to the same bytes and dumps every object."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pydicom
import pytest

from .conftest import make_case

pytestmark = pytest.mark.needs_dcmtk


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    if not shutil.which("dcmdrle"):
        pytest.skip("needs the Debian package dcmtk")
    folder = tmp_path_factory.mktemp("case")
    return {name: folder / name for name in make_case().export(folder)}


def test_run_length_encoded_labels_are_decoded_to_the_same_pixels(files: dict[str, Path], tmp_path: Path) -> None:
    plain = tmp_path / "plain.dcm"
    subprocess.run(["dcmdrle", str(files["labels.dcm"]), str(plain)], check=True)
    decoded = pydicom.dcmread(plain)
    assert decoded.file_meta.TransferSyntaxUID == pydicom.uid.ExplicitVRLittleEndian
    assert np.array_equal(decoded.pixel_array, pydicom.dcmread(files["labels.dcm"]).pixel_array)


def test_every_object_is_read_without_complaint(files: dict[str, Path]) -> None:
    for name, path in files.items():
        if path.suffix != ".dcm":
            continue
        dump = subprocess.run(["dcmdump", "-q", "+L", str(path)], capture_output=True, text=True, check=True)
        assert "PixelData" in dump.stdout, name
        assert dump.stderr == "", name
