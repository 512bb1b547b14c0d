"""Disks and beads put into a compressed breast: what a reconstruction makes of them.

Contrast and noise are measured in the breast that holds the objects. Spread and artefacts are measured on the objects
alone: line integrals add up and filtered back-projection is linear, so a projection of the objects in air, scaled to
the difference of attenuation that they make in fat, is exactly what they add to every slice.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from simcore import projection, reconstruction
from simcore.core.artifacts import Phantom, ProjectionStack, Volume
from simcore.core.grid import Point
from simcore.core.tissues import Tissue
from simcore.projection.spec import AcquisitionSpec, PhysicsSpec
from simcore.quality.contrast import disk_contrast
from simcore.quality.profiles import artefact_spread, distances, full_width_at_half_maximum, in_plane_profile
from simcore.reconstruction.spec import FilteredBackprojection

DISK_RADIUS, DISK_HEIGHT = 2.5, 3.0
BEAD_RADIUS = 0.5
DISKS, BEADS = 7, 4
APART_X = 6.0
"""Distance along x of any two objects, mm: shadows wander along y, so each has its rows of the volume to itself."""
FROM_SKIN, FROM_WALL = 10.0, 8.0
CUT = 9.0
"""Values within this distance of an object along x are looked at, mm."""
FAN = 20.0
"""Half width along y of what is looked at for artefacts, mm: the rays of 40 degrees stay within it over DEPTH."""
DEPTH = 30.0
"""Slices this far below and above the objects are reconstructed, mm."""
AWAY = 10.0
"""Slices at least this far from the objects hold nothing but artefacts of them, mm."""


@dataclass(frozen=True)
class Inserted:
    """One object: its tissue and centre in the support frame, mm."""

    tissue: Tissue
    centre: Point

    def inside(self, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether points lie in the object; arrays that broadcast."""
        cx, cy, cz = self.centre
        across = np.hypot(x - cx, y - cy)
        if self.tissue == Tissue.MASS:
            return np.asarray((across <= DISK_RADIUS) & (np.abs(z - cz) <= DISK_HEIGHT / 2))
        return np.asarray(np.hypot(across, z - cz) <= BEAD_RADIUS)


@dataclass(frozen=True)
class Outcome:
    """What one acquisition makes of the objects; means over the disks or beads, lengths in mm, attenuation in 1/mm.

    disk_contrast, background_noise, disk_cnr: in the breast, against the ring around each disk.
    disk_alone: contrast of the disks alone. disk_spread_mm, bead_spread_mm: width of the artefact spread function.
    bead_width_y_mm, bead_width_x_mm: of the bead in its own slice.
    bead_ghost: largest value of a bead's shadow AWAY or more from it, over the bead's value.
    disk_ghost: root mean square of a disk's shadow there, within the rows and the fan of its rays, over its value.
    section: float32 (slices, rows), one bead across y and z over its value: the beams that its shadow is made of.
    """

    angular_range: float
    views: int
    disk_contrast: float
    background_noise: float
    disk_cnr: float
    disk_alone: float
    disk_spread_mm: float
    bead_spread_mm: float
    bead_width_y_mm: float
    bead_width_x_mm: float
    bead_ghost: float
    disk_ghost: float
    section: NDArray[np.float32]

    def to_dict(self) -> dict[str, Any]:
        """Without the picture."""
        numbers = {k: v for k, v in asdict(self).items() if k != "section"}
        return {k: round(v, 5) if isinstance(v, float) else v for k, v in numbers.items()}


def choose(breast: Phantom) -> list[Inserted]:
    """Where objects go: in fat at mid height, in the widest places first, DISKS disks and then BEADS beads."""
    grid = breast.grid
    middle = (np.flatnonzero(breast.labels.any(axis=(1, 2)))[[0, -1]].mean() + 0.5) * grid.spacing[2] + grid.corner[2]
    planes = np.flatnonzero(np.abs(grid.centres("z") - middle) <= DISK_HEIGHT / 2)
    layer = breast.labels[planes[0] : planes[-1] + 1]
    room = distance_transform_edt(np.all(layer == Tissue.ADIPOSE, axis=0).astype(np.uint8)) * grid.spacing[0]
    no_skin = np.asarray(~np.isin(layer, (Tissue.AIR, Tissue.SKIN)).any(axis=0), np.uint8)
    x, y = grid.centres("x"), grid.centres("y")
    room[distance_transform_edt(no_skin) * grid.spacing[0] < FROM_SKIN] = 0.0
    room[:, x < FROM_WALL] = 0.0
    places: list[Inserted] = []
    while len(places) < DISKS + BEADS:
        row, column = np.unravel_index(int(np.argmax(room)), room.shape)
        needed = DISK_RADIUS + 0.5 if len(places) < DISKS else BEAD_RADIUS + 0.5
        if room[row, column] < needed:
            raise ValueError(f"only {len(places)} places in fat at mid height; {DISKS + BEADS} are needed")
        tissue = Tissue.MASS if len(places) < DISKS else Tissue.CALCIFICATION
        places.append(Inserted(tissue, (float(x[column]), float(y[row]), float(middle))))
        room[:, np.abs(x - x[column]) < APART_X] = 0.0
    return places


def inserted(breast: Phantom, objects: list[Inserted]) -> Phantom:
    """The breast with the objects."""
    return _painted(breast, breast.labels.copy(), objects)


def alone(breast: Phantom, objects: list[Inserted]) -> Phantom:
    """The objects in air, on the voxels of the breast."""
    return _painted(breast, np.zeros_like(breast.labels), objects)


def _painted(breast: Phantom, labels: NDArray[np.uint8], objects: list[Inserted]) -> Phantom:
    axes = [breast.grid.centres(axis) for axis in "zyx"]
    for thing in objects:
        near = [np.flatnonzero(np.abs(a - c) <= DISK_RADIUS + 1) for a, c in zip(axes, thing.centre[::-1], strict=True)]
        z, y, x = np.ix_(*(a[i] for a, i in zip(axes, near, strict=True)))
        block = labels[np.ix_(*near)]
        block[thing.inside(x, y, z)] = thing.tissue
        labels[np.ix_(*near)] = block
    return Phantom(labels, breast.grid)


def slab(stack: ProjectionStack, spec: FilteredBackprojection, low: float, high: float) -> Volume:
    """Slices between two heights, mm: as ``reconstruct`` gives them, but starting at ``low``, so that one is centred
    where it is wanted. For filters with a ramp, whose values do not depend on the thickness."""
    lifted = replace(stack, geometry=replace(stack.geometry, support_height=low))
    return reconstruction.reconstruct(lifted, spec, high - low)


def measure(breast: Phantom, objects: list[Inserted], acquisition: AcquisitionSpec, physics: PhysicsSpec) -> Outcome:
    """Projects and reconstructs the breast with the objects, and the objects alone."""
    z = objects[0].centre[2] + acquisition.air_gap_mm
    spec = FilteredBackprojection()
    own = slab(projection.project(inserted(breast, objects), acquisition, physics), spec, z - 0.5, z + 0.5)
    in_breast = [
        disk_contrast(attenuation(own)[0], own.grid, thing.centre[:2], DISK_RADIUS) for thing in _of(objects, "disk")
    ]
    stack = projection.project(alone(breast, objects), acquisition, physics)
    deep = slab(stack, spec, z - DEPTH - 0.5, z + DEPTH + 0.5)
    source = tuple(float(c) for c in stack.geometry.sources.mean(axis=0))
    mu = stack.report["mu_per_mm"]
    shadows = [_Shadow.of(deep, thing, z, mu, source) for thing in objects]  # type: ignore[arg-type]
    disks = [s for s in shadows if s.thing.tissue == Tissue.MASS]
    beads = [s for s in shadows if s.thing.tissue != Tissue.MASS]
    return Outcome(
        angular_range=acquisition.angular_range_degrees,
        views=acquisition.views,
        disk_contrast=_mean(c.difference for c in in_breast),
        background_noise=_mean(c.noise for c in in_breast),
        disk_cnr=_mean(c.cnr for c in in_breast),
        disk_alone=_mean(s.peak for s in disks),
        disk_spread_mm=_mean(s.spread() for s in disks),
        bead_spread_mm=_mean(s.spread() for s in beads),
        bead_width_y_mm=_mean(s.width("y") for s in beads),
        bead_width_x_mm=_mean(s.width("x") for s in beads),
        bead_ghost=_mean(float(np.abs(s.away()).max()) for s in beads),
        disk_ghost=_mean(float(np.sqrt((s.away() ** 2).mean())) for s in disks),
        section=beads[0].section(),
    )


@dataclass(frozen=True)
class _Shadow:
    """What one object alone adds to the slices around it, scaled to its contrast in fat."""

    thing: Inserted
    values: NDArray[np.float32]
    volume: Volume
    centre: Point
    source: Point
    peak: float

    @classmethod
    def of(cls, volume: Volume, thing: Inserted, z: float, mu: dict[str, float], source: Point) -> _Shadow:
        """The rows of the volume along y that belong to the object."""
        own = mu[thing.tissue.name.lower()]
        x, y, _ = thing.centre
        grid = volume.grid
        columns = np.abs(grid.centres("x") - x) < CUT
        first, count = int(np.argmax(columns)), int(columns.sum())
        cut = replace(volume, data=volume.data[:, :, first : first + count].copy(), grid=_columns(volume, first, count))
        values = attenuation(cut) * np.float32((own - mu["adipose"]) / own)
        near = distances(cut.grid, x, y) <= 0.8 * cls._radius(thing)
        middle = values[values.shape[0] // 2]
        return cls(thing, values, cut, (x, y, z), source, float(middle[near].mean()))

    @staticmethod
    def _radius(thing: Inserted) -> float:
        return DISK_RADIUS if thing.tissue == Tissue.MASS else BEAD_RADIUS

    def spread(self) -> float:
        """Full width at half maximum of the artefact spread function, mm."""
        ring = (DISK_RADIUS + 0.5, 2 * DISK_RADIUS)
        return full_width_at_half_maximum(
            *artefact_spread(
                self.values, self.volume.grid, self.centre, 0.6 * self._radius(self.thing), ring, self.source
            )
        )

    def width(self, axis: str) -> float:
        """Full width at half maximum in the object's own slice, mm."""
        return full_width_at_half_maximum(*in_plane_profile(self.values, self.volume.grid, self.centre, axis, 3.0, 2.0))

    def section(self) -> NDArray[np.float32]:
        """Values over the peak on the plane across x through the object, (slices, rows within FAN of it)."""
        grid = self.volume.grid
        rows = np.flatnonzero(np.abs(grid.centres("y") - self.centre[1]) <= FAN)
        columns = [int(np.argmin(np.abs(grid.centres("x") - x))) for x in self._followed()]
        picked = self.values[np.arange(len(columns))[:, None], rows, np.array(columns)[:, None]]
        return np.asarray(picked / np.float32(self.peak))

    def _followed(self) -> NDArray[np.float64]:
        """x of the shadow in every slice, mm."""
        heights = self.volume.grid.centres("z") - self.centre[2]
        return self.centre[0] * (1 - heights / (self.source[2] - self.centre[2]))

    def away(self) -> NDArray[np.float64]:
        """Values over the peak in the slices AWAY and farther, where rays through the object pass (any shape)."""
        grid = self.volume.grid
        heights = grid.centres("z") - self.centre[2]
        rows = np.abs(grid.centres("y") - self.centre[1]) <= FAN
        values = []
        for k in np.flatnonzero(np.abs(heights) >= AWAY):
            columns = np.abs(grid.centres("x") - self._followed()[k]) <= self._radius(self.thing)
            values.append((self.values[k][np.ix_(rows, columns)] / self.peak).ravel())
        return np.concatenate(values).astype(np.float64)


def _columns(volume: Volume, first: int, count: int) -> Any:
    nz, ny, _ = volume.grid.shape
    return replace(volume.grid.moved(x=first * volume.grid.spacing[0]), shape=(nz, ny, count))


def attenuation(volume: Volume) -> NDArray[np.float32]:
    """1/mm, as stored."""
    return np.float32(volume.slope) * volume.data + np.float32(volume.intercept)


def _of(objects: list[Inserted], kind: str) -> Iterator[Inserted]:
    return (thing for thing in objects if (thing.tissue == Tissue.MASS) == (kind == "disk"))


def _mean(numbers: Iterator[float]) -> float:
    return float(np.mean(list(numbers)))
