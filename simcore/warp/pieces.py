"""What is rasterised: convex pieces of space, each with the map of one tetrahedron."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import TetMesh
from simcore.core.errors import MeshError
from simcore.core.grid import Grid
from simcore.warp.maps import TetMaps

TOLERANCE = 1e-9
"""Slack of the barycentric weights: a voxel centre on a shared face belongs to both sides, never to none."""

FACES = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
"""Local nodes of the face opposite to each local node."""

SIDEWAYS = 0.1
"""How far a piece of the skirt reaches beyond the sides of its tetrahedron, relative to its reach outwards: neighbours
must overlap where the surface is convex, or wedges between them stay open."""


@dataclass(frozen=True, eq=False)
class Pieces:
    """Points q (output voxels) with weight[n](q) >= -slack[n] for every node n of ``tet``, and, where ``outside`` is
    not -1, weight[outside](q) <= 0: beyond the face opposite to that node.

    tet: int64 (p,); slack: float64 (p, 4); outside: int64 (p,);
    bounds: int64 (p, 2, 3): first and last voxel (x, y, z) that may belong to it.
    """

    tet: NDArray[np.int64]
    slack: NDArray[np.float64]
    outside: NDArray[np.int64]
    bounds: NDArray[np.int64]


def interior(maps: TetMaps, grid: Grid) -> Pieces:
    """The tetrahedra themselves."""
    count = len(maps.corners)
    low = maps.corners.min(axis=1) - TOLERANCE
    high = maps.corners.max(axis=1) + TOLERANCE
    return Pieces(
        tet=np.arange(count, dtype=np.int64),
        slack=np.full((count, 4), TOLERANCE),
        outside=np.full(count, -1, dtype=np.int64),
        bounds=_within(low, high, grid.shape),
    )


def skirt(mesh: TetMesh, maps: TetMaps, grid: Grid, reach_mm: float) -> Pieces:
    """A layer of ``reach_mm`` on the outer side of every skin face."""
    tet, outside = skin_faces(mesh)
    gradient_mm = maps.barycentric[tet][:, :, 1:] / np.array(grid.spacing)
    norm = np.linalg.norm(gradient_mm, axis=2)
    slack = SIDEWAYS * reach_mm * norm
    at = np.arange(len(tet))
    slack[at, outside] = reach_mm * norm[at, outside]
    face = maps.corners[tet[:, None], FACES[outside]]
    reach = reach_mm / np.array(grid.spacing)
    return Pieces(
        tet=tet,
        slack=slack,
        outside=outside,
        bounds=_within(face.min(axis=1) - reach, face.max(axis=1) + reach, grid.shape),
    )


def _within(low: NDArray[np.float64], high: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.int64]:
    """First and last voxel centre in [low, high] and in an array of ``shape`` (z, y, x)."""
    last = np.array(shape[::-1]) - 1
    first = np.maximum(np.ceil(low), 0)
    return np.stack([first, np.minimum(np.floor(high), last)], axis=1).astype(np.int64)


def skin_faces(mesh: TetMesh) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(tetrahedron, local node opposite) of every skin face of the mesh, in the order of the tetrahedra.

    raises: MeshError where a skin face belongs to no tetrahedron, or to several.
    """
    count = len(mesh.nodes)
    faces = np.sort(mesh.tets[:, FACES].reshape(-1, 3), axis=1)
    on_skin = np.isin(_key(faces, count), _key(np.sort(mesh.skin, axis=1), count))
    at = np.flatnonzero(on_skin)
    if len(at) != len(mesh.skin):
        raise MeshError(f"{len(mesh.skin)} skin faces, but {len(at)} faces of tetrahedra are among them")
    return at // 4, at % 4


def _key(sorted_faces: NDArray[np.int64], nodes: int) -> NDArray[np.int64]:
    """One number for each face; unique below two million nodes."""
    return (sorted_faces[:, 0] * nodes + sorted_faces[:, 1]) * nodes + sorted_faces[:, 2]
