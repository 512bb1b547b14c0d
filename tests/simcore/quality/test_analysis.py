"""The analysis of a whole case folder, made by hand so that every measure is known."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from simcore import dicom, quality
from simcore.core.artifacts import Compression, Phantom, ProjectionStack, Volume
from simcore.core.errors import SpecError
from simcore.core.geometry import AcquisitionGeometry, Detector
from simcore.core.grid import Grid
from simcore.core.tissues import Tissue
from simcore.dicom import CaseDescription, ExportSpec
from simcore.quality import literature, values
from simcore.quality.analysis import between_plates, full_thickness, shadow
from simcore.quality.skin import skin_line, skin_thickness
from simcore.quality.volume_analysis import VolumeAnalysis, eroded, uniform
from tomosim.cli import main

PIXEL = 0.5
SUPPORT = 20.0
SKIN = 2.0
VALUE = {Tissue.AIR: 0.0, Tissue.ADIPOSE: 0.0456, Tissue.GLAND: 0.0802, Tissue.SKIN: 0.09}


def half_disk(grid: Grid, radius: float) -> np.ndarray:
    """Bool (ny, nx): within ``radius`` of the origin of the plane, mm."""
    return np.hypot(grid.centres("y")[:, None], grid.centres("x")) < radius


def make_phantom(grid: Grid) -> Phantom:
    """A half cylinder of 40 mm radius and 20 mm height: skin of 2 mm, a core of gland of 15 mm, the rest adipose."""
    plane = np.zeros(grid.shape[1:], np.uint8)
    for radius, tissue in ((40.0, Tissue.SKIN), (40.0 - SKIN, Tissue.ADIPOSE), (15.0, Tissue.GLAND)):
        plane[half_disk(grid, radius)] = tissue
    return Phantom(np.broadcast_to(plane, grid.shape).copy(), grid)


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five views of white noise; slices of each tissue's value with a chequerboard of known strength."""
    folder = tmp_path_factory.mktemp("case")
    angles = np.linspace(-20.0, 20.0, 5)
    t = np.deg2rad(angles)
    sources = np.stack([0 * t, 620.0 * np.sin(t), 40.0 + 620.0 * np.cos(t)], axis=1)
    geometry = AcquisitionGeometry(angles, sources, Detector(192, 128, PIXEL), 0 * angles, 40.0, 660.0, SUPPORT)
    random = np.random.default_rng(1)
    frames = np.rint(60000.0 * np.exp(-2.0 + 0.05 * random.standard_normal((5, 192, 128)))).astype(np.uint16)
    frames[0, :3, :4] = 0

    grid = Grid((10, 192, 100), (PIXEL, PIXEL, 2.0), (0.0, -48.0, SUPPORT))
    phantom = make_phantom(grid.moved(z=-SUPPORT))
    table = np.zeros(16)
    for tissue, value in VALUE.items():
        table[tissue] = value
    attenuation = table[phantom.labels] + 0.001 * np.where(np.indices(grid.shape).sum(axis=0) % 2, 1, -1)
    attenuation += 0.01 * grid.centres("z")[:, None, None]  # between the slices, which is no noise
    volume = Volume(np.rint((attenuation + 0.2) / 1e-5).astype(np.uint16), grid, 1e-5, -0.2)

    dicom.export(
        folder,
        ExportSpec(),
        CaseDescription("0" * 64, 1, "0.1.0", 20.0),
        ProjectionStack(frames, 60000.0, geometry),
        volume,
        phantom,
        Compression(np.zeros((4, 3)), (0.0, 20.0), 97.0, "converged"),
    )
    (folder / "geometry.json").write_text(json.dumps(geometry.to_dict()))
    manifest = {
        "specification": {"name": "half cylinder"},
        "software": {"version": "0.1.0"},
        "results": {"thickness_mm": 20.0, "force_N": 97.0},
    }
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return folder


@pytest.fixture(scope="module")
def report(case: Path) -> dict:
    return quality.analyse(case)


def test_tissues_are_told_apart_as_they_were_made(report: dict):
    against = report["volume"]["gland_against_adipose"]
    assert against["difference_per_mm"] == pytest.approx(0.0802 - 0.0456, abs=1e-5)
    assert against["noise_per_mm"] == pytest.approx(0.001, rel=0.02)
    assert against["cnr"] == pytest.approx(34.6, rel=0.02)
    assert report["volume"]["mass_against_adipose"] is None


def test_volumes_and_clipping(report: dict):
    ml = report["volume"]["tissue_ml"]
    assert sum(ml.values()) == pytest.approx(np.pi / 2 * 40**2 * 20 / 1000, rel=1e-3)
    assert ml["gland"] == pytest.approx(np.pi / 2 * 15**2 * 20 / 1000, rel=3e-3)
    assert report["volume"]["clipped"] == {"low": 0.0, "high": 0.0}
    assert report["projections"][0]["clipped_low"] == 12 / (192 * 128)
    assert report["projections"][1]["clipped_low"] == 0.0


def test_skin_line_stands_where_the_skin_is(report: dict):
    skin = report["volume"]["skin_line"]
    assert skin["rows"] > 60
    assert abs(skin["border_mm"]) <= PIXEL
    assert skin["overshoot_per_mm"] == pytest.approx(0.09 - 0.0456, abs=0.003)
    # Within 10 degrees of the x axis a row crosses the skin at its thickness, to a pixel.
    assert skin["thickness_mm"] == pytest.approx(SKIN, abs=PIXEL / 2)


def test_texture_of_white_noise_is_flat_in_every_view(report: dict):
    for view in report["projections"]:
        assert view["rois"] >= 1
        assert view["beta"] == pytest.approx(0.0, abs=0.9)  # few frequencies lie in the band at this pixel size
    assert np.mean([view["beta"] for view in report["projections"]]) == pytest.approx(0.0, abs=0.3)
    assert report["projections"][0]["roi_pixels"] * PIXEL == report["projections"][0]["roi_mm"]


def test_checks_name_what_lies_outside(report: dict):
    stand = {c["quantity"]: c["in_range"] for c in report["checks"]}
    assert stand == {
        "projection beta": False,
        "slice beta": stand["slice beta"],
        "skin thickness": True,
        "glandularity": True,
        "compressed thickness": False,
        "force": True,
    }
    assert literature.checks({})[0]["in_range"] is None


def test_the_report_is_json_and_the_table_is_for_people(report: dict):
    assert json.loads(json.dumps(report, allow_nan=False)) == report
    text = quality.table(report)
    assert "gland against adipose: +0.0346" in text
    assert "force                   97.00 N" in text
    assert max(map(len, text.splitlines())) <= 120


def test_a_folder_that_is_no_case_says_what_is_missing(case: Path, tmp_path: Path):
    with pytest.raises(SpecError, match=r"tomosynthesis\.dcm.*tomosim simulate"):
        quality.analyse(tmp_path)
    for name in ("manifest.json", "geometry.json", "tomosynthesis.dcm", "labels.dcm"):
        (tmp_path / name).symlink_to(case / name)
    with pytest.raises(SpecError, match="0 projections of 5 views"):
        quality.analyse(tmp_path)


def test_the_command_prints_the_table_and_writes_the_report(case: Path, tmp_path: Path, report: dict, capsys):
    copy = tmp_path / "case"
    shutil.copytree(case, copy)
    assert main(["analyse", str(copy)]) == 0
    assert capsys.readouterr().out == quality.table(report) + "\n"
    assert json.loads((copy / "analysis.json").read_text()) == report


def test_the_command_refuses_what_is_no_case(tmp_path: Path, capsys):
    assert main(["analyse", str(tmp_path)]) == 2
    assert "not a case" in capsys.readouterr().err


def test_shadow_of_a_point_is_where_the_ray_meets_the_detector():
    grid = Grid((10, 192, 100), (PIXEL, PIXEL, 2.0), (0.0, -48.0, SUPPORT))
    source = np.array([[0.0, 200.0, 600.0]])
    geometry = AcquisitionGeometry(np.zeros(1), source, Detector(192, 128, PIXEL), np.zeros(1), 40.0, 660.0, SUPPORT)
    mask = np.zeros(grid.shape[1:], bool)
    mask[120:130, 40:50] = True  # x 20..25, y 12..17, at z = 30: seen from the source scaled by 600 / 570
    rows, columns = np.nonzero(shadow(mask, grid, geometry, 0, 30.0))
    scale = 600.0 / 570.0
    assert geometry.detector.x_centres()[columns.min()] == pytest.approx(20 * scale, abs=PIXEL)
    assert geometry.detector.x_centres()[columns.max()] == pytest.approx(25 * scale, abs=PIXEL)
    assert geometry.detector.y_centres()[rows.min()] == pytest.approx(200 - (200 - 12) * scale, abs=PIXEL)
    assert geometry.detector.y_centres()[rows.max()] == pytest.approx(200 - (200 - 17) * scale, abs=PIXEL)


def test_what_rises_beyond_the_plates_at_a_fixed_wall_is_not_the_whole_thickness():
    thickness = np.full((80, 80), 26, np.int32)
    thickness[:, :10] = 54
    grid = Grid((54, 80, 80), (1.0, 1.0, 1.0), (0.0, -40.0, 10.0))
    assert (
        full_thickness(thickness).sum() < full_thickness(between_plates(thickness, grid, {"thickness_mm": 26.0})).sum()
    )
    assert full_thickness(between_plates(thickness, grid, {"thickness_mm": 26.0})).all()
    assert between_plates(thickness, grid, {}) is thickness


def test_full_thickness_gives_way_where_there_is_no_room():
    thickness = np.full((100, 100), 6, np.int32)
    thickness[10:60, 10:60] = 10
    assert full_thickness(thickness).sum() == 2500
    thickness[10:60, 10:60] = 6
    thickness[20, 20] = 10
    assert full_thickness(thickness).all()


def test_only_voxels_well_inside_one_tissue_count():
    grid = Grid((1, 60, 80), (PIXEL, PIXEL, 2.0), (0.0, -15.0, 0.0))
    labels = np.full((60, 80), Tissue.ADIPOSE, np.uint8)
    labels[20:40, 20:50] = Tissue.GLAND
    even = uniform(labels, grid, 1.0).astype(bool)
    assert even[22:38, 22:48].all()
    assert not even[18:22, 20:50].any()
    assert not even[30, 48:52].any()
    assert even[:18].all()
    assert not uniform(np.zeros_like(labels), grid, 1.0).any()


def test_values_at_the_border_of_tissues_do_not_count():
    volume = VolumeAnalysis(Grid((3, 60, 80), (PIXEL, PIXEL, 2.0), (0.0, -15.0, 0.0)), 1.0, 0.0)
    labels = np.full((60, 80), Tissue.ADIPOSE, np.uint8)
    labels[20:40, 20:50] = Tissue.GLAND
    stored = np.where(labels == Tissue.GLAND, 30, 10).astype(np.uint16)
    border = np.zeros(labels.shape, bool)
    border[18:42, 18:52] = True
    border[22:38, 22:48] = False
    stored[border] = 5000
    others = np.full((60, 80), Tissue.SKIN, np.uint8)
    volume.run(iter([(stored, labels), (stored, labels), (stored, labels)]), lambda fraction, message: None)
    assert volume.report()["gland_against_adipose"]["difference_per_mm"] == 20.0
    # A slice of another tissue below: nothing is inside one tissue any more.
    volume = VolumeAnalysis(volume.grid, 1.0, 0.0)
    volume.run(iter([(stored, others), (stored, labels), (stored, labels)]), lambda fraction, message: None)
    assert volume.report()["gland_against_adipose"] is None


def test_the_chest_wall_is_no_border_of_the_texture():
    mask = np.zeros((60, 80), bool)
    mask[10:50, :40] = True
    inner = eroded(mask, Grid((1, 60, 80), (PIXEL, PIXEL, 2.0), (0.0, -15.0, 0.0)), 5.0)
    assert inner[20:40, :30].all()
    assert inner.sum() == 20 * 30


def test_published_ranges_are_the_middle_of_their_distributions():
    assert (literature.RANGES["projection beta"].low, literature.RANGES["projection beta"].high) == (2.71, 3.63)
    assert literature.RANGES["force"].check(49.0)["in_range"]
    assert not literature.RANGES["force"].check(186.1)["in_range"]


def test_skin_of_an_empty_slice_is_not_measured():
    empty = np.zeros((80, 80), np.uint8)
    line = skin_line(empty, empty != 0, PIXEL)
    assert (line.rows, line.border_mm, line.overshoot) == (0, None, None)
    assert skin_thickness(empty, Tissue.SKIN, PIXEL) is None


def test_summary_of_stored_values():
    counts = values.value_counts(np.arange(1, 102, dtype=np.uint16))
    stored = {"min": 1.0, "p1": 2.0, "p50": 51.0, "p99": 100.0, "mean": 51.0, "max": 101.0}
    assert values.summary(counts) == stored
    assert values.summary(counts, 0.5, -1.0)["max"] == 49.5
    assert values.clipped(counts) == {"low": 0.0, "high": 0.0}
    assert values.summary(np.zeros(values.LEVELS, np.int64)) == {}
