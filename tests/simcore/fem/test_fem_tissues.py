"""Laws that differ from tissue to tissue."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from simcore.core.artifacts import Phantom, TetMesh
from simcore.core.errors import SolverError
from simcore.core.grid import Grid
from simcore.core.tissues import Tissue
from simcore.fem import CompressionSpec, compress
from simcore.fem.laws.by_tissue import FALLBACK, ByTissue
from simcore.fem.laws.linear_elastic import LinearElastic
from simcore.fem.laws.mooney_rivlin import MooneyRivlin
from simcore.fem.laws.neo_hookean import NeoHookean
from simcore.fem.laws.of_elements import ElementLaws
from simcore.fem.laws.published import Published, published_laws
from simcore.fem.tissues import _sample_points, element_laws, tissue_fractions
from simcore.mesh.structured import box, half_ellipsoid

SOFT, STIFF = NeoHookean(youngs_modulus_kPa=10.0), NeoHookean(youngs_modulus_kPa=40.0)


def phantom_of(labels: np.ndarray, spacing: tuple[float, float, float], corner: tuple[float, float, float]) -> Phantom:
    return Phantom(np.ascontiguousarray(labels, np.uint8), Grid(labels.shape, spacing, corner))


def layered(mesh_cells: tuple[int, int, int]) -> tuple[TetMesh, Phantom]:
    """30 x 40 x 20 mm, gland below y = 0."""
    labels = np.full((20, 40, 30), Tissue.ADIPOSE)
    labels[:, :20] = Tissue.GLAND
    return box((30.0, 40.0, 20.0), mesh_cells), phantom_of(labels, (1.0, 1.0, 1.0), (0.0, -20.0, -10.0))


def test_sample_points_are_spread_evenly() -> None:
    points = _sample_points(2)
    assert points.shape == (64, 4)
    assert points.sum(axis=1) == pytest.approx(np.ones(64))
    assert (points > 0).all()
    assert points.mean(axis=0) == pytest.approx(np.full(4, 0.25))
    # A quadrature: exact for linear functions, and within its resolution for the volume of a half.
    assert len(np.unique(np.round(points, 9), axis=0)) == 64
    # x_0 has the density 3 (1 - x)^2 in a tetrahedron: mean of squares 1/10.
    assert (points[:, 0] ** 2).mean() == pytest.approx(0.1, rel=0.05)


def test_fractions_of_a_border_that_meshes_follow_or_cut() -> None:
    for cells in ((3, 4, 2), (3, 5, 2)):
        mesh, phantom = layered(cells)
        shares = tissue_fractions(mesh, phantom)
        assert shares.sum(axis=1) == pytest.approx(np.ones(len(mesh.tets)))
        volume = np.abs(np.linalg.det(mesh.nodes[mesh.tets[:, 1:]] - mesh.nodes[mesh.tets[:, :1]])) / 6
        assert volume @ shares[:, Tissue.GLAND] == pytest.approx(12000, rel=0.01)
        mixed = (shares[:, Tissue.GLAND] > 0) & (shares[:, Tissue.GLAND] < 1)
        assert mixed.any() == (cells[1] == 5)


def test_air_counts_only_where_there_is_nothing_else() -> None:
    mesh = box((10.0, 10.0, 10.0), (1, 1, 1))
    labels = np.full((10, 10, 10), Tissue.ADIPOSE)
    labels[:5] = Tissue.AIR
    shares = tissue_fractions(mesh, phantom_of(labels, (1.0, 1.0, 1.0), (0.0, -5.0, -5.0)))
    assert shares[:, Tissue.ADIPOSE] == pytest.approx(np.ones(6))
    outside = tissue_fractions(mesh, phantom_of(labels, (1.0, 1.0, 1.0), (100.0, 0.0, 0.0)))
    assert outside[:, Tissue.AIR] == pytest.approx(np.ones(6))


def test_one_law_for_all_tissues_is_the_homogeneous_breast() -> None:
    mesh, phantom = layered((3, 4, 2))
    for law in (SOFT, MooneyRivlin.example()):
        alone = compress(mesh, phantom, CompressionSpec(percent=30.0, material=law))
        split = compress(mesh, phantom, CompressionSpec(percent=30.0, material=ByTissue(adipose=law, gland=law)))
        assert split.displacement.tobytes() == alone.displacement.tobytes()


def test_layers_side_by_side_share_the_force() -> None:
    """Two bars between the plates in uniaxial stress, stretched sideways alike. Nodes on their border average two
    pressures, an error that falls with the mesh width."""
    errors = []
    for fineness in (1, 2):
        mesh, phantom = layered((3 * fineness, 4 * fineness, 2 * fineness))
        spec = CompressionSpec(percent=40.0, tolerance=1e-8)
        soft, stiff = (compress(mesh, phantom, spec.with_(material=law)).force_N for law in (SOFT, STIFF))
        both = compress(mesh, phantom, spec.with_(material=ByTissue(adipose=SOFT, gland=STIFF)))
        errors.append(both.force_N / ((soft + stiff) / 2) - 1)
    assert abs(errors[0]) < 5e-3
    assert abs(errors[1]) < 0.6 * abs(errors[0])


def test_mixture_in_an_element_is_the_sum_of_energies() -> None:
    """A mesh that cannot follow the border: Voigt's mean of the neo-Hookean moduli."""
    mesh = box((10.0, 10.0, 10.0), (1, 1, 1))
    labels = np.full((8, 8, 8), Tissue.ADIPOSE)
    labels[:, :, ::2] = Tissue.GLAND
    phantom = phantom_of(labels, (1.25, 1.25, 1.25), (0.0, -5.0, -5.0))
    laws = element_laws(mesh, phantom, ByTissue(adipose=SOFT, gland=STIFF))
    share = tissue_fractions(mesh, phantom)[:, Tissue.GLAND]
    assert laws.shear == pytest.approx((SOFT.law().shear * (1 - share) + STIFF.law().shear * share) * 1e-3)
    assert laws.neo_hookean
    # The general kernel takes other laws in the same proportions.
    general = element_laws(mesh, phantom, ByTissue(adipose=SOFT, gland=LinearElastic(youngs_modulus_kPa=40.0)))
    assert not general.neo_hookean
    assert general.fractions[:, 1] == pytest.approx(share)
    assert general.shear == pytest.approx(laws.shear)


def test_a_stiff_lesion_is_compressed_less() -> None:
    mesh = half_ellipsoid((40.0, 30.0, 25.0, 25.0), 6)
    z, y, x = np.meshgrid(np.arange(-25, 25) + 0.5, np.arange(-30, 30) + 0.5, np.arange(40) + 0.5, indexing="ij")
    labels = np.where((x - 18) ** 2 + y**2 + z**2 < 100, Tissue.MASS, Tissue.ADIPOSE)
    phantom = phantom_of(labels, (1.0, 1.0, 1.0), (0.0, -30.0, -25.0))
    spec = CompressionSpec(percent=30.0, material=ByTissue(adipose=SOFT, gland=SOFT))
    plain = compress(mesh, phantom, spec)
    lesion = compress(
        mesh,
        phantom,
        spec.with_(material=ByTissue(adipose=SOFT, gland=SOFT, mass=NeoHookean(youngs_modulus_kPa=200.0))),
    )
    near = np.linalg.norm(mesh.nodes - [18, 0, 0], axis=1) < 8
    squeeze = [np.polyfit(mesh.nodes[near, 2], r.displacement[near, 2], 1)[0] for r in (plain, lesion)]
    assert squeeze[0] < -0.2
    assert 0 < squeeze[1] / squeeze[0] < 0.3
    assert lesion.force_N > 1.05 * plain.force_N


def test_every_label_finds_a_law() -> None:
    laws = ByTissue(adipose=SOFT, gland=STIFF).laws()
    assert set(laws) == set(Tissue)
    assert laws[Tissue.SKIN] == laws[Tissue.LIGAMENT] == laws[Tissue.AIR] == SOFT.law()
    assert laws[Tissue.MASS] == laws[Tissue.NIPPLE] == laws[Tissue.CALCIFICATION] == STIFF.law()
    assert set(FALLBACK) == set(Tissue) - {Tissue.ADIPOSE}


def test_published_sets_are_what_the_specification_offers() -> None:
    sets = published_laws()
    assert set(sets) == set(get_args(Published.model_fields["source"].annotation))
    for name in sets:
        assert set(Published(source=name).laws()) == set(Tissue)
    assert Published(source="wellman-1999").laws()[Tissue.GLAND].shear == pytest.approx(15.1 / 2 / 1.499)
    assert Published(source="victre").laws()[Tissue.CALCIFICATION].shear == pytest.approx(20 / 2 / 1.49)
    assert Published(source="aspiration").laws()[Tissue.GLAND].shear == pytest.approx(3.04 / 2 / 1.475)


def test_small_strain_does_not_mix_with_large() -> None:
    mesh, phantom = layered((1, 2, 1))
    material = ByTissue(adipose=SOFT, gland=LinearElastic(strain="small"))
    with pytest.raises(SolverError, match="cannot be mixed") as error:
        compress(mesh, phantom, CompressionSpec(material=material))
    assert error.value.code == "mixed-strains"
    assert ElementLaws.homogeneous(SOFT.law(), 3).fractions.shape == (3, 1)


def test_labels_that_are_no_tissue_are_refused() -> None:
    mesh = box((10.0, 10.0, 10.0), (1, 1, 1))
    with pytest.raises(ValueError, match="label 200 is no tissue"):
        tissue_fractions(mesh, phantom_of(np.full((2, 2, 2), 200), (5.0, 5.0, 5.0), (0.0, -5.0, -5.0)))
