"""Odd bodies and lesions as people upload them: each runs, or is refused by name (README of the field cases)."""

from __future__ import annotations

import csv
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from simcore import estimate, pipeline
from simcore.core.errors import MeshError, SolverError, SpecError
from simcore.mesh.spec import LatticeMesh
from simcore.phantom.upload import registry
from simcore.phantom.upload.reading import Reading
from simcore.presets import get
from simcore.projection.spec import DetectorSpec
from simcore.store.store import Store

SCRIPTS = Path(__file__).with_name("uploads")

RUN = (
    "spicule", "hole_through", "tunnel", "detached_small", "detached_calc_beside", "pepper", "salt", "nipple_off",
    "thin_breast", "aniso", "aniso_04_04_2", "muscle", "calc1", "tumour", "two_touching",
)  # fmt: skip
NO_BREAST = ("two_touching", "tunnel", "spicule", "pepper")
"""Bodies that may also fail by name: no breast has such a shape."""
DROPPED = {
    "detached_small": "left out: 1 piece beside the breast, 0.064 ml in all",
    "detached_calc_beside": "left out: 1 piece beside the breast, 0.064 ml in all",
    "salt": "pieces beside the breast, 0.",
}
REFUSED = {
    "detached_big": ("upload-in-pieces", "falls into 2 pieces of 226, 60 ml"),
    "all_air": ("invalid-upload", "nothing but air"),
    "one_slice_x": ("upload-mismatch", "1 voxel along x"),
    "one_slice_y": ("upload-mismatch", "1 voxel along y"),
    "one_slice_z": ("upload-mismatch", "1 voxel along z"),
    "one_slice_z5": ("upload-mismatch", "1 voxel along z"),
    "one_voxel": ("upload-mismatch", "1 voxel along x and 1 voxel along y and 1 voxel along z"),
    "flipped_x": ("upload-mismatch", "turn x, and y with it so that the breast is not mirrored: axes = +z,-y,-x"),
}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("uploads")
    (folder / "files/r19").mkdir(parents=True)
    for script in ("odd_bodies.py", "two_masses.py", "single_voxel_calcifications.py"):
        subprocess.run([sys.executable, SCRIPTS / script], cwd=folder, check=True)
    return folder / "files"


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    return Store(tmp_path_factory.mktemp("store"), min_free_bytes=0)


@cache
def reading() -> Reading:
    return Reading(confirm_size=True, confirm_tissues=True)


def run(store: Store, upload: registry.Upload) -> pipeline.CaseResult:
    tiny = get("tiny")
    detector = DetectorSpec(pixels_x=110, pixels_y=210, pixel_mm=1.6)
    spec = tiny.with_(
        phantom=upload.spec,
        mesh=LatticeMesh(edge_length_mm=14.0),
        acquisition=tiny.acquisition.with_(detector=detector, views=3),
        reconstruction=tiny.reconstruction.with_(slice_mm=4.0),
    )
    estimate.check(spec)
    return pipeline.run(spec, store)


@pytest.mark.parametrize("name", RUN)
def test_an_odd_body_runs_or_fails_by_name(name: str, files: Path, store: Store) -> None:
    upload = registry.add_file(store, files / "r19" / f"{name}.nrrd", reading())
    assert DROPPED.get(name, "") in " ".join(upload.remarks)
    assert name in DROPPED or "left out" not in " ".join(upload.remarks)
    try:
        results: dict[str, Any] = run(store, upload).manifest["results"]
    except (MeshError, SolverError):
        if name not in NO_BREAST:
            raise
        return
    before, after = (sum(results[f"tissue_{when}_ml"].values()) for when in ("before", "after"))
    assert after == pytest.approx(before, rel=0.02)
    assert results["volume_ml"] == pytest.approx(before)
    assert results["force_N"] > 0


@pytest.mark.parametrize("name", sorted(REFUSED))
def test_what_is_no_breast_is_refused_when_it_is_added(name: str, files: Path, store: Store) -> None:
    code, words = REFUSED[name]
    with pytest.raises(SpecError) as refused:
        registry.add_file(store, files / "r19" / f"{name}.nrrd", reading())
    assert refused.value.code == code
    assert words in str(refused.value)


def test_every_file_has_an_answer(files: Path) -> None:
    assert {p.stem for p in (files / "r19").glob("*.nrrd")} == {*RUN, *REFUSED}


def test_two_masses_and_two_calcifications_have_four_boxes(files: Path, store: Store, tmp_path: Path) -> None:
    upload = registry.add_file(store, files / "twomass.nrrd", reading())
    assert upload.remarks == ("lesions: 2 masses, 2 single calcifications",)
    case = run(store, upload)
    case.write(tmp_path)
    (table,) = tmp_path.rglob("truth.csv")
    rows = list(csv.DictReader(table.open()))
    boxes = sorted((int(row["Width"]), int(row["Height"])) for row in rows)
    assert len(boxes) == 4
    for width, height in boxes[2:]:  # masses of 8 mm, pixels of 1.6 mm
        assert 4 <= width <= 8
        assert 4 <= height <= 8
    for width, height in boxes[:2]:  # of 2 mm
        assert width <= 4
        assert height <= 4


def test_each_of_137_calcifications_of_one_voxel_has_a_row(files: Path, store: Store, tmp_path: Path) -> None:
    upload = registry.add_file(store, files / "calcs.nrrd", reading())
    assert upload.remarks == ("lesions: 137 single calcifications",)
    case = run(store, upload)
    assert case.manifest["results"]["tissue_after_ml"]["calcification"] == pytest.approx(0.137, rel=0.1)
    case.write(tmp_path)
    (table,) = tmp_path.rglob("truth.csv")
    assert len(list(csv.DictReader(table.open()))) == 137
