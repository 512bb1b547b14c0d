"""The VTK file, read back by meshio, against what is known of a block."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
import pytest

from simcore.core.artifacts import Compression, Phantom, TetMesh
from simcore.core.grid import Grid
from simcore.core.tissues import Tissue
from simcore.fem import CompressionSpec, compress, write_vtu
from simcore.fem.laws.linear_elastic import LinearElastic
from simcore.fem.laws.neo_hookean import NeoHookean
from simcore.mesh.structured import box

BLOCK = (30.0, 40.0, 20.0)


@pytest.fixture(scope="module")
def mesh() -> TetMesh:
    return box(BLOCK, (3, 4, 4), jitter=0.2, generator=np.random.default_rng(5))


@pytest.fixture(scope="module")
def phantom() -> Phantom:
    """Gland above z = 0, adipose tissue below, 1 mm voxels."""
    labels = np.full((20, 40, 30), Tissue.ADIPOSE, dtype=np.uint8)
    labels[10:] = Tissue.GLAND
    return Phantom(labels, Grid((20, 40, 30), (1.0, 1.0, 1.0), (0.0, -20.0, -10.0)))


@pytest.mark.parametrize("material", [NeoHookean(), LinearElastic(strain="hencky")])
def test_stress_and_strain_of_a_block_in_uniaxial_stress(
    tmp_path: Path, mesh: TetMesh, phantom: Phantom, material: NeoHookean | LinearElastic
) -> None:
    result = compress(mesh, phantom, CompressionSpec(percent=40.0, material=material, tolerance=1e-9))
    write_vtu(tmp_path / "mesh.vtu", mesh, result, phantom, material)
    read = meshio.read(tmp_path / "mesh.vtu")
    assert read.points == pytest.approx(mesh.nodes)
    (cells,) = read.cells
    assert cells.type == "tetra"
    assert (cells.data == mesh.tets).all()
    assert read.point_data["displacement_mm"] == pytest.approx(result.displacement, abs=1e-5)

    wide = 1 + result.displacement[:, 0].max() / BLOCK[0]
    fields = {name: values[0] for name, values in read.cell_data.items()}
    assert fields["J"] == pytest.approx(np.full(len(mesh.tets), 0.6 * wide**2), rel=1e-5)
    strain = np.diag([(wide**2 - 1) / 2, (wide**2 - 1) / 2, (0.36 - 1) / 2])
    assert np.abs(fields["green_lagrange_strain"].reshape(-1, 3, 3) - strain).max() < 1e-5
    # True stress: the plate force over the area that the block has taken.
    stress = -1e3 * result.force_N / (BLOCK[0] * BLOCK[1] * wide**2)
    assert np.abs(fields["cauchy_stress_kPa"].reshape(-1, 3, 3) - np.diag([0, 0, stress])).max() < 1e-4 * abs(stress)
    assert fields["von_mises_stress_kPa"] == pytest.approx(np.full(len(mesh.tets), -stress), rel=1e-4)
    assert read.point_data["pressure_kPa"] == pytest.approx(np.full(len(mesh.nodes), -stress / 3), rel=1e-3)


def test_small_strain_stress_is_hookes_law(tmp_path: Path, mesh: TetMesh, phantom: Phantom) -> None:
    material = LinearElastic(strain="small", youngs_modulus_kPa=50.0, poissons_ratio=0.4)
    gradient = np.array([[0.01, 0.02, 0.0], [0.0, -0.03, 0.01], [0.005, 0.0, 0.02]])
    moved = Compression(mesh.nodes @ gradient.T, (-10.0, 10.0), 0.0, "converged")
    write_vtu(tmp_path / "mesh.vtu", mesh, moved, phantom, material)
    strain = (gradient + gradient.T) / 2
    lame = 50 * 0.4 / (1.4 * 0.2)
    stress = lame * np.trace(strain) * np.eye(3) + 50 / 1.4 * strain
    written = meshio.read(tmp_path / "mesh.vtu").cell_data["cauchy_stress_kPa"][0].reshape(-1, 3, 3)
    assert np.abs(written - stress).max() < 1e-4 * np.abs(stress).max()


def test_stress_and_strain_of_a_general_gradient(tmp_path: Path, mesh: TetMesh, phantom: Phantom) -> None:
    material = NeoHookean()
    gradient = np.array([[0.2, 0.1, -0.05], [0.08, -0.25, 0.1], [0.03, 0.06, 0.15]])
    moved = Compression(mesh.nodes @ gradient.T, (-10.0, 10.0), 0.0, "converged")
    write_vtu(tmp_path / "mesh.vtu", mesh, moved, phantom, material)
    fields = meshio.read(tmp_path / "mesh.vtu").cell_data
    F = np.eye(3) + gradient
    J, left = np.linalg.det(F), F @ F.T
    law = material.law()
    stress = law.shear * J ** (-5 / 3) * (left - np.trace(left) / 3 * np.eye(3)) + law.bulk / 2 * (J - 1 / J) * np.eye(
        3
    )
    written = fields["cauchy_stress_kPa"][0].reshape(-1, 3, 3)
    assert np.abs(written - stress).max() < 1e-5 * np.abs(stress).max()
    strain = (F.T @ F - np.eye(3)) / 2
    assert np.abs(fields["green_lagrange_strain"][0].reshape(-1, 3, 3) - strain).max() < 1e-5


def test_tissues(tmp_path: Path, mesh: TetMesh, phantom: Phantom) -> None:
    still = Compression(np.zeros(mesh.nodes.shape), (-10.0, 10.0), 0.0, "converged")
    write_vtu(tmp_path / "mesh.vtu", mesh, still, phantom)
    fields = {name: values[0] for name, values in meshio.read(tmp_path / "mesh.vtu").cell_data.items()}
    assert {name for name in fields if name.startswith("fraction_")} == {"fraction_adipose", "fraction_gland"}
    assert fields["fraction_adipose"] + fields["fraction_gland"] == pytest.approx(np.ones(len(mesh.tets)))
    height = mesh.nodes[mesh.tets, 2]
    assert (fields["tissue"][height.min(axis=1) >= 0] == Tissue.GLAND).all()
    assert (fields["tissue"][height.max(axis=1) <= 0] == Tissue.ADIPOSE).all()
    assert "cauchy_stress_kPa" not in fields


def test_without_a_phantom_there_is_no_tissue(tmp_path: Path, mesh: TetMesh) -> None:
    still = Compression(np.zeros(mesh.nodes.shape), (-10.0, 10.0), 0.0, "converged")
    write_vtu(tmp_path / "mesh.vtu", mesh, still)
    assert set(meshio.read(tmp_path / "mesh.vtu").cell_data) == {"J", "green_lagrange_strain"}
