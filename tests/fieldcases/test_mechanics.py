"""Bodies of the field under compression: nothing of them is lost."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from simcore import fem, mesh, phantom, warp
from simcore.core.artifacts import Phantom, TetMesh
from simcore.core.tissues import Tissue
from simcore.fem.spec import CompressionSpec
from simcore.mesh.spec import LatticeMesh
from simcore.phantom.upload import registry
from simcore.store.store import Store

HERE = Path(__file__).parent


def uploaded(folder: Path, file: Path) -> Phantom:
    store = Store(folder / "store")
    upload = registry.add_file(store, file)
    with registry.open_file(store, upload.spec) as opened:
        return phantom.load(upload.spec, opened)


def compressed(breast: Phantom, tets: TetMesh, spec: CompressionSpec) -> Phantom:
    return warp.deform(breast, tets, fem.compress(tets, breast, spec), warp.WarpSpec())


@pytest.fixture(scope="module")
def p_1(tmp_path_factory: pytest.TempPathFactory) -> tuple[Phantom, TetMesh]:
    breast = uploaded(tmp_path_factory.mktemp("p_1"), HERE / "victre" / "p_1.mhd")
    return breast, mesh.build(breast, LatticeMesh())


@pytest.fixture(scope="module")
def calcifications(tmp_path_factory: pytest.TempPathFactory) -> tuple[Phantom, TetMesh]:
    folder = tmp_path_factory.mktemp("calcifications")
    (folder / "files").mkdir()
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(sys, "path", [str(HERE / "uploads"), *sys.path])
        runpy.run_path(str(HERE / "uploads" / "single_voxel_calcifications.py"))
    breast = uploaded(folder, folder / "files" / "calcs.nrrd")
    return breast, mesh.build(breast, LatticeMesh())


@pytest.mark.parametrize("percent", [44.0, 70.0])
def test_victres_phantom_keeps_its_volume_with_a_fixed_wall(p_1: tuple[Phantom, TetMesh], percent: float) -> None:
    """It was 217.8 and 157.1 ml."""
    report = compressed(*p_1, CompressionSpec(percent=percent, chest_wall="fixed")).report
    assert report["volume_before_ml"] == pytest.approx(257.6, abs=0.1)
    assert report["volume_after_ml"] == pytest.approx(257.6, rel=0.015)
    assert report["volume_after_ml"] == pytest.approx(report["mesh_volume_ml"], rel=0.001)
    for name in ("adipose", "gland", "skin", "muscle", "ligament"):
        assert report["tissue_after_ml"][name] == pytest.approx(report["tissue_expected_ml"][name], rel=0.005)


@pytest.mark.parametrize("percent", [40.0, 60.0])
def test_no_calcification_of_one_voxel_is_lost(calcifications: tuple[Phantom, TetMesh], percent: float) -> None:
    """They were 93 and 57 of 137."""
    out = compressed(*calcifications, CompressionSpec(percent=percent))
    mask = out.labels == Tissue.CALCIFICATION
    assert ndimage.label(mask, np.ones((3, 3, 3)))[1] == 137
    assert np.count_nonzero(mask) == 137
    assert out.report["lesion_objects"]["calcification"]["after"] == 137
