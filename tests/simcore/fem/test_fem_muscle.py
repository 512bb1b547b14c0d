"""Muscle that holds the breast, as VICTRE does."""

from __future__ import annotations

import numpy as np
import pytest

from bench import percents
from simcore.core.artifacts import Compression, Phantom, TetMesh
from simcore.core.errors import SpecError
from simcore.core.tissues import Tissue
from simcore.fem import CompressionSpec, compress
from simcore.fem.chest_wall import muscle_nodes
from simcore.mesh import build
from simcore.mesh.spec import LatticeMesh
from simcore.presets import get
from simcore.spec import SimulationSpec

SPEC = CompressionSpec(percent=60.0, thickness_mm=50.0, chest_wall="fixed_muscle", plate_edge_mm=10.0)


@pytest.fixture(scope="module")
def sample() -> Phantom:
    return percents.uploaded(percents.CASES / "victre" / "p_1.mhd")


@pytest.fixture(scope="module")
def mesh(sample: Phantom) -> TetMesh:
    return build(sample, LatticeMesh(edge_length_mm=8.0))


@pytest.fixture(scope="module")
def pressed(mesh: TetMesh, sample: Phantom) -> Compression:
    return compress(mesh, sample, SPEC)


def test_the_sample_phantom_of_victre_gets_the_shape_that_victre_gives_it(
    mesh: TetMesh, sample: Phantom, pressed: Compression
) -> None:
    """At 50 mm VICTRE documents a width of 93.6 mm and a depth of 69.0 mm before the muscle."""
    after = mesh.nodes + pressed.displacement
    front_of_muscle = mesh.nodes[muscle_nodes(mesh, sample), 0].max()
    assert pressed.thickness == pytest.approx(50.0)
    assert np.ptp(after[:, 1]) == pytest.approx(93.6, rel=0.015)
    assert after[:, 0].max() - front_of_muscle == pytest.approx(69.0, rel=0.015)


def test_muscle_keeps_its_place_and_its_height(mesh: TetMesh, sample: Phantom, pressed: Compression) -> None:
    muscle = muscle_nodes(mesh, sample)
    assert len(muscle) > 100
    assert (pressed.displacement[muscle] == 0).all()
    assert (pressed.displacement[mesh.wall, 0] == 0).all()
    after = mesh.nodes + pressed.displacement
    assert np.ptp(after[muscle, 2]) > 80
    flat = mesh.nodes[:, 0] > mesh.nodes[muscle, 0].max() + SPEC.plate_edge_mm
    low, high = pressed.plate_z
    assert low - 1e-5 < after[flat, 2].min()
    assert after[flat, 2].max() < high + 1e-5


def test_muscle_nodes_are_those_of_tetrahedra_of_muscle(mesh: TetMesh, sample: Phantom) -> None:
    centres = mesh.nodes[mesh.tets].mean(axis=1)
    x, y, z = np.floor((centres - sample.grid.corner) / sample.grid.spacing).astype(int).T
    by_centre = np.unique(mesh.tets[sample.labels[z, y, x] == Tissue.MUSCLE])
    muscle = muscle_nodes(mesh, sample)
    assert len(np.setxor1d(muscle, by_centre)) < 0.1 * len(muscle)


def test_a_breast_without_muscle_cannot_be_held_by_it(mesh: TetMesh, sample: Phantom) -> None:
    without = Phantom(np.where(sample.labels == Tissue.MUSCLE, Tissue.ADIPOSE, sample.labels), sample.grid)
    with pytest.raises(SpecError, match="has no muscle") as error:
        compress(mesh, without, SPEC)
    assert error.value.code == "no-muscle"


def test_a_grown_phantom_without_muscle_is_refused_by_its_specification() -> None:
    data = get("tiny").model_dump(mode="json")
    data["compression"]["chest_wall"] = "fixed_muscle"
    with pytest.raises(SpecError, match="'anthropomorphic' has no muscle; take 'free_in_plane'"):
        SimulationSpec.from_dict(data)
