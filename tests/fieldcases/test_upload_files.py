"""Files as people of this field have them, each added as they would: read right, or refused with the right reason.

The scripts in ``uploads`` write them; the tables name every file that they write.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simcore import phantom
from simcore.core.errors import SpecError
from simcore.phantom.upload import registry
from simcore.phantom.upload.reading import Reading
from simcore.store.store import Store

SCRIPTS = Path(__file__).with_name("uploads")
FOLDERS = ("odd", "r10", "r14", "r17", "r19")

BREAST = {"0": 42842, "1": 17686, "2": 3478, "29": 7142}
OURS = ["+z", "+y", "+x"]
NO_HEADER = r"it is no NRRD, MetaImage or NIfTI file; raw voxels need a header beside them .*--header header\.json"


@dataclass(frozen=True)
class Read:
    """A file that is read: its values, voxel edges in mm, and what is said of it."""

    values: dict[str, int] = field(default_factory=lambda: BREAST)
    edge: float = 2.0
    said: str = ""
    reading: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Refused:
    """A file that is refused: what the message says; and with which ``reading`` it is read after all."""

    said: str
    cure: dict[str, Any] = field(default_factory=dict)


BESIDE = r"voxels are read from "
LIST = r"a list of slices: one file is needed\. Join them, in Python with SimpleITK\.WriteImage"
NAMES = {
    "77%.raw": Refused(NO_HEADER),
    "BestDiast 77 %.zraw": Refused(NO_HEADER),
    "a.txt": Refused(NO_HEADER),
    "abs.mhd": Read(said=BESIDE + "'plain.raw', where its header says '/nonexistent/plain.raw'"),
    "ascii.nhdr": Refused("NRRD encoding = 'ascii': save it as raw, gzip or bzip2"),
    "byteskip-1.nhdr": Read(),
    "byteskip-1.nrrd": Read(),
    "byteskip100.nhdr": Read(),
    "case.mhd": Read(said=BESIDE + "'plain.raw', where its header says 'Plain.RAW'"),
    "compsize.mhd": Read(),
    "dotslash.nhdr": Read(),
    "gz.nhdr": Read(),
    "gzbeside.mhd": Read(said=BESIDE + "'gzbeside.raw.gz', where its header says 'gzbeside.raw'"),
    "gzbeside.raw.gz": Refused("a gzip file that is no NRRD, MetaImage or NIfTI: raw voxels need a header"),
    "hdr.raw": Refused(NO_HEADER),
    "hdrsize.mhd": Read(),
    "hdrsize_1.mhd": Read(),
    "hex.nhdr": Refused("NRRD encoding = 'hex': save it as raw, gzip or bzip2"),
    "last1.nrrd": Read(),
    "last1_dir.nrrd": Read(),
    "lead1.nrrd": Read(),
    "lead1_spacings.nrrd": Read(),
    "lead2.nrrd": Refused(r"2 layers of a volume; one label a voxel is needed\. 3D Slicer writes layers .* label map"),
    "lines.raw": Refused(NO_HEADER),
    "lineskip1.nrrd": Read(),
    "lineskip3.nhdr": Read(),
    "lineskip3_b.nhdr": Read(),
    "list.mhd": Refused(LIST),
    "list.nhdr": Refused(LIST),
    "pattern.mhd": Refused(r"'slice%03d\.raw 1 60 1' as the file of its voxels, " + LIST),
    "pct.nhdr": Refused(r"'slice%03d\.raw 1 60 1' as the file of its voxels, " + LIST),
    "percent.mhd": Read(),
    "percent_space.mhd": Read(),
    "plain.mhd": Read(),
    "plain.nhdr": Read(),
    "plain.raw": Refused(NO_HEADER),
    "skip.raw": Refused(NO_HEADER),
    "space.mhd": Read(),
    "space.nhdr": Read(),
    "subdir.mhd": Read(said=BESIDE + "'plain.raw', where its header says 'sub/plain.raw'"),
    "two words.raw": Refused(NO_HEADER),
    "winpath.mhd": Read(said=BESIDE + "'plain.raw', where its header says "),
    "z.zraw": Refused(NO_HEADER),
}

NO_WHOLE = (
    r"no whole number within 1e-06: save the labels as whole numbers and without a slope, in Python "
    r"image = nibabel\.load\(FILE\); nibabel\.save.*\.astype\('uint16'\)"
)
CONTRADICTS = r"NIfTI pixdim says voxels of 2 x 2 x 2 mm, sform 1 x 1 x 1 mm: give .*spacing_mm \(--spacing-mm"
PAIR = r"one of two files \(\.hdr and \.img\): save them as one \.nii or \.nrrd file"
LPS = {"axes": OURS}  # SimpleITK writes its own axes, x to the left, where the array has none
GIVEN = r"axes: \+z,\+y,\+x as given, not \+z,-x,\+y as in the file"
NUMBERS = {
    **{f"nii_{name}.nii.gz": Read() for name in ["u8", "i8", "i16", "u16", "i32", "u32", "f32", "f64", "i64", "u64"]},
    **{f"nii_{name}.nii": Read() for name in ["slope1", "nanslope", "slope_half", "slope_tenth", "inter"]},
    "nii_fdata_u16.nii.gz": Refused(r"scl_slope = 0\.00044251.* turn the stored 4520 into 2\.000152\d+, .*" + NO_WHOLE),
    "nii_fdata_u8.nii.gz": Refused(r"scl_slope = 0\.11372549.* into 2\.047058\d+, .*" + NO_WHOLE),
    "nifti2.nii": Read(),
    "bigendian.nii": Read(),
    "gzip_as.nii": Read(),
    "nii_4d1.nii.gz": Read(),
    "nii_4d2.nii.gz": Refused(r"2 layers of a volume; .* save one of them \(in Python volume\[\.\.\., 0\]\)"),
    "pair.hdr": Refused(PAIR),
    "pair.img": Refused(PAIR),
    "sform1_pixdim2.nii": Refused(CONTRADICTS, cure={"spacing_mm": [2.0, 2.0, 2.0]}),
    "eye.nii": Refused(CONTRADICTS, cure={"spacing_mm": [2.0, 2.0, 2.0], "axes": OURS}),
    "noaffine.nii": Read(edge=1.0),
    "both.nii": Read(),
    "both_differ.nii": Refused(r"sform leads its axes along \+z,\+y,\+x, qform along \+z,\+x,-y", cure={"axes": OURS}),
    **{f"pynrrd_{name}.nrrd": Read() for name in ("i64", "f32", "f64", "u64")},
    **{f"sitk_{name}.{suffix}": Read() for name in ("i64", "f32", "f64", "u8") for suffix in ("mha", "nrrd")},
    **{f"sitk_{name}.nii.gz": Read(said=GIVEN, reading=LPS) for name in ("i64", "f32", "f64", "u8")},
    **{f"sitk_{name}": Read() for name in ("u8c.mha", "u8c.mhd", "u8.nhdr")},
    "sitk_u8.raw": Refused(NO_HEADER),
    "sitk_u8c.zraw": Refused(NO_HEADER),
}


def _tilted(degrees: float) -> Refused:
    return Refused(rf"tilted by {degrees} degrees, of which 2\.5 are taken: .*axes \(--axes", cure={"axes": OURS})


def _taken(degrees: float) -> Read:
    return Read(said=rf"its axes are tilted by {degrees} degrees .*axes: \+z,\+y,\+x as given", reading={"axes": OURS})


TILTED = {
    "tilt3.nii.gz": _tilted(3.5),
    "tilt_1.nii.gz": _taken(1.0),
    "tilt_2.nii.gz": _taken(2.0),
    "tilt_2.5.nii.gz": _taken(2.5),
    "tilt_2.6.nii.gz": _tilted(2.6),
    "tilt_3.nii.gz": _tilted(3.0),
    "sheared.nii.gz": Refused(r"sheared: 84\.3 degrees between two of them, not 90", cure={"axes": OURS}),
    "bigendian16.nii": Read(said=r"axes: \+z,\+y,\+x as given, not \+z,\+x,-y as in the file", reading={"axes": OURS}),
}

MM = {"spacing_mm": [2.0, 2.0, 2.0]}
CUT = "its packed voxels are cut short; fetch it again"
NO_EDGE = r"no voxel size: give spacing_mm \(--spacing-mm A,B,C"
CONVERT = "open it in 3D Slicer or ITK-SNAP and save the labels"
ODD = {
    **{
        f"{n}.nrrd": Read()
        for n in ["be16", "be32", "le16", "gz_members", "gz_trailing", "bz2", "GZIP", "crlf", "left_handed", "spacedim"]
    },
    **{f"{n}.mha": Read() for n in ["plain", "be16", "size_only", "rai", "zlib", "gzip_in_zlib", "mm_units"]},
    **{f"units_{unit}.nrrd": Read() for unit in ("cm", "um", "m")},
    "units_mm.nrrd": Refused(
        r"the tissue is 0\.226 ml \(28306 voxels of 0\.2 x 0\.2 x 0\.2 mm\); a breast has from 20 ml to 5 l\. The same "
        r"numbers would make 226 ml in cm and less than 0\.001 ml in um: .*--confirm-size, confirm_size = true",
        cure=MM,
    ),
    "two.nrrd.gz": Read(),
    "plain.mha.gz": Read(),
    "space3d.nrrd": Read(said="'3D-right-handed', which says nothing of the patient"),
    "scanner.nrrd": Read(said="'scanner-xyz', which says nothing of the patient"),
    "gz_cut.nrrd": Refused(CUT),
    "gz_no_crc.nrrd": Refused(CUT),
    "gz_badcrc.nrrd": Refused("cannot be unpacked .*incorrect data check; fetch it again"),
    "deflate_raw.mha": Refused("cannot be unpacked .*incorrect header check; fetch it again, or save it again"),
    "zst.nrrd": Refused("NRRD encoding = 'zstd': save it as raw, gzip or bzip2"),
    "no_spacing.nrrd": Refused(NO_EDGE, cure=MM),
    "nan_spacing.nrrd": Refused(NO_EDGE, cure=MM),
    "nospacing.mha": Refused(NO_EDGE, cure=MM),
    "zero_spacing.nrrd": Refused(
        "spacings: voxel edges of 0 x 2 x 2 mm; all must be above 0: give spacing_mm", cure=MM
    ),
    "neg_spacing.nrrd": Refused("edges of -2 x 2 x 2 mm; all must be above 0: .* the other way axes", cure=MM),
    "tiny_spacing.nrrd": Refused(r"0\.002 mm; from 0\.01 to 10 mm \(are they in m or cm\?\): give spacing_mm", cure=MM),
    "spacing2.mha": Refused("ElementSpacing = '2 2': three are needed; give spacing_mm", cure=MM),
    "commas.mha": Refused(r"ElementSpacing = '2,0' is no number \(such as 0\.2, with a point\)", cure=MM),
    "tilt.mha": _tilted(3.0),
    "rgb.nrrd": Refused(r"3 layers of a volume; .*a colour image \(RGB\) is no label map"),
    "channels.mha": Refused("ElementNumberOfChannels = 3: 1; one label a voxel is needed"),
    "ascii.mha": Refused("BinaryData = False: save it in binary form"),
    "cut_raw.nrrd": Refused("it ends after 71143 of the 71148 bytes of 44 x 49 x 33 voxels: fetch or save it again"),
    "long_raw.nrrd": Refused(
        r"it holds more than the 71148 bytes of 44 x 49 x 33 voxels: correct their number, their type \(uint8\) or"
    ),
    "neg.nrrd": Refused("names no tissue for (255|-1)"),  # as NumPy promotes -1; odd_labels writes it for sure
    "big_label.nrrd": Refused("names no tissue for (112|70000)"),
    "empty.nrrd": Refused("it is empty"),
    "text.nrrd": Refused(NO_HEADER),
    "dicom.dcm": Refused("but a DICOM file: " + CONVERT),
    "array.npy": Refused(r"but a NumPy array: numpy\.load\(FILE\)\.astype\('uint16'\)\.tofile"),
    "x.tif": Refused("but a TIFF picture: " + CONVERT),
    "lfs.nrrd": Refused("a pointer of Git LFS, not the file itself: 'git lfs pull' fetches it"),
    "mat.h5": Refused("but an HDF5 file .*: " + CONVERT),
}

FATTY = {"tissues": {"0": "air", "1": "adipose", "2": "gland"}}
LABELS = {
    "big_label.nrrd": Refused("names no tissue for 70000, and none can: labels are whole numbers from 0 to 65535"),
    "neg.nrrd": Refused(r"names no tissue for -1, and none can: labels are whole numbers from 0 to 65535; give those"),
    "neg8.nrrd": Refused(r"names no tissue for -6, and none can \(saved as int8, 250 becomes -6\)"),
    "labels012.nrrd": Read({"0": 42842, "1": 17686 + 3478, "2": 7142}, reading=FATTY),
    "calc_everywhere.nrrd": Read(
        {"0": 42842, "1": 17686, "2": 3478, "250": 7142},
        reading={"tissues": {"0": "air", "1": "adipose", "2": "skin", "250": "gland"}},
    ),
}

CASES = [
    *(("names_skips_four_axes", f"r10/{name}", case) for name, case in NAMES.items()),
    *(("number_types", f"r14/{name}", case) for name, case in NUMBERS.items()),
    *(("tilted", f"r17/{name}", case) for name, case in TILTED.items()),
    *(("odd_files", f"odd/{name}", case) for name, case in ODD.items()),
    *(("odd_labels", f"odd/{name}", case) for name, case in LABELS.items()),
]


class Written:
    """The files of the scripts, each run once."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.store = Store(root / "store", min_free_bytes=0)

    def by(self, script: str) -> Path:
        folder = self.root / script
        if not folder.exists():
            for name in FOLDERS:
                (folder / "files" / name).mkdir(parents=True)
            environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
            subprocess.run([sys.executable, SCRIPTS / f"{script}.py"], cwd=folder, env=environment, check=True)
        return folder / "files"

    def add(self, path: Path, reading: dict[str, Any]) -> registry.Upload:
        return registry.add_file(self.store, path, Reading.parse(json.dumps(reading)))

    def labels(self, upload: registry.Upload) -> np.ndarray:
        with registry.open_file(self.store, upload.spec) as file:
            return phantom.load(upload.spec, file).labels


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    return Written(tmp_path_factory.mktemp("uploads"))


@pytest.fixture(scope="module")
def breast(written: Written) -> np.ndarray:
    """The breast that all of the scripts write, as it is loaded from plain raw voxels."""
    voxels = written.by("names_skips_four_axes") / "r10" / "plain.raw"
    upload = written.add(voxels, {"raw": {"shape": [44, 49, 33], "spacing_mm": [2.0, 2.0, 2.0]}})
    assert upload.values == BREAST
    return written.labels(upload)


def check_read(written: Written, breast: np.ndarray, path: Path, case: Read) -> None:
    upload = written.add(path, case.reading)
    assert upload.values == case.values
    assert upload.spec.spacing_mm == (case.edge,) * 3
    if case.said:
        assert re.search(case.said, "; ".join(upload.remarks)), upload.remarks
    else:
        assert not [r for r in upload.remarks if re.search("tilted|read from|as given|patient", r)]
    if case.values == BREAST:
        np.testing.assert_array_equal(written.labels(upload), breast)


@pytest.mark.parametrize(("script", "name", "case"), CASES, ids=[f"{script}-{name}" for script, name, _ in CASES])
def test_a_file_is_read_right_or_refused_by_name(
    script: str, name: str, case: Read | Refused, written: Written, breast: np.ndarray
) -> None:
    path = written.by(script) / name
    if isinstance(case, Read):
        check_read(written, breast, path, case)
        return
    with pytest.raises(SpecError) as caught:
        written.add(path, {})
    assert re.search(case.said, str(caught.value)), str(caught.value)
    if case.cure:
        check_read(written, breast, path, Read(said="as given", reading=case.cure))


@pytest.mark.parametrize("script", sorted({script for script, _, _ in CASES}))
def test_every_file_of_a_script_has_an_answer(script: str, written: Written) -> None:
    files = written.by(script)
    names = {str(path.relative_to(files)) for path in files.rglob("*") if path.is_file()}
    assert names == {name for of, name, _ in CASES if of == script}


def test_openvct_is_told_how_to_unpack_and_read_with_a_map_of_its_own(written: Written) -> None:
    files = written.by("openvct_layout")
    assert {path.name for path in files.iterdir() if path.is_file()} == {
        "Phantom.zip", "Phantom.dat", "Phantom.json", "Phantom.map.json"
    }  # fmt: skip
    with pytest.raises(SpecError) as caught:
        written.add(files / "Phantom.zip", {})
    assert re.search(
        r"a zip archive: it holds Phantom\.dat, Phantom\.xml, as OpenVCT's phantoms do\. Unpack it .*Phantom\.xml says "
        r"them.*tomosim phantom add Phantom\.dat --header header\.json --tissue-map",
        str(caught.value),
    )
    for name in ("Phantom.dat", "Phantom.json", "Phantom.map.json"):
        with pytest.raises(SpecError, match=NO_HEADER):
            written.add(files / name, {})
    header = json.loads((files / "Phantom.json").read_text())
    tissues = json.loads((files / "Phantom.map.json").read_text())
    upload = written.add(files / "Phantom.dat", {"raw": header, "tissues": tissues})
    voxels = np.fromfile(files / "Phantom.dat", np.uint8)
    assert upload.values == {str(v): int(n) for v, n in zip(*np.unique(voxels, return_counts=True), strict=True)}
    assert upload.spec.extent_mm == (60.0, 90.0, 80.0)


def test_the_line_that_saves_an_array_of_numpy_does_as_it_stands(
    written: Written, breast: np.ndarray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    voxels = np.load(written.by("odd_files") / "odd" / "array.npy")
    path = tmp_path / "array.npy"
    np.save(path, np.asfortranarray(voxels.astype("f8")))
    with pytest.raises(SpecError) as caught:
        written.add(path, {})
    said = re.search(r"but a NumPy array: (.*) in Python, .* --header header\.json with (\{.*\})$", str(caught.value))
    assert said, str(caught.value)
    monkeypatch.chdir(tmp_path)
    eval(said[1], {"numpy": np, "FILE": path})
    header = {
        **json.loads(said[2].replace("[slices, rows, columns]", str(list(voxels.shape)))),
        "spacing_mm": [2, 2, 2],
    }
    upload = written.add(tmp_path / "labels.raw", {"raw": header})
    np.testing.assert_array_equal(written.labels(upload), breast)
