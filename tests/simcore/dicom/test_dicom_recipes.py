"""docs/dicom_readers.md: every recipe, with its reader where it is installed, else with the reader's own arithmetic."""

from __future__ import annotations

import gzip
import json
import os
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
import pytest
from numpy.typing import NDArray

from simcore import presets
from simcore.core.geometry import AcquisitionGeometry
from simcore.dicom.geometry import Frames, beam, source_distance
from simcore.projection.acquisition import geometry_of
from tests.support.dicom_case import ALL_EXTRAS, SmallCase, make_case

DOCS = Path(__file__).parents[3] / "docs" / "dicom_readers.md"
VIEWS = [("L", "CC"), ("R", "CC"), ("L", "MLO"), ("R", "MLO")]
TEXT = DOCS.read_text(encoding="utf-8")

needs_simpleitk = pytest.mark.skipif(find_spec("SimpleITK") is None, reason="needs the package SimpleITK")
# Programs of a package stand beside the interpreter, which need not be on the path.
PATH = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
needs_dcmqi = pytest.mark.skipif(shutil.which("segimage2itkimage", path=PATH) is None, reason="needs the package dcmqi")


def recipe(heading: str, language: str = "python") -> str:
    section = TEXT.split(f"## {heading}\n")[1].split("\n## ")[0]
    return re.findall(rf"```{language}\n(.*?)```", section, re.DOTALL)[0]


def run_recipe(heading: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    monkeypatch.chdir(folder)
    names: dict[str, Any] = {}
    exec(compile(recipe(heading), DOCS.name, "exec"), names)
    return names


# --- single views


@pytest.mark.parametrize(("number", "row"), [(1, 0), (4, 1), (8, 2)])
def test_figures_of_single_views(number: int, row: int) -> None:
    lines = [line for line in TEXT.splitlines() if re.match(r"\| \d+ \|", line)]
    said = [float(cell) for cell in lines[row].strip("| ").split("|")]
    geometry = geometry_of(presets.get("ge-senographe-ds").acquisition)
    upright, oblique = Frames(geometry, 0.0), Frames(geometry, 45.0)
    view = number - 1
    ray = beam(upright, view, 50.0)
    actual = [number, geometry.angles[view], ray.length, ray.primary, beam(oblique, view, 50.0).primary]
    assert said == pytest.approx(actual, abs=6e-4)
    assert source_distance(upright, view) == pytest.approx(620.0)
    assert beam(oblique, view, 50.0).length == pytest.approx(ray.length)


# --- pyDBT: sources/backprojectionDD/backprojectionDD.cpp


def pydbt_view(geo: dict[str, float], p: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Its tube (x, y, z) of view p, and the boundaries of its detector: x of the columns; (y, z) of the rows."""
    theta = np.deg2rad(np.linspace(-geo["tubeAngle"] / 2, geo["tubeAngle"] / 2, geo["nProj"])[p])
    phi = np.deg2rad(np.linspace(-geo["detAngle"] / 2, geo["detAngle"] / 2, geo["nProj"])[p])
    tube = np.array([0.0, -(geo["DSD"] - geo["DDR"]) * np.sin(theta), (geo["DSD"] - geo["DDR"]) * np.cos(theta)])
    tube[2] += geo["DDR"]
    x = (np.arange(geo["nu"] + 1) - geo["nu"]) * -geo["du"]
    y = (np.arange(geo["nv"] + 1) - geo["nv"] / 2) * geo["dv"]
    rows = np.stack([y * np.cos(phi) + geo["DDR"] * np.sin(phi), y * np.sin(phi) - geo["DDR"] * np.cos(phi)], axis=1)
    rows[:, 1] += geo["DDR"]
    return tube, x, rows


@pytest.mark.parametrize("turning", [0.0, 0.2])
@pytest.mark.parametrize(("laterality", "view"), VIEWS)
def test_pydbt(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, laterality: str, view: str, turning: float) -> None:
    """Tube, every pixel and every slice stand where they do in the detector frame, to a micrometre."""
    case = make_case(laterality=laterality, view=view, turning=turning)
    case.export(tmp_path / "case")
    names = run_recipe("pyDBT", tmp_path, monkeypatch)
    geo, proj, geometry = names["geo"], names["proj"], case.stack.geometry
    assert (geo["DSD"], geo["DSR"]) == pytest.approx((660.0, 620.0))
    assert (geo["DDR"], geo["DAG"]) == pytest.approx((40.0, 22.0))
    assert (geo["tubeAngle"], geo["detAngle"]) == pytest.approx((40.0, 40.0 * turning))
    for p in range(geo["nProj"]):
        ours = geometry.views - 1 - p
        tube, x, rows = pydbt_view(geo, p)
        np.testing.assert_allclose(tube, geometry.sources[ours], atol=1e-3)
        np.testing.assert_allclose(_corners(x, rows), _pixel_corners(geometry, ours), atol=1e-3)
        np.testing.assert_array_equal(proj[..., p], np.log(60000.0 / case.stack.data[ours])[:, ::-1])
    z = geo["DAG"] + geo["dz"] / 2 + np.arange(geo["nz"]) * geo["dz"]
    # The volume of this case begins 2 mm below the support of its geometry.
    np.testing.assert_allclose(z - z[0], case.volume.grid.centres("z") - case.volume.grid.centres("z")[0])
    assert (geo["ny"], geo["nx"]) == case.volume.grid.shape[1:]


def _corners(x: NDArray[np.float64], rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """(rows + 1, columns + 1, 3): corners of pixels, with the columns in our order."""
    out = np.empty((len(rows), len(x), 3))
    out[..., 0] = x[::-1]
    out[..., 1:] = rows[:, None]
    return out


def _pixel_corners(geometry: AcquisitionGeometry, view: int) -> NDArray[np.float64]:
    origin, along_rows = geometry.detector_frame(view)
    d = geometry.detector
    j, i = np.mgrid[: d.ny + 1, : d.nx + 1]
    down = (j[..., None] - d.ny / 2) * d.pixel * along_rows
    across = i[..., None] * d.pixel * geometry.column_direction(view)
    return np.asarray(origin + down + across)


def test_pydbt_sees_what_was_projected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A bead, back-projected along pyDBT's rays, is brightest in the voxel of the volume that holds it."""
    case = make_case(laterality="R", view="MLO")
    geometry, grid = case.stack.geometry, case.volume.grid
    bead = np.array([15.0, 6.0, 44.0])
    frames = np.full_like(case.stack.data, 60000)
    for v, source in enumerate(geometry.sources):
        foot = source + (bead - source) * source[2] / (source[2] - bead[2])
        frames[v, int(foot[1] / 0.85 + 32), int(foot[0] / 0.85)] = 20000
    spotted = SmallCase(
        case.spec,
        case.case,
        type(case.stack)(frames, 60000.0, geometry),
        case.volume,
        case.phantom,
        case.compression,
    )
    spotted.export(tmp_path / "case")
    names = run_recipe("pyDBT", tmp_path, monkeypatch)
    geo, proj = names["geo"], names["proj"]
    total = np.zeros(grid.shape)
    x, y = grid.centres("x"), grid.centres("y")
    for p in range(geo["nProj"]):
        tube, bounds, _ = pydbt_view(geo, p)
        for k, z in enumerate(geo["DAG"] - 2.0 + geo["dz"] / 2 + np.arange(geo["nz"]) * geo["dz"]):
            scale = tube[2] / (tube[2] - z)
            row = np.floor((tube[1] + (y - tube[1]) * scale) / geo["dv"] + geo["nv"] / 2).astype(int)
            column = np.floor((bounds[0] - x * scale) / geo["du"]).astype(int)
            inside = (row[:, None] >= 0) & (row[:, None] < geo["nv"]) & (column >= 0) & (column < geo["nu"])
            total[k] += np.where(inside, proj[row.clip(0, 63)[:, None], column.clip(0, 47), p], 0.0)
    best = np.argwhere(total == total.max()).mean(axis=0)
    place = (bead - grid.corner) / grid.spacing - 0.5
    assert np.all(np.abs(best[::-1] - place) <= 1.0)


# --- ITK


@needs_simpleitk
@pytest.mark.parametrize("encoding", ["none", "jpeg-ls", "rle"])
@pytest.mark.parametrize(("laterality", "view"), [("L", "CC"), ("R", "MLO")])
def test_simpleitk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, laterality: str, view: str, encoding: str) -> None:
    import SimpleITK as sitk

    case = make_case(laterality=laterality, view=view, encoding=encoding, lesions=True, extras=ALL_EXTRAS)
    case.export(tmp_path / "case")
    names = run_recipe("ITK and SimpleITK", tmp_path, monkeypatch)
    np.testing.assert_array_equal(names["signal"], case.stack.data[0])
    assert np.any(names["inverted"] != case.stack.data[0])
    np.testing.assert_allclose(
        sitk.GetArrayFromImage(names["attenuation"]), case.volume.slope * case.volume.data + case.volume.intercept
    )
    image = names["image"]
    frames = pydicom.dcmread("case/tomosynthesis.dcm", stop_before_pixels=True).PerFrameFunctionalGroupsSequence
    for k, frame in enumerate(frames):
        expected = frame.PlanePositionSequence[0].ImagePositionPatient
        assert image.TransformIndexToPhysicalPoint((0, 0, k)) == pytest.approx([float(c) for c in expected])
    assert image.GetSpacing() == pytest.approx((0.85, 0.9, 5.0))

    def read(name: str) -> Any:
        return sitk.ReadImage(f"case/{name}")

    assert read("projections/0001.dcm").GetSpacing()[:2] == pytest.approx((0.85, 0.85))
    assert read("projections.dcm").GetSpacing() == (1.0, 1.0, 1.0)
    np.testing.assert_array_equal(65535 - sitk.GetArrayFromImage(read("projections.dcm")), case.stack.data)
    shown = sitk.GetArrayFromImage(read("presentation/0001.dcm"))[0]
    np.testing.assert_array_equal(shown, pydicom.dcmread("case/presentation/0001.dcm").pixel_array)
    # 7 frames of 61 x 50 bits end within a byte, of which SimpleITK 2.5 leaves the pixels undefined.
    lesions = sitk.GetArrayFromImage(read("lesions.dcm")).ravel()
    whole = lesions.size // 8 * 8
    np.testing.assert_array_equal(
        lesions[:whole], 255 * pydicom.dcmread("case/lesions.dcm").pixel_array.ravel()[:whole]
    )
    for name in ("labels.dcm", "attenuation.dcm"):
        with pytest.raises(RuntimeError, match="Unable to determine ImageIO reader"):
            read(name)


# --- dcmqi


def read_nrrd(file: Path) -> tuple[NDArray[np.generic], NDArray[np.float64]]:
    """Array (z, y, x) and the position of its first voxel, LPS, mm."""
    head, _, body = file.read_bytes().partition(b"\n\n")
    fields = dict(re.findall(r"^([a-z ]+): (.*)$", head.decode(), re.MULTILINE))
    kinds = {"short": "<i2", "unsigned char": "u1", "unsigned short": "<u2", "float": "<f4", "double": "<f8"}
    sizes = [int(n) for n in fields["sizes"].split()]
    data = gzip.decompress(body) if fields["encoding"] == "gzip" else body
    array = np.frombuffer(data, kinds[fields["type"]]).reshape(sizes[::-1])
    return array, np.array([float(c) for c in fields["space origin"].strip("()").split(",")])


def in_file_order(array: NDArray[np.generic], origin: NDArray[np.float64], file: Path) -> NDArray[np.generic]:
    """dcmqi orders slices so that the axes are right-handed."""
    frames = pydicom.dcmread(file, stop_before_pixels=True).PerFrameFunctionalGroupsSequence
    first = np.array(frames[0].PlanePositionSequence[0].ImagePositionPatient, float)
    return array if np.allclose(first, origin) else array[::-1]


@needs_dcmqi
@pytest.mark.parametrize(("laterality", "view"), VIEWS)
def test_dcmqi(tmp_path: Path, laterality: str, view: str) -> None:
    case = make_case(laterality=laterality, view=view, lesions=True, extras=["attenuation", "report"])
    case.export(tmp_path / "case")
    (tmp_path / "out").mkdir()
    subprocess.run(
        ["sh", "-ec", recipe("dcmqi and 3D Slicer", "sh")],
        cwd=tmp_path,
        check=True,
        capture_output=True,
        env={**os.environ, "PATH": PATH},
    )
    tissue = in_file_order(*read_nrrd(tmp_path / "out/tissue-1.nrrd"), tmp_path / "case/labels.dcm")
    np.testing.assert_array_equal(tissue, pydicom.dcmread(tmp_path / "case/labels.dcm").pixel_array)
    mu = in_file_order(*read_nrrd(tmp_path / "out/attenuation-pmap.nrrd"), tmp_path / "case/attenuation.dcm")
    np.testing.assert_allclose(mu, pydicom.dcmread(tmp_path / "case/attenuation.dcm").pixel_array)
    segments = pydicom.dcmread(tmp_path / "case/lesions.dcm").SegmentSequence
    sizes = [np.count_nonzero(read_nrrd(tmp_path / f"out/lesion-{n + 1}.nrrd")[0]) for n in range(len(segments))]
    pixels = pydicom.dcmread(tmp_path / "case/lesions.dcm")
    numbers = [
        f.SegmentIdentificationSequence[0].ReferencedSegmentNumber for f in pixels.PerFrameFunctionalGroupsSequence
    ]
    counts = np.bincount(numbers, np.count_nonzero(pixels.pixel_array, axis=(1, 2)))[1:]
    assert sizes == counts.tolist()
    report = json.loads((tmp_path / "out/report.json").read_text())
    assert [m["measurementItems"][0]["value"] for m in report["Measurements"]] != []
    assert [m["ReferencedSegment"] for m in report["Measurements"]] == [1, 2, 3]
