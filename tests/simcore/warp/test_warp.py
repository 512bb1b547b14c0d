"""The warp: closed forms, a brute-force oracle, volumes, the skirt, threads."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import Delaunay

from simcore.core.artifacts import Compression, Phantom, TetMesh
from simcore.core.errors import MeshError, SolverError
from simcore.core.grid import Grid
from simcore.core.tissues import MAX_TISSUES, Tissue
from simcore.warp import WarpSpec, deform
from simcore.warp.raster import census, count_holes
from simcore.warp.stage import deform_phantom

NO_SKIRT = WarpSpec(skirt_mm=0.0)
NO_LESION = np.array([1, 2, 3, 4, 7, 8, 9, 10], np.uint8)
"""Tissues that are looked up, whatever their size."""


def deform_unchecked(phantom, mesh, compression, spec):
    """For meshes that are not of the phantom: volumes are not looked at."""
    return deform_phantom(phantom, mesh, compression, spec, lambda fraction, message: None)


def mesh_of(points):
    """Delaunay tetrahedra of points in x >= 0, slivers on the hull left out."""
    tets = Delaunay(points).simplices.astype(np.int64)
    volume = np.linalg.det(points[tets[:, 1:]] - points[tets[:, :1]])
    tets[volume < 0] = tets[volume < 0][:, [0, 2, 1, 3]]
    tets = tets[np.abs(volume) > 1e-9]
    wall = np.flatnonzero(points[:, 0] == 0.0)
    faces = tets[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    boundary = faces[first[count == 1]]
    skin = boundary[~np.isin(boundary, wall).all(axis=1)]
    return TetMesh(points, tets, wall, skin)


def box_mesh(size=(24.0, 20.0, 16.0), cells=(4, 3, 3), jitter=0.2, seed=0):
    """A box x in [0, size], centred in y and z, with jittered nodes inside."""
    axes = [np.linspace(0, s, n + 1) for s, n in zip(size, cells, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    inner = ((points > 0) & (points < size)).all(axis=1)
    generator = np.random.default_rng(seed)
    points[inner] += jitter * np.array(size) / cells * generator.uniform(-1, 1, (inner.sum(), 3))
    return mesh_of(points - np.array([0.0, size[1] / 2, size[2] / 2]))


def compression_of(displacement, plates):
    return Compression(displacement, plates, 1.0, "converged")


def box_phantom(size=(24.0, 20.0, 16.0), voxel=1.0, margin=2, seed=1, tissues=NO_LESION):
    """Random tissue in the box of ``box_mesh`` with an air margin (but at the chest wall)."""
    nx, ny, nz = (round(s / voxel) for s in size)
    inside = np.random.default_rng(seed).choice(tissues, (nz, ny, nx)).astype(np.uint8)
    labels = np.pad(inside, ((margin, margin), (margin, margin), (0, margin)))
    corner = (0.0, -size[1] / 2 - margin * voxel, -size[2] / 2 - margin * voxel)
    return Phantom(labels, Grid(labels.shape, (voxel,) * 3, corner)), inside


def half_ball(radius=20.0, shells=5, per_shell=60):
    """A convex polyhedron within a half ball, coarse enough to cut off much of its surface."""
    golden = np.pi * (3 - np.sqrt(5))
    at = np.arange(per_shell) + 0.5
    direction = np.stack(
        [np.cos(golden * at) * np.sqrt(1 - (at / per_shell * 2 - 1) ** 2),
         np.sin(golden * at) * np.sqrt(1 - (at / per_shell * 2 - 1) ** 2), at / per_shell * 2 - 1], 1,
    )  # fmt: skip
    direction = direction[direction[:, 0] > 0.1]
    ring = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    direction = np.concatenate([direction, np.stack([0 * ring, np.cos(ring), np.sin(ring)], 1)])
    points = [np.zeros((1, 3))] + [direction * radius * s / shells for s in range(1, shells + 1)]
    return mesh_of(np.concatenate(points))


def ball_phantom(radius=20.0, skin=2.0, voxel=0.5):
    n = round((radius + 2) / voxel)
    x = (np.arange(n) + 0.5) * voxel
    y = (np.arange(2 * n) + 0.5) * voxel - n * voxel
    r = np.sqrt(x**2 + y[:, None] ** 2 + y[:, None, None] ** 2)
    labels = np.where(r < radius - skin, Tissue.ADIPOSE, np.where(r < radius, Tissue.SKIN, 0)).astype(np.uint8)
    return Phantom(labels, Grid(labels.shape, (voxel,) * 3, (0.0, -n * voxel, -n * voxel)))


@pytest.mark.parametrize("odd", [False, True])
def test_no_displacement_returns_the_labels(odd):
    size = (24.0, 21.0 if odd else 20.0, 16.0)
    phantom, inside = box_phantom(size, tissues=np.arange(1, 8))
    mesh = box_mesh(size)
    out = deform(phantom, mesh, compression_of(np.zeros_like(mesh.nodes), (-8.0, 8.0)), NO_SKIRT)
    assert np.array_equal(out.labels[:, : inside.shape[1], :24], inside)
    assert out.labels.shape == inside.shape
    assert out.grid.corner == (0.0, -size[1] / 2, 0.0)
    assert out.grid.spacing == phantom.grid.spacing
    assert out.report["volume_after_ml"] == out.report["volume_before_ml"]
    assert out.report["tissue_after_ml"] == out.report["tissue_before_ml"]
    assert out.report["mesh_volume_ml"] == pytest.approx(np.prod(size) * 1e-3)
    assert out.report["holes"] == 0


def test_affine_map_is_a_resampling():
    """Stretch along x and y, squeeze along z, shear: the label at q is that of the phantom at A^-1 q."""
    phantom, inside = box_phantom()
    mesh = box_mesh()
    stretch = np.array([[1.25, 0.0, 0.0], [0.1, 1.1, 0.0], [0.0, 0.0, 0.45]])
    displacement = mesh.nodes @ stretch.T - mesh.nodes
    out = deform(phantom, mesh, compression_of(displacement, (-3.6, 3.6)), NO_SKIRT)
    assert out.grid.shape[0] == 8
    z, y, x = np.meshgrid(*(out.grid.centres(axis) for axis in "zyx"), indexing="ij")
    back = np.stack([x, y, z - 3.6], -1) @ np.linalg.inv(stretch).T
    cells = back + np.array([0.0, 10.0, 8.0])
    at = np.floor(cells).astype(int)
    size = np.array(inside.shape[::-1])
    within = ((cells > 0) & (cells < size)).all(-1)
    at = np.clip(at, 0, size - 1)
    expected = np.where(within, inside[at[..., 2], at[..., 1], at[..., 0]], 0)
    decided = np.abs(cells - np.rint(cells)).min(-1) > 1e-6
    assert decided.mean() > 0.4
    assert np.array_equal(out.labels[decided], expected[decided])


def brute_force(phantom, mesh, deformed, grid):
    """Every voxel centre against every tetrahedron; (labels, True where the choice is not a matter of rounding)."""
    labels = np.zeros(grid.shape, np.uint8)
    sure = np.ones(grid.shape, bool)
    z, y, x = np.meshgrid(*(grid.centres(axis) for axis in "zyx"), indexing="ij")
    points = np.stack([x, y, z], -1).reshape(-1, 3)
    best = np.full(len(points), -np.inf)
    values = np.zeros(len(points), np.uint8)
    edge = np.ones(len(points), bool)
    for tet in mesh.tets:
        corners = deformed[tet]
        weights = np.linalg.solve((corners[1:] - corners[0]).T, (points - corners[0]).T).T
        weights = np.concatenate([1 - weights.sum(1, keepdims=True), weights], 1)
        least = weights.min(1)
        better = least > best
        cells = (weights @ mesh.nodes[tet] - phantom.grid.corner) / phantom.grid.spacing
        at = np.clip(np.floor(cells).astype(int), 0, np.array(phantom.grid.shape[::-1]) - 1)
        looked_up = np.where(least >= 0, phantom.labels[at[:, 2], at[:, 1], at[:, 0]], 0)
        values[better] = looked_up[better]
        edge[better] = (np.abs(cells - np.rint(cells)).min(1) > 1e-6)[better]
        best = np.maximum(best, least)
    labels[:] = values.reshape(grid.shape)
    sure[:] = (edge & (np.abs(best) > 1e-6)).reshape(grid.shape)
    return labels, sure


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.7, 1.3, 0.9)])
def test_against_brute_force(spacing):
    mesh = box_mesh(cells=(3, 3, 3), jitter=0.25, seed=3)
    generator = np.random.default_rng(4)
    shape = tuple(int(np.ceil(s / e)) for s, e in zip((16.0, 20.0, 24.0), spacing[::-1], strict=True))
    labels = generator.choice(NO_LESION, shape).astype(np.uint8)
    grid = Grid(shape, spacing, (0.0, -10.0, -8.0))
    phantom = Phantom(labels, grid)
    nodes = mesh.nodes
    displacement = np.stack(
        [0.1 * nodes[:, 0] * (1 + 0.02 * nodes[:, 1]), 0.3 * nodes[:, 1] + 0.02 * nodes[:, 2] ** 2 - 0.5,
         -0.45 * nodes[:, 2] + 0.0 * nodes[:, 0]], 1,
    )  # fmt: skip
    displacement += 0.2 * generator.uniform(-1, 1, nodes.shape) * (np.abs(nodes[:, 2:]) < 7.9)
    plates = (-8.0 * 0.55, 8.0 * 0.55)
    out = deform(phantom, mesh, compression_of(displacement, plates), NO_SKIRT)
    expected, sure = brute_force(phantom, mesh, nodes + displacement - [0, 0, plates[0]], out.grid)
    assert sure.mean() > 0.9
    assert np.count_nonzero(expected) > 3000
    assert np.array_equal(out.labels[sure], expected[sure])
    # No voxel inside the deformed mesh stays empty, whichever tetrahedron it belongs to.
    assert out.report["holes"] == 0


def test_skirt_leaves_the_inside_alone():
    """Cavities of air stay, also where a neighbour's map, continued, would find tissue."""
    mesh = box_mesh(cells=(3, 3, 3), jitter=0.25, seed=3)
    generator = np.random.default_rng(6)
    labels = generator.integers(0, 3, (16, 20, 24)).astype(np.uint8)
    phantom = Phantom(labels, Grid(labels.shape, (1.0, 1.0, 1.0), (0.0, -10.0, -8.0)))
    displacement = mesh.nodes * [0.1, 0.2, -0.3]
    displacement += 0.7 * generator.uniform(-1, 1, displacement.shape) * (np.abs(mesh.nodes[:, 2:]) < 7.9)
    compression = compression_of(displacement, (-5.6, 5.6))
    whole = deform(phantom, mesh, compression, WarpSpec(skirt_mm=3.0))
    expected, sure = brute_force(phantom, mesh, mesh.nodes + displacement + [0, 0, 5.6], whole.grid)
    full = Phantom(np.ones_like(labels), phantom.grid)
    inside, _ = brute_force(full, mesh, mesh.nodes + displacement + [0, 0, 5.6], whole.grid)
    check = sure & (inside != 0)
    assert np.count_nonzero(check & (expected == 0)) > 800
    assert np.array_equal(whole.labels[check], expected[check])


def test_voxel_centres_on_shared_faces_and_edges():
    """Planes of nodes through voxel centres: no voxel falls between two tetrahedra."""
    size = (24.0, 20.0, 15.0)
    phantom, inside = box_phantom(size)
    mesh = box_mesh(size, cells=(16, 8, 6), jitter=0.0)
    for stretch in ([1.0, 1.0, 1.0], [1.0, 1.2, 0.6]):
        plates = (-7.5 * stretch[2], 7.5 * stretch[2])
        out = deform(phantom, mesh, compression_of(mesh.nodes * (np.array(stretch) - 1), plates), NO_SKIRT)
        z = out.grid.centres("z") < 15.0 * stretch[2]
        y = np.abs(out.grid.centres("y")) < 10.0 * stretch[1]
        assert out.labels[np.ix_(z, y, np.arange(24))].all()
        if stretch[2] == 1.0:
            assert np.array_equal(out.labels, inside)


def test_volume_of_a_bent_body_is_that_of_its_mesh():
    mesh = half_ball()
    phantom = ball_phantom()
    nodes = mesh.nodes
    displacement = np.stack([0.2 * nodes[:, 0], 0.1 * nodes[:, 1], -0.4 * nodes[:, 2]], 1)
    out = deform_unchecked(phantom, mesh, compression_of(displacement, (-12.0, 12.0)), NO_SKIRT)
    assert out.report["volume_after_ml"] == pytest.approx(out.report["mesh_volume_ml"], rel=2e-3)
    assert out.report["holes"] == 0


@pytest.mark.parametrize("squeeze", [1.0, 0.6])
def test_skirt_keeps_the_skin(squeeze):
    """The polyhedron cuts off about a third of the skin; the skirt brings nearly all of it back, where it was."""
    mesh, phantom = half_ball(), ball_phantom()
    stretch = np.array([1 / np.sqrt(squeeze), 1 / np.sqrt(squeeze), squeeze])
    compression = compression_of(mesh.nodes * (stretch - 1), (-20.0 * squeeze, 20.0 * squeeze))
    bare = deform_unchecked(phantom, mesh, compression, NO_SKIRT)
    whole = deform_unchecked(phantom, mesh, compression, WarpSpec(skirt_mm=3.0))
    skin = np.count_nonzero(phantom.labels == Tissue.SKIN) * 0.125e-3
    assert bare.report["tissue_after_ml"]["skin"] < 0.75 * skin
    assert whole.report["tissue_after_ml"]["skin"] == pytest.approx(skin, rel=0.02)
    assert whole.report["volume_after_ml"] == pytest.approx(whole.report["volume_before_ml"], rel=0.01)
    assert whole.report["skirt_ml"] == pytest.approx(
        whole.report["volume_after_ml"] - bare.report["volume_after_ml"], abs=1e-9
    )
    # Every voxel that is filled holds what the stretched phantom has there.
    z, y, x = np.meshgrid(*(whole.grid.centres(axis) for axis in "zyx"), indexing="ij")
    r = np.sqrt((x / stretch[0]) ** 2 + (y / stretch[1]) ** 2 + ((z - 20.0 * squeeze) / squeeze) ** 2)
    filled = whole.labels != 0
    assert (r[filled] < 20.0 + 0.5).all()
    skin_there = whole.labels == Tissue.SKIN
    assert (r[skin_there] > 18.0 - 0.5).all()
    assert filled[r < 19.4].mean() > 0.995


def test_nothing_outside_the_plates():
    """The surface of the mesh lies on the plates: the skirt stops at them."""
    mesh, phantom = half_ball(), ball_phantom()
    low, thickness = -18.0, 35.65
    displacement = np.zeros_like(mesh.nodes)
    displacement[:, 2] = np.clip(mesh.nodes[:, 2], low, low + thickness) - mesh.nodes[:, 2]
    compression = compression_of(displacement, (low, low + thickness))
    out = deform_unchecked(phantom, mesh, compression, WarpSpec(skirt_mm=3.0))
    assert out.grid.corner[2] == 0.0
    assert out.grid.upper[2] >= thickness
    assert not out.labels[out.grid.centres("z") > thickness].any()


def test_truth_is_carried_along():
    mesh = box_mesh()
    phantom, _ = box_phantom()
    truth = ({"kind": "mass", "centre_mm": [6.0, 3.0, -2.0]}, {"kind": "note"})
    phantom = Phantom(phantom.labels, phantom.grid, truth)
    stretch = np.array([1.25, 1.1, 0.5])
    out = deform(phantom, mesh, compression_of(mesh.nodes * (stretch - 1), (-4.0, 4.0)), WarpSpec())
    assert out.truth[0]["centre_mm"] == pytest.approx([7.5, 3.3, 3.0], abs=1e-3)
    assert out.truth[0]["uncompressed_centre_mm"] == [6.0, 3.0, -2.0]
    assert out.truth[1] == {"kind": "note"}
    assert phantom.truth == truth


def test_inverted_tetrahedra_are_refused():
    mesh = box_mesh()
    phantom, _ = box_phantom()
    displacement = np.zeros_like(mesh.nodes)
    inner = np.flatnonzero((np.abs(mesh.nodes - [12.0, 0.0, 0.0]) < 6).all(axis=1))[0]
    displacement[inner] = [0.0, 30.0, 0.0]
    with pytest.raises(SolverError, match="inverted") as caught:
        deform(phantom, mesh, compression_of(displacement, (-8.0, 8.0)), WarpSpec())
    assert caught.value.code == "inverted-element"


def test_skin_that_is_not_of_the_mesh_is_refused():
    mesh = box_mesh()
    phantom, _ = box_phantom()
    strange = TetMesh(mesh.nodes, mesh.tets, mesh.wall, np.array([[0, 1, len(mesh.nodes) - 1]]))
    with pytest.raises(MeshError, match="skin"):
        deform(phantom, strange, compression_of(np.zeros_like(mesh.nodes), (-8.0, 8.0)), WarpSpec())


def test_same_bytes_for_any_number_of_threads(threads):
    """Nodes on voxel centres: many voxels lie on faces that tetrahedra share."""
    mesh = box_mesh(jitter=0.0, cells=(6, 5, 4))
    phantom, _ = box_phantom(voxel=0.8, margin=3)
    stretch = np.array([1.2, 1.1, 0.75])
    compression = compression_of(mesh.nodes * (stretch - 1), (-6.0, 6.0))
    volumes = []
    for count in (1, 2):
        threads(count)
        volumes.append(deform(phantom, mesh, compression, WarpSpec()).labels.tobytes())
    assert volumes[0] == volumes[1]


@pytest.mark.parametrize("width", [3, 8, 21])
def test_labels_and_holes_are_counted(width):
    rng = np.random.default_rng(width)
    labels = rng.integers(1, 5, (6, 7, width)).astype(np.uint8)
    labels[rng.random(labels.shape) < 0.05] = 0
    labels[:3, :, width // 2 :] = 1
    labels[4, 2:] = 0
    inner = labels[1:-1, 1:-1, 1:-1] == 0
    for axis in range(3):
        for shift in (-1, 1):
            inner = inner & (np.roll(labels, shift, axis)[1:-1, 1:-1, 1:-1] != 0)
    np.testing.assert_array_equal(census(labels), np.bincount(labels.ravel(), minlength=MAX_TISSUES))
    assert count_holes(labels) == inner.sum()
    assert width == 3 or inner.any()


def test_progress_reaches_one():
    mesh = box_mesh()
    phantom, _ = box_phantom()
    seen = []
    compression = compression_of(np.zeros_like(mesh.nodes), (-8.0, 8.0))
    deform(phantom, mesh, compression, WarpSpec(), lambda fraction, message: seen.append(fraction))
    assert seen == sorted(seen)
    assert seen[-1] == 1.0
