"""The sweep's own eyes: what it must see in a result that claims to have converged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.support.bodies import C_CUP, ONE_TISSUE, ellipsoid_labels, scaled_to
from bench.sweep import VOXEL_MM, Subject, disagreement, draw, faults, missing, stands_where_wider, with_gland
from simcore.core.artifacts import Compression, TetMesh
from simcore.core.tissues import Tissue
from simcore.fem import CompressionSpec, compress
from simcore.mesh.structured import half_ellipsoid

SPEC = CompressionSpec(percent=40.0)


@pytest.fixture(scope="module")
def mesh() -> TetMesh:
    return half_ellipsoid(C_CUP, 5)


@pytest.fixture(scope="module")
def result(mesh: TetMesh) -> Compression:
    return compress(mesh, ONE_TISSUE, SPEC)


def test_a_right_result_passes(mesh: TetMesh, result: Compression) -> None:
    assert faults(mesh, SPEC, result) == []
    assert disagreement(Subject("", mesh, ONE_TISSUE), SPEC, result) == []


def test_unbalanced_plates(mesh: TetMesh, result: Compression) -> None:
    wrong = replace(result, report=result.report | {"force_lower_N": 0.99 * result.force_N})
    assert ["plates push" in fault for fault in faults(mesh, SPEC, wrong)] == [True]


def test_absurd_pressure(mesh: TetMesh, result: Compression) -> None:
    wrong = replace(result, report=result.report | {"mean_pressure_kPa": 1e5})
    assert any("1e+05 kPa" in fault for fault in faults(mesh, SPEC, wrong))


def test_a_node_behind_a_plate(mesh: TetMesh, result: Compression) -> None:
    wrong = replace(result, plate_z=(result.plate_z[0], result.plate_z[1] - 0.01))
    assert ["behind a plate" in fault for fault in faults(mesh, SPEC, wrong)] == [True]


def test_an_inverted_element(mesh: TetMesh, result: Compression) -> None:
    displacement = result.displacement.copy()
    inner = np.setdiff1d(mesh.tets, mesh.skin)[0]
    displacement[inner, 0] += 200.0
    assert any("det F" in fault for fault in faults(mesh, SPEC, replace(result, displacement=displacement)))


def test_lost_volume(mesh: TetMesh, result: Compression) -> None:
    squeezed = replace(result, displacement=result.displacement - 0.1 * (mesh.nodes + result.displacement))
    assert any("volume changed" in fault for fault in faults(mesh, SPEC, squeezed))


def test_missing_tissue(mesh: TetMesh, result: Compression) -> None:
    labels = ellipsoid_labels(C_CUP, 2.0)
    assert missing(Subject("whole", mesh, labels), result) == []
    high = mesh.nodes[mesh.tets][:, :, 2].mean(axis=1) > 30.0
    part = replace(mesh, tets=mesh.tets[~high], skin=np.empty((0, 3), np.int64))
    assert "tissue-lost" in missing(Subject("cut", part, labels), result)[0]


def test_another_equilibrium(mesh: TetMesh, result: Compression) -> None:
    other = replace(result, force_N=1.01 * result.force_N)
    assert len(disagreement(Subject("", mesh, ONE_TISSUE), SPEC, other)) == 1


def test_drawn_specifications_differ_and_cover_the_materials() -> None:
    generator = np.random.default_rng(0)
    specs = [draw(generator) for _ in range(150)]
    assert len({spec.model_dump_json() for spec in specs}) > 140
    assert len({spec.material.kind for spec in specs}) >= 6
    assert all(20 <= spec.percent <= 70 for spec in specs)
    ratios = [s.material.poissons_ratio for s in specs if hasattr(s.material, "poissons_ratio")]
    assert min(ratios) < 0.02
    assert 0.49 < max(ratios) <= 0.499
    fields = set().union(*(spec.model_fields_set for spec in specs))
    assert fields >= {"skin", "gravity", "friction", "chest_wall", "paddle_angle_degrees", "spring_paddle"}
    assert fields >= {"elastic_plates", "load_steps"}


def test_a_node_behind_a_plate_is_seen_at_a_fixed_wall_too(mesh: TetMesh) -> None:
    spec = SPEC.with_(chest_wall="fixed")
    result = compress(mesh, ONE_TISSUE, spec)
    assert faults(mesh, spec, result) == []
    wrong = replace(result, plate_z=(result.plate_z[0] + 0.01, result.plate_z[1]))
    assert ["behind a plate" in fault for fault in faults(mesh, spec, wrong)] == [True]


def test_gland_lies_inside() -> None:
    axes = scaled_to(C_CUP, 450.0)
    plain = ellipsoid_labels(axes, 1.5)
    labels = with_gland(plain, axes).labels
    assert plain.labels.sum() * 1.5**3 / 1e3 == pytest.approx(450.0, rel=0.01)
    assert ((labels > 0) == (plain.labels > 0)).all()
    assert (labels == Tissue.GLAND).sum() / (labels > 0).sum() == pytest.approx(0.7**3, rel=0.05)


def test_a_refused_breast_counts_as_buckled_only_where_being_slender_is_the_reason() -> None:
    axes = (80.0, 40.0, 70.0, 60.0)
    narrow = Subject("narrow", half_ellipsoid(axes, 8), with_gland(ellipsoid_labels(axes, VOXEL_MM), axes))
    assert stands_where_wider(narrow, CompressionSpec(percent=60.0))
    assert not stands_where_wider(narrow, CompressionSpec(percent=60.0, force_limit_N=1.0))
    wide = Subject("wide", half_ellipsoid((80.0, 70.0, 60.0, 60.0), 8), narrow.phantom)
    assert not stands_where_wider(wide, CompressionSpec(percent=60.0))


def test_a_wall_that_drifts_is_seen(mesh: TetMesh, result: Compression) -> None:
    moved = result.displacement.copy()
    moved[:, 1] += 0.03
    assert faults(mesh, SPEC, replace(result, displacement=moved)) == ["the chest wall drifts and rolls by 0.03 mm"]
