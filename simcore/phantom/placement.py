"""Which points are gland, before any voxel is labelled; and where lesions lie."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.core.errors import PhantomError
from simcore.core.grid import Grid, Point
from simcore.core.rng import stream
from simcore.core.tissues import MAX_TISSUES, Tissue
from simcore.kernels import njit, prange
from simcore.phantom.cells import START, SXX, SXY, SXZ, SYY, SYZ, SZZ, Float32, X, Y, Z
from simcore.phantom.glandularity import Compartments
from simcore.phantom.lesions import Body
from simcore.phantom.outline import Outline
from simcore.phantom.spec import AnthropomorphicPhantom
from simcore.phantom.texture import Texture, displaced

COVERS = (Tissue.AIR, Tissue.SKIN, Tissue.NIPPLE)
"""What lesions do not replace."""
_TRIES = 20_000
"""Random places among which one in the gland is sought."""


@dataclass(frozen=True)
class PlacedLesion:
    """A lesion with its place. name: its id in the truth; size: bounding box edges, mm; bodies: what it consists of."""

    name: str
    kind: str
    centre: Point
    size: Point
    bodies: tuple[Body, ...]


def gland_points(
    shape: Outline, compartments: Compartments, texture: Texture, candidates: int, random: np.random.Generator
) -> NDArray[np.float64]:
    """Random points (n, 3) in glandular compartments: those of ``candidates`` points evenly in the breast's box."""
    a, b, upper, lower = shape.axes
    points = random.random((candidates, 3)) * [a, 2 * b, upper + lower] - [0.0, b, lower]
    points = points[_in_tissue(shape, points)]
    glandular = np.zeros(len(points), dtype=np.bool_)
    _classify(compartments.table, compartments.gland_seeds, texture, points.astype(np.float32), glandular)
    return points[glandular]


def place_lesions(
    spec: AnthropomorphicPhantom, shape: Outline, compartments: Compartments, texture: Texture, seed: int
) -> tuple[PlacedLesion, ...]:
    """The lesions of ``spec``; those without a centre lie in the gland, with their bounding box inside the skin.

    raises: PhantomError where a centre lies outside the tissue, or no place in the gland is large enough.
    """
    placed = []
    for number, lesion in enumerate(spec.lesions, start=1):
        name = f"lesion-{number}"
        bodies = tuple(lesion.bodies(stream(seed, "phantom", name, "shape")))
        centre = lesion.centre_mm
        if centre is None:
            centre = _place_in_gland(shape, compartments, texture, lesion.size_mm, name, seed)
        elif not _in_tissue(shape, np.array([centre]))[0]:
            a, b, upper, lower = (round(axis, 1) for axis in shape.axes)
            raise PhantomError(
                f"lesions: the centre of {name}, {list(centre)} mm, lies outside the tissue: x from 0 to {a}, y within "
                f"{b}, z from {-lower} to {upper} mm, inside the skin"
            )
        placed.append(PlacedLesion(name, lesion.kind, centre, lesion.size_mm, bodies))
    return tuple(placed)


def stamp(
    lesions: tuple[PlacedLesion, ...], grid: Grid, labels: NDArray[np.uint8], counts: NDArray[np.int64]
) -> list[list[int]]:
    """Puts the lesions into ``labels`` (nz, ny, nx) on ``grid``, which may be a slab of the whole.

    counts: (MAX_TISSUES,) voxels of each tissue, brought up to date.
    returns: for every lesion, the number of voxels of each of its bodies.
    """
    return [[_stamp_body(lesion.centre, body, grid, labels, counts) for body in lesion.bodies] for lesion in lesions]


def truth(lesions: tuple[PlacedLesion, ...], voxels: list[list[int]], voxel_mm3: float) -> list[dict[str, Any]]:
    """The entries of ``Phantom.truth``: one a lesion, and one a body where it has several ("part_of" its lesion)."""
    entries: list[dict[str, Any]] = []
    for lesion, counts in zip(lesions, voxels, strict=True):
        entry = {
            "id": lesion.name,
            "kind": lesion.kind,
            "centre_mm": list(lesion.centre),
            "size_mm": list(lesion.size),
            "volume_mm3": sum(counts) * voxel_mm3,
            "tissue": lesion.bodies[0].tissue.name.lower(),
        }
        entries.append(entry)
        if len(lesion.bodies) == 1:
            continue
        entry["parts"] = len(lesion.bodies)
        for number, (body, count) in enumerate(zip(lesion.bodies, counts, strict=True), start=1):
            entries.append(
                {
                    "id": f"{lesion.name}/{number}",
                    "kind": body.tissue.name.lower(),
                    "part_of": lesion.name,
                    "centre_mm": [c + o for c, o in zip(lesion.centre, body.offset, strict=True)],
                    "size_mm": list(body.size),
                    "volume_mm3": count * voxel_mm3,
                    "tissue": body.tissue.name.lower(),
                }
            )
    return entries


def _place_in_gland(
    shape: Outline, compartments: Compartments, texture: Texture, size: Point, name: str, seed: int
) -> Point:
    points = gland_points(shape, compartments, texture, _TRIES, stream(seed, "phantom", name, "place"))
    corners = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, 8).T * size
    fits = _in_tissue(shape, (points[:, None, :] + corners).reshape(-1, 3)).reshape(-1, 8).all(axis=1)
    if not fits.any():
        raise PhantomError(
            f"lesions: {name} of {size[0]:g} x {size[1]:g} x {size[2]:g} mm finds no place in the gland inside the "
            "skin: give its centre_mm, make it smaller or take a higher glandularity"
        )
    x, y, z = (round(float(c), 3) for c in points[np.argmax(fits)])
    return (x, y, z)


def _in_tissue(shape: Outline, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether points (n, 3), mm, lie inside the skin."""
    index = np.floor((points - shape.grid.corner) / shape.grid.spacing).astype(np.int64)
    inside = np.all((index >= 0) & (index < np.array(shape.grid.shape)[::-1]), axis=1)
    i, j, k = np.where(inside[:, None], index, 0).T
    result: NDArray[np.bool_] = inside & (i < shape.tissue_rows[k, j])
    return result


def _stamp_body(centre: Point, body: Body, grid: Grid, labels: NDArray[np.uint8], counts: NDArray[np.int64]) -> int:
    middle = np.array(centre) + body.offset
    shape = np.array(grid.shape)[::-1]
    corner, spacing = np.array(grid.corner), np.array(grid.spacing)
    own = np.floor((middle - corner) / spacing).astype(np.int64)
    low = np.clip(np.minimum(own, np.floor((middle - np.array(body.size) / 2 - corner) / spacing)), 0, shape)
    high = np.clip(np.maximum(own, np.floor((middle + np.array(body.size) / 2 - corner) / spacing)) + 1, 0, shape)
    (i0, j0, k0), (i1, j1, k1) = low.astype(int), high.astype(int)
    if i0 >= i1 or j0 >= j1 or k0 >= k1:
        return 0
    x, y, z = (
        grid.centres(axis)[first:last] - m
        for axis, first, last, m in zip("xyz", (i0, j0, k0), (i1, j1, k1), middle, strict=True)
    )
    inside = body.inside(x[None, None, :], y[None, :, None], z[:, None, None])
    if np.all(own >= low) and np.all(own < high):
        inside[own[2] - k0, own[1] - j0, own[0] - i0] = True  # smaller than a voxel
    part = labels[k0:k1, j0:j1, i0:i1]
    inside &= ~np.isin(part, COVERS)
    number = int(np.count_nonzero(inside))
    counts -= np.bincount(part[inside], minlength=MAX_TISSUES)
    counts[body.tissue] += number
    part[inside] = body.tissue
    return number


@njit(cache=True, parallel=True, error_model="numpy")
def _classify(
    seeds: Float32, gland_seeds: int, texture: Texture, points: Float32, glandular: NDArray[np.bool_]
) -> None:
    """Whether the cell of each point (n, 3) is glandular (ligaments left out of account)."""
    for n in prange(len(points)):
        px, py, pz = displaced(texture, points[n, 0], points[n, 1], points[n, 2])
        least, winner = np.float32(np.inf), -1
        for q in range(seeds.shape[1]):
            x, y, z = px - seeds[X, q], py - seeds[Y, q], pz - seeds[Z, q]
            gx = seeds[SXX, q] * x + seeds[SXY, q] * y + seeds[SXZ, q] * z
            gy = seeds[SXY, q] * x + seeds[SYY, q] * y + seeds[SYZ, q] * z
            gz = seeds[SXZ, q] * x + seeds[SYZ, q] * y + seeds[SZZ, q] * z
            delay = gx * x + gy * y + gz * z + seeds[START, q]
            if delay < least:
                least, winner = delay, q
        glandular[n] = winner < gland_seeds
