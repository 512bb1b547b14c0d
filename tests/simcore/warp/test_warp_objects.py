"""Lesions of few voxels: carried forward one by one, none lost, none joined, with the volume that is theirs."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from scipy import ndimage

from simcore.core.artifacts import Compression, Phantom, TetMesh
from simcore.core.grid import Grid
from simcore.core.tissues import Tissue
from simcore.mesh.structured import box
from simcore.warp import WarpSpec, deform
from simcore.warp.objects import LARGEST, erase, small_objects
from simcore.warp.points import ForwardMap
from simcore.warp.raster import census

SIZE = (24.0, 20.0, 16.0)
TOUCHING = np.ones((3, 3, 3))


def centred(mesh: TetMesh) -> TetMesh:
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    shift = np.array([0.0, *((low + high)[1:] / 2)])
    return TetMesh(mesh.nodes - shift, mesh.tets, mesh.wall, mesh.skin)


MESH = centred(box(SIZE, (4, 4, 3)))


def fat(voxel: float = 0.5) -> np.ndarray:
    return np.full([round(s / voxel) for s in SIZE[::-1]], Tissue.ADIPOSE, np.uint8)


def phantom_of(labels: np.ndarray, voxel: float = 0.5) -> Phantom:
    return Phantom(labels, Grid(labels.shape, (voxel,) * 3, (0.0, -SIZE[1] / 2, -SIZE[2] / 2)))


def squeezed(share: float) -> Compression:
    """To ``share`` of the height, at the same volume."""
    stretch = np.array([share**-0.5, share**-0.5, share])
    return Compression(MESH.nodes * (stretch - 1), (-SIZE[2] / 2 * share, SIZE[2] / 2 * share), 1.0, "converged")


def sizes(labels: np.ndarray, tissue: Tissue) -> list[int]:
    pieces, count = ndimage.label(labels == tissue, TOUCHING)
    return sorted(np.bincount(pieces.ravel())[1 : count + 1].tolist())


def scattered(rng: np.random.Generator, apart: int, shapes: int = 1) -> np.ndarray:
    """Calcifications of random shape, at least ``apart`` voxels from one another."""
    labels = fat()
    for z in range(2, labels.shape[0] - shapes - 2, shapes + apart):
        for y in range(2, labels.shape[1] - shapes - 2, shapes + apart):
            for x in range(0, labels.shape[2] - shapes - 2, shapes + apart):
                block = labels[z : z + shapes, y : y + shapes, x : x + shapes]
                block[rng.random(block.shape) < 0.7] = Tissue.CALCIFICATION
    return labels


@pytest.mark.parametrize("share", [0.8, 0.6, 0.4, 0.3])
def test_calcifications_of_one_voxel_are_all_there(share: float) -> None:
    rng = np.random.default_rng(1)
    labels = fat()
    places = [p for p in np.ndindex(*(s // 5 for s in labels.shape)) if rng.random() < 0.5]
    for place in places:
        labels[tuple(5 * np.array(place) + 2)] = Tissue.CALCIFICATION
    out = deform(phantom_of(labels), MESH, squeezed(share), WarpSpec())
    assert sizes(out.labels, Tissue.CALCIFICATION) == [1] * len(places)
    facts = out.report["lesion_objects"]["calcification"]
    assert (facts["before"], facts["after"]) == (len(places), len(places))
    assert (facts["merged"], facts["lost"]) == (0, 0)
    assert 0 < facts["placed"] <= len(places)


def test_they_go_where_the_map_leads_them() -> None:
    labels = fat()
    labels[9, 13, 21] = labels[25, 30, 3] = Tissue.CALCIFICATION
    out = deform(phantom_of(labels), MESH, squeezed(0.5), WarpSpec())
    for z, y, x in ((9, 13, 21), (25, 30, 3)):
        before = (np.array([x, y, z]) + 0.5) * 0.5 - [0.0, SIZE[1] / 2, SIZE[2] / 2]
        after = before * [2**0.5, 2**0.5, 0.5] + [0.0, 0.0, SIZE[2] / 4]
        i, j, k = np.floor((after - out.grid.corner) / out.grid.spacing).astype(int)
        assert out.labels[k, j, i] == Tissue.CALCIFICATION


@pytest.mark.parametrize("share", [0.7, 0.5])
@pytest.mark.parametrize("shapes", [2, 3, 5])
def test_volumes_of_small_objects_are_kept(share: float, shapes: int) -> None:
    labels = scattered(np.random.default_rng(shapes), apart=5, shapes=shapes)
    before, after = (
        sizes(volume, Tissue.CALCIFICATION)
        for volume in (labels, deform(phantom_of(labels), MESH, squeezed(share), WarpSpec()).labels)
    )
    assert len(before) == len(after) > 20
    for n, m in zip(before, after, strict=True):
        assert abs(m - n) <= max(0.1 * n, 0.5)


def test_neighbours_a_voxel_apart_stay_apart_where_there_is_room() -> None:
    """At 40 % their distance along z is less than a voxel: one makes room for the other."""
    labels = fat()
    labels[10:20:2, 20, 20] = Tissue.CALCIFICATION
    out = deform(phantom_of(labels), MESH, squeezed(0.4), WarpSpec())
    assert sizes(out.labels, Tissue.CALCIFICATION) == [1] * 5
    assert out.report["lesion_objects"]["calcification"]["merged"] == 0


def test_neighbours_that_the_lookup_leaves_whole_but_joins_are_parted() -> None:
    """The gap of a voxel is looked up nowhere, and each keeps its volume."""
    labels = fat()
    for z, y, x in np.ndindex(2, 5, 6):
        labels[8 + 5 * z :, 4 + 6 * y :, 4 + 6 * x :][:4, :3, :3] = Tissue.CALCIFICATION
    out = deform(phantom_of(labels), MESH, squeezed(0.8), WarpSpec())
    assert len(sizes(out.labels, Tissue.CALCIFICATION)) == 60


def test_it_is_told_where_two_had_to_merge() -> None:
    labels = fat()
    labels[::2, ::2, ::2] = Tissue.CALCIFICATION
    facts = deform(phantom_of(labels), MESH, squeezed(0.4), WarpSpec()).report["lesion_objects"]["calcification"]
    assert facts["before"] == labels.size / 8
    assert facts["merged"] > 0
    assert facts["lost"] == 0
    assert facts["after"] < facts["before"]


@pytest.mark.parametrize("shapes", [2, 3])
def test_objects_without_room_touch_but_keep_their_volume(shapes: int) -> None:
    """One voxel lay between them: down to 5 % of an object was left, and nobody was told."""
    labels = scattered(np.random.default_rng(5), apart=1, shapes=shapes)
    out = deform(phantom_of(labels), MESH, squeezed(0.4), WarpSpec())
    before, after = (int((volume == Tissue.CALCIFICATION).sum()) for volume in (labels, out.labels))
    assert after == pytest.approx(before, rel=0.005)
    assert out.report["lesion_objects"]["calcification"]["merged"] > 30


def test_large_lesions_are_looked_up_and_small_ones_keep_off_them() -> None:
    labels = fat()
    z, y, x = np.indices(labels.shape)
    labels[(z - 16) ** 2 + (y - 20) ** 2 + (x - 20) ** 2 < 36] = Tissue.CALCIFICATION
    large = int((labels == Tissue.CALCIFICATION).sum())
    assert large > LARGEST[Tissue.CALCIFICATION]
    labels[16, 20, 28] = labels[24, 20, 20] = Tissue.CALCIFICATION
    out = deform(phantom_of(labels), MESH, squeezed(0.5), WarpSpec())
    after = sizes(out.labels, Tissue.CALCIFICATION)
    assert after[:2] == [1, 1]
    assert after[2:] == [pytest.approx(large, rel=0.05)]


def test_a_small_mass_keeps_its_calcification() -> None:
    labels = fat()
    labels[10:13, 10:13, 10:13] = Tissue.MASS
    labels[11, 11, 11] = Tissue.CALCIFICATION
    out = deform(phantom_of(labels), MESH, squeezed(0.6), WarpSpec())
    assert sizes(out.labels, Tissue.CALCIFICATION) == [1]
    (z, y, x) = np.argwhere(out.labels == Tissue.CALCIFICATION)[0]
    assert (out.labels[z, y - 1 : y + 2, x - 1 : x + 2] == Tissue.MASS).sum() > 5
    assert sizes(out.labels, Tissue.MASS) == [pytest.approx(26, abs=2)]


def test_what_surrounds_an_object_takes_its_place_and_air_only_alone() -> None:
    labels = fat()
    labels[:, 20:, :] = Tissue.GLAND
    labels[5:8, 5:8, 5:8] = labels[5, 30, 0] = Tissue.CALCIFICATION
    labels[0, 0, 0] = Tissue.MASS
    counts = census(labels)
    objects = small_objects(labels, counts)
    assert objects.sizes.tolist() == [1, 27, 1]
    filled = labels.copy()
    erase(filled, objects.voxels)
    assert (filled[:, :20] == Tissue.ADIPOSE).all()
    assert (filled[:, 20:] == Tissue.GLAND).all()
    alone = np.zeros((3, 3, 3), np.uint8)
    alone[1, 1, 1] = Tissue.CALCIFICATION
    erase(alone, np.array([13]))
    assert not alone.any()


def test_an_object_beside_the_body_is_not_lost_in_silence() -> None:
    labels = np.pad(fat(), ((40, 2), (2, 2), (0, 2)))
    labels[3, 5, 5] = Tissue.CALCIFICATION
    grid = Grid(labels.shape, (0.5,) * 3, (0.0, -SIZE[1] / 2 - 1.0, -SIZE[2] / 2 - 20.0))
    out = deform(Phantom(labels, grid), MESH, squeezed(0.5), WarpSpec())
    facts = out.report["lesion_objects"]["calcification"]
    assert facts["after"] + facts["lost"] == 1


def test_points_are_found_in_their_tetrahedra() -> None:
    forward = ForwardMap.of(MESH, MESH.nodes * 2.0)
    points = np.random.default_rng(2).uniform([0, -10, -8], [24, 10, 8], (500, 3))
    tets = forward.tets(points)
    weights = forward.weights[tets]
    shares = weights[:, :, 0] + np.einsum("pna,pa->pn", weights[:, :, 1:], points)
    assert shares.min() > -1e-9
    np.testing.assert_allclose(forward.moved(points, tets), 2 * points, atol=1e-9)
    np.testing.assert_allclose(forward.ratio, 8.0)
    outside = np.array([[30.0, 0.0, 0.0], [5.0, -40.0, 3.0]])
    np.testing.assert_allclose(forward.moved(outside, forward.tets(outside)), 2 * outside, atol=1e-9)


def test_same_bytes_for_any_number_of_threads_and_again() -> None:
    phantom = phantom_of(scattered(np.random.default_rng(5), apart=2, shapes=2))
    threads = numba.get_num_threads()
    results = []
    try:
        for number in (1, numba.config.NUMBA_NUM_THREADS, numba.config.NUMBA_NUM_THREADS):
            numba.set_num_threads(number)
            out = deform(phantom, MESH, squeezed(0.4), WarpSpec())
            assert out.report["lesion_objects"]["calcification"]["placed"] > 0
            results.append(out.labels.tobytes())
    finally:
        numba.set_num_threads(threads)
    assert results[0] == results[1] == results[2]
