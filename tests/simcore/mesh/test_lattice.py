"""The lattice mesher: conforming, reproducible, sharp at the chest wall, no bad tetrahedron for any outline."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError
from scipy.ndimage import gaussian_filter

from simcore.core.artifacts import Phantom, TetMesh
from simcore.core.errors import MeshError
from simcore.core.grid import Grid
from simcore.mesh import LatticeMesh, MeshSpec, TetwildMesh, build
from simcore.mesh.cleaning import compacted, largest_body
from simcore.mesh.lattice import stuffed
from simcore.mesh.lattice_field import sample
from simcore.mesh.quality import boundary_faces, dihedral_angles, volumes
from simcore.mesh.surface import OccupancyField, outline

Inside = Callable[[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]], NDArray[np.bool_]]
"""Of x, y and z over 40 mm."""


def phantom_of(inside: Inside, voxel: float, size: float = 40.0) -> Phantom:
    """A shape within 0 < x < 1.5 size, |y|, |z| < 1.5 size."""
    n = int(np.ceil(1.5 * size / voxel)) + 2
    grid = Grid((2 * n, 2 * n, n), (voxel,) * 3, (0.0, -n * voxel, -n * voxel))
    x, y = grid.centres("x")[None, None, :] / size, grid.centres("y")[None, :, None] / size
    z = grid.centres("z")[:, None, None] / size
    return Phantom(np.ascontiguousarray(np.broadcast_to(inside(x, y, z), grid.shape)).astype(np.uint8), grid)


SHAPES: dict[str, Inside] = {
    "ellipsoid": lambda x, y, z: x**2 + (y / 0.7) ** 2 + (z / np.where(z > 0, 0.8, 0.6)) ** 2 < 1,
    "hanging": lambda x, y, z: x**2 + (y / 0.8) ** 2 + ((z + 0.4 * x) / 0.8) ** 2 < 1,
    "sphere that narrows at the wall": lambda x, y, z: (x - 0.4) ** 2 + y**2 + z**2 < 0.9,
    "cap that meets the wall at 45 degrees": lambda x, y, z: (x + 0.6) ** 2 + y**2 + z**2 < 0.8,
    "box": lambda x, y, z: (x < 0.8) & (abs(y) < 0.9) & (abs(z) < 0.7),
    "cone": lambda x, y, z: np.hypot(y, z) < 0.9 * (1 - x),
    "bumpy": lambda x, y, z: x**2 + y**2 + z**2 + 0.12 * (np.sin(9 * x + 5 * y) + np.cos(8 * z - 6 * y)) < 0.9,
}


def check(mesh: TetMesh) -> None:
    """What every mesh must have."""
    assert dihedral_angles(mesh.nodes, mesh.tets).min() > 15
    assert dihedral_angles(mesh.nodes, mesh.tets).max() < 165
    assert volumes(mesh.nodes, mesh.tets).min() > 0
    assert len(largest_body(mesh.nodes, mesh.tets)) == len(mesh.tets)
    assert len(np.unique(mesh.tets)) == len(mesh.nodes)
    assert (mesh.nodes[mesh.wall, 0] == 0).all()
    assert np.array_equal(mesh.wall, np.flatnonzero(mesh.nodes[:, 0] == 0))
    assert mesh.nodes[:, 0].min() == 0
    check_conforming(mesh.tets)


def check_conforming(tets: NDArray[np.int64]) -> None:
    """Faces belong to one or two tetrahedra; those of one to a closed surface without pinches."""
    faces = np.sort(tets[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]].reshape(-1, 3), axis=1)
    counts = np.unique(faces, axis=0, return_counts=True)[1]
    assert counts.max() == 2
    surface = boundary_faces(tets)
    assert len(surface) == np.count_nonzero(counts == 1)
    edges = surface[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert (np.unique(np.sort(edges, axis=1), axis=0, return_counts=True)[1] == 2).all()
    # Neighbours agree on what is outside: every edge is run once in each direction.
    assert len(np.unique(edges, axis=0)) == len(edges)
    assert np.array_equal(np.unique(edges, axis=0), np.unique(edges[:, ::-1], axis=0))


@pytest.fixture(scope="module")
def ellipsoid() -> Phantom:
    return phantom_of(SHAPES["ellipsoid"], 1.0)


@pytest.mark.parametrize("edge_length", [7.0, 13.0])
@pytest.mark.parametrize("voxel", [1.0, 2.0])
@pytest.mark.parametrize("shape", SHAPES)
def test_every_shape(shape: str, voxel: float, edge_length: float) -> None:
    phantom = phantom_of(SHAPES[shape], voxel)
    mesh = build(phantom, LatticeMesh(edge_length_mm=edge_length))
    check(mesh)
    body = np.count_nonzero(phantom.labels) * phantom.grid.voxel_volume
    assert volumes(mesh.nodes, mesh.tets).sum() == pytest.approx(body, rel=1e-6)
    assert abs(mesh.report["volume_before_correction"] - 1) < 0.02
    assert mesh.report["mesher"] == "lattice"
    if shape != "bumpy":
        # The wall is whole: what looks towards the body lies in it.
        faces = boundary_faces(mesh.tets)
        corners = mesh.nodes[faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        towards_wall = normal[:, 0] < -0.7 * np.linalg.norm(normal, axis=1)
        assert np.array_equal(towards_wall, (corners[:, :, 0] == 0).all(axis=1))


@pytest.mark.parametrize("edge_length", [4.0, 5.5, 9.0, 16.0, 20.0])
def test_every_size(ellipsoid: Phantom, edge_length: float) -> None:
    mesh = build(ellipsoid, LatticeMesh(edge_length_mm=edge_length))
    check(mesh)
    assert len(mesh.tets) == pytest.approx(35e3 * (5.5 / edge_length) ** 3, rel=0.2)
    mean = mesh.report["edge_length_mm"]["mean"]
    assert mean == pytest.approx(mesh.report["wanted_edge_length_mm"], rel=0.06)


@pytest.mark.parametrize("size", [8.0, 10.0, 15.0])
def test_tiny_body_of_coarse_voxels(size: float) -> None:
    for edge_length in (5.5, 12.0):
        check(build(phantom_of(SHAPES["ellipsoid"], 2.0, size), LatticeMesh(edge_length_mm=edge_length)))


@pytest.mark.parametrize("seed", [3, 4, 6, 7])
def test_no_bad_tetrahedron_in_a_rough_field(seed: int) -> None:
    """Noise that no phantom has: the stencils alone leave 13 degrees, moving nodes along the outline leaves 16."""
    n = 40
    z, y, x = np.mgrid[:n, :n, : n // 2] + 0.5
    noise = gaussian_filter(np.random.default_rng(seed).normal(size=x.shape), 1.0)
    distance = 13 - np.sqrt(x**2 + (y - n / 2) ** 2 + (z - n / 2) ** 2)
    values = np.clip(0.5 + distance / 4 + 0.6 * noise / noise.std(), 0, 1).astype(np.float32)
    field = OccupancyField(values, np.array([0.5, 0.5 - n / 2, 0.5 - n / 2]), np.ones(3), 0.5)
    nodes, tets = compacted(*stuffed(field, 3.0))
    assert volumes(nodes, tets).min() > 0
    assert dihedral_angles(nodes, tets).min() > 16
    faces = np.sort(tets[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]].reshape(-1, 3), axis=1)
    assert np.unique(faces, axis=0, return_counts=True)[1].max() == 2
    skin = np.unique(boundary_faces(tets))
    assert np.abs(sample(field, nodes[skin[nodes[skin, 0] > 0]]) - field.level).max() < 1e-4


def test_nodes_lie_on_the_ellipsoid(ellipsoid: Phantom) -> None:
    mesh = build(ellipsoid, LatticeMesh())
    points = mesh.nodes[np.unique(mesh.skin)] / 40
    points[:, 1] /= 0.7
    points[:, 2] /= np.where(points[:, 2] > 0, 0.8, 0.6)
    distance = (np.linalg.norm(points, axis=1) - 1) * 24
    assert np.sqrt((distance**2).mean()) < 0.1
    assert np.abs(distance).max() < 0.4


def test_rim_is_sharp(ellipsoid: Phantom) -> None:
    """The wall is a flat ellipse, and no skin triangle lies in it or leans against it."""
    mesh = build(ellipsoid, LatticeMesh())
    faces = boundary_faces(mesh.tets)
    corners = mesh.nodes[faces]
    in_wall = (corners[:, :, 0] == 0).all(axis=1)
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    assert area[in_wall].sum() == pytest.approx(np.pi * 40**2 * 0.7 * 0.7, rel=0.01)
    at_rim = ((corners[:, :, 0] == 0).any(axis=1)) & ~in_wall
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    assert np.abs(normal[at_rim, 0]).max() < 0.35
    # The elements at the wall are as good as those inside.
    touches = (mesh.nodes[mesh.tets][:, :, 0] == 0).any(axis=1)
    assert dihedral_angles(mesh.nodes, mesh.tets[touches]).min() > 18


def test_mesh_of_a_symmetric_body_is_symmetric() -> None:
    """y = 0 is a mirror of the lattice too."""
    phantom = phantom_of(lambda x, y, z: (x / 0.9) ** 2 + y**2 + (z / 0.8) ** 2 < 1, 1.0)
    assert np.array_equal(phantom.labels, phantom.labels[:, ::-1])
    nodes = build(phantom, LatticeMesh(edge_length_mm=10.0)).nodes
    mirrored = nodes * [1, -1, 1]
    rows = [n[np.lexsort(np.round(n, 6).T)] for n in (nodes, mirrored)]
    assert np.allclose(rows[0], rows[1], atol=1e-5)


def test_same_bytes_for_any_number_of_threads(threads: Callable[[int], None]) -> None:
    phantom = phantom_of(SHAPES["bumpy"], 1.0)
    meshes = []
    for count in (1, 2, 1):
        threads(count)
        meshes.append(build(phantom, LatticeMesh(edge_length_mm=6.0)))
    for mesh in meshes[1:]:
        for name in ("nodes", "tets", "wall", "skin"):
            assert getattr(mesh, name).tobytes() == getattr(meshes[0], name).tobytes()
        assert mesh.report == meshes[0].report


def test_field_of_the_outline_is_that_of_its_surface(ellipsoid: Phantom) -> None:
    surface = outline(ellipsoid)
    assert np.abs(sample(surface.field, surface.points) - surface.field.level)[surface.points[:, 0] > 0].max() < 1e-3


def test_no_body_and_no_wall_are_refused(ellipsoid: Phantom) -> None:
    empty = Phantom(np.zeros_like(ellipsoid.labels), ellipsoid.grid)
    with pytest.raises(MeshError, match="no body at the chest wall") as error:
        build(empty, LatticeMesh())
    assert error.value.code == "mesh-no-wall"
    with pytest.raises(MeshError, match="x = 0 does not lie between"):
        build(Phantom(ellipsoid.labels, ellipsoid.grid.moved(x=0.4)), LatticeMesh())
    with pytest.raises(MeshError, match="no body at the chest wall"):
        build(Phantom(np.roll(ellipsoid.labels, 5, axis=2), ellipsoid.grid), LatticeMesh())


def test_too_coarse_a_lattice_is_refused() -> None:
    plate = phantom_of(lambda x, y, z: (x < 1.2) & (abs(y) < 1.2) & (abs(z) < 0.1), 1.0)
    with pytest.raises(MeshError, match="edge_length_mm") as error:
        build(plate, LatticeMesh(edge_length_mm=20.0))
    assert error.value.code in ("mesh-volume", "mesh-empty")


def test_no_mesh_with_a_smaller_angle_comes_out(ellipsoid: Phantom, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("simcore.mesh.builder.MIN_ANGLE_DEG", 40.0)
    with pytest.raises(MeshError, match=r"dihedral angle of \d+\.\d degrees where 40 are the least") as error:
        build(ellipsoid, LatticeMesh(edge_length_mm=14.0))
    assert error.value.code == "mesh-quality"


def test_kind_is_chosen_in_the_specification() -> None:
    specs = TypeAdapter(MeshSpec)
    assert specs.validate_json('{"kind": "lattice", "edge_length_mm": 8.0}') == LatticeMesh(edge_length_mm=8.0)
    assert specs.validate_json('{"edge_length_mm": 8.0}') == TetwildMesh(edge_length_mm=8.0)
    with pytest.raises(ValidationError, match="'tetwild', 'lattice'"):
        specs.validate_json('{"kind": "octree"}')
    with pytest.raises(ValidationError, match="epsilon"):
        specs.validate_json('{"kind": "lattice", "epsilon": 0.001}')
