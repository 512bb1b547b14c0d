"""The table of cuts: every pattern keeps the right share of the tetrahedron, both sides of a face agree."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from simcore.mesh.lattice import NEAR_LONG, NEAR_SHORT
from simcore.mesh.lattice_stencils import CORNERS, EDGES, SHAPE, STEPS, all_signs, table
from simcore.mesh.quality import dihedral_angles, volumes

SIGNS = list(all_signs())


def local_points(t: int, fraction: float = 0.5) -> NDArray[np.float64]:
    corners = CORNERS[t] * SHAPE
    return np.concatenate([corners, [corners[a] + fraction * (corners[b] - corners[a]) for a, b in EDGES]])


def test_tetrahedra_are_congruent_and_their_long_edges_come_first() -> None:
    for corners in CORNERS * SHAPE:
        length = [np.linalg.norm(corners[a] - corners[b]) for a, b in EDGES]
        assert length == pytest.approx([1, 1] + 4 * [np.sqrt(3) / 2])
        assert abs(volumes(corners, np.array([[0, 1, 2, 3]]))[0]) == pytest.approx(1 / 12)


def test_every_edge_of_the_tetrahedra_is_a_step_of_the_lattice() -> None:
    steps = {tuple(s) for s in np.concatenate([STEPS, -STEPS]).tolist()}
    for corners in CORNERS:
        assert all(tuple((corners[a] - corners[b]).tolist()) in steps for a, b in EDGES)


def test_no_tetrahedron_straddles_the_wall() -> None:
    """Moved to all its places, a tetrahedron lies on one side of every plane p = const."""
    assert (np.ptp(CORNERS[:, :, 0], axis=1) == 1).all()


def test_lattice_fills_space() -> None:
    """A tetrahedron of each kind for every second (p, q, k): the volume of two cells of the sublattice."""
    assert pytest.approx(2 * np.prod(SHAPE)) == 6 * 1 / 12


@pytest.mark.parametrize("t", range(6))
@pytest.mark.parametrize("fraction", [0.5, 0.3])
def test_stencils_keep_the_volume_inside(t: int, fraction: float) -> None:
    """What is kept and what the opposite signs keep is the whole; all pieces are positive."""
    count, corners = table()
    points = local_points(t, fraction)
    kept = []
    for pattern, signs in enumerate(SIGNS):
        tets = corners[t, pattern, : count[t, pattern]]
        assert (tets < 10).all()
        each = volumes(points, tets)
        assert (each > 1e-9).all()
        on = [i for i in range(4) if signs[i] < 0]
        assert not np.isin(tets, on).any()
        kept.append(each.sum())
    for pattern, signs in enumerate(SIGNS):
        opposite = SIGNS.index((-signs[0], -signs[1], -signs[2], -signs[3]))
        if any(signs):
            assert kept[pattern] + kept[opposite] == pytest.approx(1 / 12)
        else:
            assert kept[pattern] == 0


def faces_on(lattice_face: tuple[int, ...], tets: NDArray[np.int64]) -> list[tuple[int, ...]]:
    """Triangles of a stencil that lie in a face of the tetrahedron."""
    allowed = {*lattice_face, *(4 + e for e, ends in enumerate(EDGES) if set(ends) <= set(lattice_face))}
    return [c for tet in tets for c in itertools.combinations(sorted(tet.tolist()), 3) if set(c) <= allowed]


def test_both_tetrahedra_of_a_face_divide_it_alike() -> None:
    """All pairs of neighbours, all signs of the five corners: the triangles in the common face are the same."""
    count, corners = table()
    places = [(t, o) for t in range(6) for o in itertools.product(range(-2, 3), repeat=3) if sum(o) % 2 == 0]
    pairs = 0
    for t in range(6):
        for other, offset in places:
            first, second = CORNERS[t].tolist(), (CORNERS[other] + offset).tolist()
            common = [c for c in first if c in second]
            if len(common) != 3:
                continue
            pairs += 1
            for signs in itertools.product((-1, 0, 1), repeat=3):
                for extra in (-1, 1):
                    divided = []
                    for index, tet in ((t, first), (other, second)):
                        own = [signs[common.index(c)] if c in common else extra for c in tet]
                        pattern = own[0] * 27 + own[1] * 9 + own[2] * 3 + own[3] + 40
                        face = tuple(i for i in range(4) if tet[i] in common)
                        place = np.array(tet)
                        twice = np.concatenate([2 * place, [place[a] + place[b] for a, b in EDGES]])
                        triangles = faces_on(face, corners[index, pattern, : count[index, pattern]])
                        divided.append({tuple(sorted(tuple(twice[i].tolist()) for i in c)) for c in triangles})
                    # A face all of whose corners are outside or on the surface is only kept by a side that reaches in.
                    if 1 in signs:
                        assert divided[0] == divided[1]
    assert pairs == 24


def test_smallest_angle_of_the_stencils() -> None:
    """Corners moved along any edge, cuts anywhere they may be: no angle below nine degrees, no negative volume."""
    count, corners = table()
    random = np.random.default_rng(5)
    steps = np.concatenate([STEPS, -STEPS]) * SHAPE
    near = np.array([NEAR_LONG] * 3 + [NEAR_SHORT] * 4)
    reach = np.concatenate([near, near])
    samples, worst = 300, 180.0
    for t, pattern in itertools.product((0, 4), range(81)):
        points = np.broadcast_to(local_points(t), (samples, 10, 3)).copy()
        for e, (a, b) in enumerate(EDGES):
            low = NEAR_LONG if e < 2 else NEAR_SHORT
            fraction = random.choice([low, 0.5, 1 - low], samples)[:, None]
            points[:, 4 + e] = points[:, a] + fraction * (points[:, b] - points[:, a])
        for i in range(4):
            if SIGNS[pattern][i] == 0:
                along = random.integers(0, 14, samples)
                points[:, i] += (random.integers(0, 2, samples) * reach[along])[:, None] * steps[along]
        for tet in corners[t, pattern, : count[t, pattern]]:
            nodes, tets = points[:, tet].reshape(-1, 3), np.arange(4 * samples).reshape(-1, 4)
            assert volumes(nodes, tets).min() > 0
            worst = min(worst, float(dihedral_angles(nodes, tets).min()))
    assert 9 < worst < 11
