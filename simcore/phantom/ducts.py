"""Ducts: one branching tree a lobe, from the nipple to random points of the gland.

A branch heads for the middle of the points that it has to reach, divides after a part of the way, and each half of the
points goes on with a branch of its own. Diameters fall by the same factor with every generation; a factor of 2^(-1/3),
near that of the default diameters, is Murray's law.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.core.advice import one_of, where
from simcore.core.errors import PhantomError
from simcore.core.tissues import MAX_TISSUES, Tissue
from simcore.kernels import njit, prange
from simcore.phantom.glandularity import Compartments
from simcore.phantom.outline import Outline
from simcore.phantom.placement import gland_points
from simcore.phantom.spec import AnthropomorphicPhantom, DuctSpec
from simcore.phantom.texture import Texture

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

_CANDIDATES = 40
"""Random points drawn for every duct end that is wanted."""
_FORK = (0.3, 0.5)
"""Least and largest part of the way to the middle of its ends after which a duct divides."""
_PIECES = 4
"""Straight pieces of a branch."""
_BEND = 0.12
"""Standard deviation of the sideways shift of a fork, relative to the length of its branch."""

NONE = np.zeros((0, 8), np.float32)
"""No ducts."""


@dataclass(frozen=True)
class _Branch:
    """A duct that is still to grow: from ``start`` along ``heading`` towards ``ends`` (n, 3)."""

    start: Float64
    heading: Float64
    ends: Float64
    generation: int


def grow_ducts(
    spec: AnthropomorphicPhantom, shape: Outline, compartments: Compartments, texture: Texture,
    random: np.random.Generator,
) -> Float32:  # fmt: skip
    """Pieces of ducts, float32 (n, 8): (x, y, z, radius) of both ends, mm; none where the specification has none.

    raises: PhantomError where there is too little gland to reach.
    """
    if spec.ducts is None:
        return NONE
    each = 2**spec.ducts.generations
    count = spec.ducts.trees * each
    points = gland_points(shape, compartments, texture, _CANDIDATES * count, random)
    if len(points) < spec.ducts.trees:
        raise PhantomError(
            f"ducts.trees = {spec.ducts.trees} find too little gland in a breast of glandularity = "
            f"{spec.glandularity:g}: take "
            + one_of(where(spec.ducts.trees > 1, "fewer trees"), "a higher glandularity")
        )
    pieces: list[NDArray[np.float64]] = []
    lobes = _lobes(points, spec.ducts.trees)
    for lobe, opening in zip(lobes, _openings(spec, shape, len(lobes)), strict=True):
        pieces += _tree(spec.ducts, opening, lobe[:each], random)
    return np.array(pieces, dtype=np.float32).reshape(-1, 8)


def _lobes(points: Float64, number: int) -> list[Float64]:
    """The points shared out among lobes whose middles lie as far from one another as they can."""
    middles = points[:1]
    for _ in range(number - 1):
        nearest = np.min(np.linalg.norm(points[:, None] - middles[None], axis=2), axis=1)
        middles = np.concatenate([middles, points[[np.argmax(nearest)]]])
    owner = np.argmin(np.linalg.norm(points[:, None] - middles[None], axis=2), axis=1)
    lobes = [points[owner == lobe] for lobe in range(number)]
    # Around the axis, so that the ducts of neighbouring openings do not cross.
    return sorted(lobes, key=lambda lobe: float(np.arctan2(lobe[:, 2].mean(), lobe[:, 1].mean())))


def _openings(spec: AnthropomorphicPhantom, shape: Outline, number: int) -> Float64:
    """Where the trees begin, (number, 3), mm: on a ring in the nipple, or under the skin at the foremost point."""
    depth = shape.axes[0] - spec.skin_mm
    ring = 0.5 * (spec.ducts.main_diameter_mm if spec.ducts else 0.0)
    if spec.nipple is not None:
        depth = shape.axes[0] + 0.8 * spec.nipple.height_mm
        ring = 0.35 * spec.nipple.diameter_mm
    angle = 2 * np.pi * (np.arange(number) + 0.5) / number - np.pi
    return np.stack([np.full(number, depth), ring * np.cos(angle), ring * np.sin(angle)], axis=1)


def _tree(spec: DuctSpec, opening: Float64, ends: Float64, random: np.random.Generator) -> list[Float64]:
    """The pieces (8,) of one tree."""
    growing = [_Branch(opening, ends.mean(axis=0) - opening, ends, 0)]
    pieces = []
    while growing:
        branch = growing.pop()
        last = len(branch.ends) <= 1 or branch.generation == spec.generations
        stop = branch.ends[0] if last else _fork(branch, random)
        path, leaving = _bent(branch.start, branch.heading, stop)
        radii = _radii(spec, branch.generation)
        pieces += [
            np.concatenate([path[n], radii[n : n + 1], path[n + 1], radii[n + 1 : n + 2]]) for n in range(_PIECES)
        ]
        if not last:
            axis = int(np.argmax(np.var(branch.ends, axis=0)))
            order = branch.ends[np.argsort(branch.ends[:, axis], kind="stable")]
            middle = len(order) // 2
            for half in (order[:middle], order[middle:]):
                growing.append(_Branch(stop, leaving, half, branch.generation + 1))
    return pieces


def _bent(start: Float64, heading: Float64, stop: Float64) -> tuple[Float64, Float64]:
    """Points (_PIECES + 1, 3) of a parabola that leaves ``start`` along ``heading``; its direction at ``stop``."""
    length = float(np.linalg.norm(stop - start))
    control = start + 0.4 * length * heading / max(float(np.linalg.norm(heading)), 1e-9)
    t = np.linspace(0.0, 1.0, _PIECES + 1)[:, None]
    return (1 - t) ** 2 * start + 2 * t * (1 - t) * control + t**2 * stop, stop - control


def _fork(branch: _Branch, random: np.random.Generator) -> Float64:
    way = branch.ends.mean(axis=0) - branch.start
    step = random.uniform(*_FORK) * way
    place: Float64 = branch.start + step + random.normal(0.0, _BEND * float(np.linalg.norm(step)), 3)
    return place


def _radii(spec: DuctSpec, generation: int) -> Float64:
    """Radii at the points of a branch, mm."""
    share = np.minimum(1.0, (generation + np.linspace(0.0, 1.0, _PIECES + 1)) / spec.generations)
    radii: Float64 = 0.5 * spec.main_diameter_mm ** (1 - share) * spec.terminal_diameter_mm**share
    return radii


_DUCT = np.uint8(Tissue.DUCT)
_REPLACED = np.zeros(MAX_TISSUES, np.bool_)
_REPLACED[[Tissue.ADIPOSE, Tissue.GLAND, Tissue.LIGAMENT, Tissue.NIPPLE]] = True


def carve(
    pieces: Float32, step: float, y0: float, z0: float, first_slice: int, labels: NDArray[np.uint8]
) -> NDArray[np.int64]:
    """Labels as duct what lies in a piece; skin and air stay.

    step: voxel edge; y0, z0: corner of the whole grid, of which ``labels`` (nz, ny, nx) begins at ``first_slice``.
    returns: (MAX_TISSUES,) voxels of each tissue that became duct.
    """
    replaced = np.zeros((labels.shape[0], MAX_TISSUES), np.int64)
    if len(pieces):
        _carve(pieces.astype(np.float64), step, y0, z0, first_slice, _REPLACED, labels, replaced)
    result: NDArray[np.int64] = replaced.sum(axis=0)
    return result


@njit(cache=True, parallel=True, error_model="numpy")
def _carve(pieces, step, y0, z0, first_slice, replaceable, labels, replaced):  # type: ignore[no-untyped-def]
    nz, ny, nx = labels.shape
    for k in prange(nz):
        z = z0 + (k + first_slice + 0.5) * step
        for n in range(len(pieces)):
            ax, ay, az, ar, bx, by, bz, br = pieces[n]
            reach = max(ar, br)
            if z < min(az, bz) - reach or z > max(az, bz) + reach:
                continue
            dx, dy, dz = bx - ax, by - ay, bz - az
            squared = max(dx * dx + dy * dy + dz * dz, 1e-12)
            j0 = max(0, int(np.floor((min(ay, by) - reach - y0) / step)))
            j1 = min(ny, int(np.ceil((max(ay, by) + reach - y0) / step)))
            i0 = max(0, int(np.floor((min(ax, bx) - reach) / step)))
            i1 = min(nx, int(np.ceil((max(ax, bx) + reach) / step)))
            for j in range(j0, j1):
                y = y0 + (j + 0.5) * step
                for i in range(i0, i1):
                    x = (i + 0.5) * step
                    along = ((x - ax) * dx + (y - ay) * dy + (z - az) * dz) / squared
                    along = min(1.0, max(0.0, along))
                    radius = ar + along * (br - ar)
                    off_x, off_y, off_z = x - ax - along * dx, y - ay - along * dy, z - az - along * dz
                    if (
                        off_x * off_x + off_y * off_y + off_z * off_z <= radius * radius
                        and replaceable[labels[k, j, i]]
                    ):
                        replaced[k, labels[k, j, i]] += 1
                        labels[k, j, i] = _DUCT
