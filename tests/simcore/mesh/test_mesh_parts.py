"""The parts of the mesh stage that need no mesher."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from simcore.core.artifacts import Phantom
from simcore.core.errors import MeshError
from simcore.core.grid import Grid
from simcore.mesh.cleaning import compacted, largest_body, oriented, snapped_to_wall, wall_and_skin
from simcore.mesh.occupancy import block_occupancy
from simcore.mesh.ordering import cache_order
from simcore.mesh.quality import boundary_faces, dihedral_angles, quality_report, radius_ratios, volumes
from simcore.mesh.structured import box, half_ellipsoid
from simcore.mesh.surface import enclosed_volume, outline

SEMI_AXES = (30.0, 22.0, 24.0, 18.0)


def ellipsoid_phantom(voxel: float = 1.0, air_behind: int = 0) -> Phantom:
    """Labels of a half ellipsoid with SEMI_AXES; ``air_behind``: voxel layers with x < 0."""
    a, b, upper, lower = SEMI_AXES
    nz, ny, nx = (int(2 * 30 / voxel), int(2 * 26 / voxel), int(34 / voxel) + air_behind)
    grid = Grid((nz, ny, nx), (voxel,) * 3, (-air_behind * voxel, -ny * voxel / 2, -nz * voxel / 2))
    x, y = grid.centres("x")[None, None, :], grid.centres("y")[None, :, None]
    z = grid.centres("z")[:, None, None]
    inside = (x / a) ** 2 + (y / b) ** 2 + (z / np.where(z > 0, upper, lower)) ** 2 <= 1
    return Phantom((inside & (x > 0)).astype(np.uint8), grid)


def test_regular_tetrahedron_is_best() -> None:
    nodes = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    tets = oriented(nodes, np.array([[0, 1, 2, 3]]))
    assert volumes(nodes, tets) == pytest.approx([8 / 3])
    assert radius_ratios(nodes, tets) == pytest.approx([1.0])
    assert dihedral_angles(nodes, tets) == pytest.approx(np.full((1, 6), np.degrees(np.arccos(1 / 3))))


def test_corner_tetrahedron_by_hand() -> None:
    nodes = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    tets = np.array([[0, 1, 2, 3]])
    inradius, circumradius = 1 / (3 + np.sqrt(3)), np.sqrt(3) / 2
    assert radius_ratios(nodes, tets) == pytest.approx([3 * inradius / circumradius])
    angles = np.sort(dihedral_angles(nodes, tets)[0])
    assert angles == pytest.approx([np.degrees(np.arccos(1 / np.sqrt(3)))] * 3 + [90.0] * 3)


def test_box_and_its_boundary() -> None:
    mesh = box((3.0, 4.0, 5.0), (3, 2, 4), jitter=0.2, generator=np.random.default_rng(1))
    faces = boundary_faces(mesh.tets)
    assert len(mesh.tets) == 6 * 24
    assert volumes(mesh.nodes, mesh.tets).min() > 0
    assert volumes(mesh.nodes, mesh.tets).sum() == pytest.approx(60.0)
    assert enclosed_volume(mesh.nodes, faces.astype(np.int32)) == pytest.approx(60.0)
    assert len(faces) == 2 * 2 * (3 * 2 + 2 * 4 + 3 * 4)
    assert len(mesh.wall) == 3 * 5
    assert not (mesh.nodes[mesh.skin][:, :, 0] == 0).all(axis=1).any()


def test_half_ellipsoid_converges_to_its_volume() -> None:
    a, b, upper, lower = SEMI_AXES
    exact = np.pi / 3 * a * b * (upper + lower)
    errors = [1 - volumes(m.nodes, m.tets).sum() / exact for m in (half_ellipsoid(SEMI_AXES, n) for n in (5, 10))]
    assert 0 < errors[1] < errors[0] / 3.5
    mesh = half_ellipsoid(SEMI_AXES, 6)
    assert len(mesh.tets) == 4 * 6**3
    assert volumes(mesh.nodes, mesh.tets).min() > 0
    assert radius_ratios(mesh.nodes, mesh.tets).min() > 0.2


@pytest.mark.parametrize("block", [(1, 1, 1), (2, 3, 4), (7, 5, 6)])
def test_block_occupancy_is_the_mean_of_padded_blocks(block: tuple[int, int, int]) -> None:
    labels = np.random.default_rng(2).integers(0, 3, (13, 10, 17)).astype(np.uint8)[:, :, 2:]
    padded = np.pad(labels > 0, [(0, -n % b) for n, b in zip(labels.shape, block, strict=True)])
    k, j, i = (n // b for n, b in zip(padded.shape, block, strict=True))
    oracle = padded.reshape(k, block[0], j, block[1], i, block[2]).mean(axis=(1, 3, 5))
    assert np.allclose(block_occupancy(labels, block), oracle, atol=1e-7)


def test_same_block_occupancy_for_any_number_of_threads(threads: Callable[[int], None]) -> None:
    labels = np.random.default_rng(2).integers(0, 3, (13, 10, 17)).astype(np.uint8)
    results = []
    for count in (1, 2):
        threads(count)
        results.append(block_occupancy(labels, (2, 3, 4)).tobytes())
    assert results[0] == results[1]


@pytest.mark.parametrize(("voxel", "air_behind"), [(1.0, 0), (1.0, 3), (0.5, 0), (2.0, 0)])
def test_outline_is_closed_flat_at_the_wall_and_near_the_ellipsoid(voxel: float, air_behind: int) -> None:
    phantom = ellipsoid_phantom(voxel, air_behind)
    surface = outline(phantom)
    a, b, upper, lower = SEMI_AXES
    body = np.count_nonzero(phantom.labels) * phantom.grid.voxel_volume
    assert surface.volume == pytest.approx(body)
    assert enclosed_volume(surface.points, surface.triangles) == pytest.approx(body, rel=1e-3)

    edges = np.sort(surface.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()

    corners = surface.points[surface.triangles]
    assert surface.points[:, 0].min() == 0.0
    flat = (corners[:, :, 0] == 0).all(axis=1)
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    rim = 2 * np.pi * 21.6
    assert area[flat].sum() == pytest.approx(np.pi * b * (upper + lower) / 2, abs=0.15 * voxel * rim)
    # No triangle leans against the wall: the rim is sharp.
    assert corners[~flat][:, :, 0].mean(axis=1).min() > 0

    scaled = surface.points / [a, b, 1.0]
    scaled[:, 2] /= np.where(scaled[:, 2] > 0, upper, lower)
    off = surface.points[:, 0] > 0
    distance = (np.linalg.norm(scaled[off], axis=1) - 1) * min(SEMI_AXES)
    assert np.sqrt((distance**2).mean()) < 0.25 * voxel


def test_outline_needs_a_chest_wall() -> None:
    phantom = ellipsoid_phantom()
    with pytest.raises(MeshError, match="x = 0 does not lie between") as error:
        outline(Phantom(phantom.labels, phantom.grid.moved(x=0.4)))
    assert error.value.code == "mesh-no-wall"
    with pytest.raises(MeshError, match="no body at the chest wall"):
        outline(Phantom(phantom.labels, phantom.grid.moved(x=-31.0)))


def test_outline_refuses_a_handful_of_voxels() -> None:
    labels = np.zeros((8, 8, 8), np.uint8)
    labels[3:5, 3:5, :2] = 1
    with pytest.raises(MeshError, match=r"about 2\.0 voxels across") as error:
        outline(Phantom(labels, Grid((8, 8, 8), (5.0, 5.0, 5.0), (0.0, -20.0, -20.0))))
    assert error.value.code == "mesh-empty"


def test_outline_refuses_two_bodies_and_drops_specks() -> None:
    phantom = ellipsoid_phantom()
    labels = np.array(phantom.labels)
    labels[0, 0, 20] = 1
    assert outline(Phantom(labels, phantom.grid)).points[:, 2].min() > -25
    labels = np.array(phantom.labels)
    labels[:8, :8, 10:20] = 1
    with pytest.raises(MeshError, match="pieces") as error:
        outline(Phantom(labels, phantom.grid))
    assert error.value.code == "mesh-pieces"


def test_nodes_near_the_wall_are_snapped() -> None:
    mesh = box((10.0, 10.0, 10.0), (4, 4, 4))
    nodes = np.array(mesh.nodes)
    nodes[mesh.wall, 0] += np.random.default_rng(3).uniform(-0.05, 0.05, len(mesh.wall))
    snapped, tets = snapped_to_wall(nodes, mesh.tets, 0.1)
    wall, skin = wall_and_skin(snapped, tets)
    assert np.array_equal(wall, mesh.wall)
    assert (snapped[wall, 0] == 0.0).all()
    assert len(skin) == len(mesh.skin)
    assert np.array_equal(np.delete(snapped, wall, axis=0), np.delete(nodes, wall, axis=0))


def test_cleaning_keeps_the_largest_piece_of_positive_tets() -> None:
    mesh = box((10.0, 10.0, 10.0), (4, 4, 4))
    speck = np.array([[90.0, 0, 0], [91, 0, 0], [90, 1, 0], [90, 0, 1]])
    nodes = np.concatenate([np.zeros((1, 3)), mesh.nodes, speck])
    tets = np.concatenate([mesh.tets[:, [1, 0, 2, 3]] + 1, [[126, 127, 128, 129]]])
    kept_nodes, kept = compacted(nodes, largest_body(nodes, oriented(nodes, tets)))
    assert len(kept_nodes) == len(mesh.nodes)
    assert volumes(kept_nodes, kept).min() > 0
    assert volumes(kept_nodes, kept).sum() == pytest.approx(1000.0)
    big_speck = np.array(nodes)
    big_speck[-3:] += [[30, 0, 0], [0, 30, 0], [0, 0, 30]]
    with pytest.raises(MeshError, match="2 pieces"):
        largest_body(big_speck, oriented(big_speck, tets))


def test_cache_order_is_a_renumbering_with_less_bandwidth() -> None:
    mesh = box((10.0, 10.0, 10.0), (6, 6, 6))
    shuffle = np.random.default_rng(4).permutation(len(mesh.nodes))
    nodes = np.empty_like(mesh.nodes)
    nodes[shuffle] = mesh.nodes
    shuffled = shuffle[mesh.tets]
    ordered_nodes, ordered = cache_order(nodes, shuffled)
    assert np.allclose(np.sort(volumes(ordered_nodes, ordered)), np.sort(volumes(nodes, shuffled)), rtol=1e-12, atol=0)
    assert np.allclose(np.sort(ordered_nodes.sum(axis=1)), np.sort(nodes.sum(axis=1)))
    assert np.ptp(ordered, axis=1).max() < 0.5 * np.ptp(shuffled, axis=1).max()


def test_quality_report_is_plain_data() -> None:
    mesh = box((1.0, 1.0, 1.0), (1, 1, 1))
    report = quality_report(mesh.nodes, mesh.tets)
    assert report["nodes"] == 8
    assert report["tets"] == 6
    assert report["volume_ml"] == pytest.approx(1e-3)
    assert report["edge_length_mm"]["max"] == pytest.approx(np.sqrt(3))
    assert report["dihedral_angle_deg"]["min"] == pytest.approx(45.0)
