"""Volumes with the plates of their compression (VICTRE's label 50): thickness, frames, and what does not fit."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from simcore import estimate, phantom, pipeline
from simcore.core.artifacts import Phantom
from simcore.core.errors import SpecError
from simcore.core.tissues import Tissue
from simcore.phantom.upload import registry
from simcore.phantom.upload.reading import Reading
from simcore.phantom.upload.spec import UploadedPhantom
from simcore.presets import get
from simcore.store.store import Store
from tests.support.plates import LOWER, UPPER, compressed, nrrd


def load(labels: NDArray[np.uint8], **fields: object) -> Phantom:
    spec = UploadedPhantom(sha256=64 * "0", shape=labels.shape, spacing_mm=(2.0, 2.0, 2.0), **fields)
    return phantom.load(spec, io.BytesIO(nrrd(labels)))


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "store", min_free_bytes=0)


def added(store: Store, tmp_path: Path, labels: NDArray[np.uint8], **reading: object) -> registry.Upload:
    path = tmp_path / "pc_1.nrrd"
    path.write_bytes(nrrd(labels))
    return registry.add_file(store, path, Reading(**reading))


def test_the_inner_planes_are_the_plates_and_the_flange_is_cut() -> None:
    labels = compressed()
    loaded = load(labels, compressed=True)
    assert loaded.grid.corner[0] == loaded.grid.corner[2] == 0.0
    assert loaded.grid.upper[2] == 50.0
    np.testing.assert_array_equal(loaded.labels == Tissue.MUSCLE, labels[LOWER:UPPER, 3:57, :39] == 40)
    np.testing.assert_array_equal(loaded.labels == Tissue.GLAND, labels[LOWER:UPPER, 3:57, :39] == 29)
    flange = np.count_nonzero(labels == 40) - np.count_nonzero(labels[LOWER:UPPER] == 40)
    assert loaded.report["left_out_ml"] == {"muscle": pytest.approx(flange * 0.008)}
    assert loaded.report["plates_mm"] == 50.0
    plates = phantom.plates(UploadedPhantom.example().with_(compressed=True), loaded)
    assert plates.thickness == 50.0


def test_what_is_left_between_the_plates_must_begin_with_a_flat_wall() -> None:
    labels = compressed()
    labels[LOWER:UPPER, :, :12] = 0
    labels[25:30, 20:30, 11] = 1  # the flange above and below would do
    with pytest.raises(SpecError, match=r"tissue that is kept covers 50 voxels of the first plane across x"):
        load(labels, compressed=True)


@pytest.mark.parametrize("axes", [("-z", "+y", "+x"), ("+z", "-y", "+x")])
def test_the_plates_are_found_whichever_way_z_leads(axes: tuple[str, str, str]) -> None:
    labels = compressed()
    turned = labels[::-1] if axes[0] == "-z" else labels[:, ::-1]
    loaded = load(np.ascontiguousarray(turned), axes=axes, compressed=True)
    np.testing.assert_array_equal(loaded.labels, load(labels, compressed=True).labels)


def test_air_between_a_plate_and_the_tissue_stays() -> None:
    labels = compressed()
    labels[LOWER : LOWER + 3] = 0
    labels[LOWER - 2 : LOWER, :, 5:] = 50
    loaded = load(labels, compressed=True)
    assert loaded.grid.upper[2] == 50.0
    assert not loaded.labels[:3].any()
    assert loaded.labels[3].any()


def test_a_file_with_plates_is_compressed(store: Store, tmp_path: Path) -> None:
    labels = compressed()
    for refuse in (lambda: load(labels), lambda: added(store, tmp_path, labels)):
        with pytest.raises(SpecError, match=r"compressed = False: .*compressed = true.*--compressed"):
            refuse()
    assert registry.uploads(store) == []
    upload = added(store, tmp_path, labels, compressed=True)
    assert (upload.spec.thickness_mm, upload.spec.extent_mm[2]) == (50.0, 50.0)
    assert any("50 mm apart" in remark for remark in upload.remarks)
    assert any("ml of tissue above and below the plates are cut off" in remark for remark in upload.remarks)
    with pytest.raises(SpecError, match="compressed = False"):
        registry.require(store, upload.spec.with_(compressed=False, thickness_mm=None))
    with pytest.raises(SpecError, match=r"thickness_mm = 60\.0: the plates in the file are 50 mm apart"):
        registry.require(store, upload.spec.with_(thickness_mm=60.0))
    with pytest.raises(SpecError, match=r"thickness_mm = 60\.0: the plates in the file are 50 mm apart"):
        load(labels, compressed=True, thickness_mm=60.0)


def test_plates_that_are_mapped_to_air_do_not_count() -> None:
    own = {"0": "air", "1": "adipose", "2": "skin", "29": "gland", "40": "muscle", "50": "air"}
    loaded = load(compressed(), tissues=own)
    assert "plates_mm" not in loaded.report
    assert loaded.labels.shape[0] == 45 + 2
    named = load(compressed(), tissues={**own, "50": "paddle"}, compressed=True)
    np.testing.assert_array_equal(named.labels, load(compressed(), compressed=True).labels)


def test_plates_across_another_axis_are_refused_with_axes_that_do() -> None:
    with pytest.raises(SpecError, match=r"lie across y, not across z.*permute the axes") as refused:
        load(compressed(), axes=("+y", "+z", "+x"), compressed=True)
    axes = str(refused.value).rpartition(" ")[2].split(",")
    assert load(compressed(), axes=tuple(axes), compressed=True).grid.upper[2] == 50.0


def test_a_single_plate_and_plates_that_are_none(store: Store, tmp_path: Path) -> None:
    labels = compressed()
    labels[:LOWER] = 0
    upload = added(store, tmp_path, labels, compressed=True)
    assert upload.spec.thickness_mm == 50.0
    assert any("has one plate" in remark for remark in upload.remarks)
    strewn = compressed()
    strewn[np.random.default_rng(1).random(strewn.shape) < 0.2] = 50
    with pytest.raises(SpecError, match="not two flat plates"):
        added(store, tmp_path, strewn, compressed=True)
    empty = compressed()
    empty[LOWER:UPPER] = 0
    with pytest.raises(SpecError, match="no tissue lies between"):
        added(store, tmp_path, empty, compressed=True, confirm_tissues=True)


def test_the_plates_reach_dicom(store: Store, tmp_path: Path) -> None:
    import pydicom

    upload = added(store, tmp_path, compressed(), compressed=True)
    tiny = get("tiny")
    spec = tiny.with_(phantom=upload.spec, compression=type(tiny.compression)(), mesh=type(tiny.mesh)())
    estimate.check(spec)
    case = pipeline.run(spec, store)
    assert case.manifest["results"]["thickness_mm"] == 50.0
    case.write(tmp_path / "out")
    files = [pydicom.dcmread(p) for p in sorted((tmp_path / "out").rglob("*.dcm"))]
    thicknesses = {float(d.BodyPartThickness) for d in files if "BodyPartThickness" in d}
    assert thicknesses == {50.0}
