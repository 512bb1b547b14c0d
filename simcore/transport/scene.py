"""What stands between source and detector: cells of tissue, plates, the body behind the chest wall."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simcore.physics.materials import Material
from simcore.transport.cells import CARDS, LABELS, Cells
from simcore.transport.compiled import inner

LAYER_MM = 2.0
"""Plates, and no thicker than this, are a step of the first flight."""
AIR_STEPS = 8
ANY = -1
MARGIN_MM = 10.0
BODY_MARGIN_MM = 20.0


@dataclass(frozen=True, eq=False)
class Plate:
    """A plate parallel to the breast support, between two heights above the detector at rest, mm."""

    material: Material
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Body:
    """What stands behind the chest wall, in x < 0, as high as the plates; depth: mm."""

    material: Material
    depth: float


class Scene(NamedTuple):
    """The zone in which photons are followed, in the detector frame (mm), vacuum around it.

    cells: uint16 (cz, cy, cx), hands of the cells. hands: uint8 (hands, CARDS), materials; hand 0 is air alone.
    corner, per_mm, upper: (x, y, z) of the cells: outer corner, cells a mm, where the tissue ends.
    low, high: (x, y, z), the zone.
    reach: of the plates along x and to both sides along y.
    plate_low, plate_high, plate_hand: the plates. body_hand: what fills x < 0.
    """

    cells: NDArray[np.uint16]
    hands: NDArray[np.uint8]
    corner: NDArray[np.float64]
    per_mm: NDArray[np.float64]
    upper: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    reach: NDArray[np.float64]
    plate_low: NDArray[np.float64]
    plate_high: NDArray[np.float64]
    plate_hand: NDArray[np.int64]
    body_hand: int


class Layers(NamedTuple):
    """Steps of the first flight, from above: top and thickness (mm), and the hand where it is the same everywhere in
    the step, ANY where it is that of the place."""

    top: NDArray[np.float64]
    thickness: NDArray[np.float64]
    hand: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Setting:
    """A scene with its materials by number (None: not used): labels 0 to 15, then those of plates, body and air path.

    plates: the numbers of the plates' materials; body: that of the body, air: that of the air above; None without.
    """

    scene: Scene
    materials: list[Material | None]
    plates: tuple[int, ...]
    body: int | None
    air: int | None
    cells: Cells

    def layers(self, source_height: float) -> Layers:
        """Steps of a first flight that begins at ``source_height`` mm."""
        scene = self.scene
        rows = [
            piece
            for low, high in zip(scene.plate_low, scene.plate_high, strict=True)
            for piece in _pieces(low, high, max(1, int(np.ceil((high - low) / LAYER_MM - 1e-9))), ANY)
        ]
        edges = np.minimum(scene.corner[2] + np.arange(len(scene.cells) + 1) / scene.per_mm[2], scene.upper[2])
        rows += [(high, high - low, ANY) for low, high in pairwise(edges)]
        if self.air is not None:
            air_hand = len(scene.hands) - 1
            rows += _pieces(scene.high[2], source_height, AIR_STEPS, air_hand)
        rows.sort(reverse=True)
        tops, thicknesses, hands = zip(*rows, strict=True)
        return Layers(np.array(tops), np.array(thicknesses), np.array(hands, np.int64))


def _pieces(low: float, high: float, count: int, hand: int) -> list[tuple[float, float, int]]:
    step = (high - low) / count
    return [(high - k * step, step, hand) for k in range(count)]


def setting_of(
    cells: Cells,
    tissues: Sequence[Material | None],
    plates: Sequence[Plate],
    body: Body | None,
    reach: tuple[float, float],
    air: Material | None = None,
) -> Setting:
    """A scene from its parts.

    tissues: the material of every label, LABELS of them. reach: of the plates, (x, to both sides along y), mm.
    air: what fills the way from the source to the uppermost plate; nothing where not given.
    """
    materials: list[Material | None] = [*tissues]
    hands = [np.zeros((1, CARDS), np.uint8), cells.hands]
    count = 1 + len(cells.hands)

    def added(material: Material) -> int:
        nonlocal count
        materials.append(material)
        hands.append(np.full((1, CARDS), len(materials) - 1, np.uint8))
        count += 1
        return count - 1

    plate_hands = np.array([added(plate.material) for plate in plates], np.int64)
    body_hand = 0 if body is None else added(body.material)
    if air is not None:
        added(air)
    edges = [z for plate in plates for z in (plate.low, plate.high)] + [cells.corner[2], cells.upper[2]]
    side = max(reach[1], cells.upper[1], -cells.corner[1]) + BODY_MARGIN_MM
    scene = Scene(
        cells=cells.index + np.uint16(1),
        hands=np.concatenate(hands),
        corner=np.array(cells.corner),
        per_mm=1 / np.array(cells.edge),
        upper=np.array(cells.upper),
        low=np.array([0.0 if body is None else -body.depth, -side, min(edges)]),
        high=np.array([max(reach[0], cells.upper[0]), side, max(edges)]),
        reach=np.array(reach),
        plate_low=np.array([plate.low for plate in plates], np.float64),
        plate_high=np.array([plate.high for plate in plates], np.float64),
        plate_hand=plate_hands,
        body_hand=body_hand,
    )
    first = LABELS + len(plates)
    return Setting(
        scene=scene,
        materials=materials,
        plates=tuple(range(LABELS, first)),
        body=None if body is None else first,
        air=None if air is None else len(materials) - 1,
        cells=cells,
    )


@inner
def hand_at(x: float, y: float, z: float, scene: Scene) -> int:
    """The hand of a point of the zone."""
    if x < 0.0:
        return scene.body_hand
    if z >= scene.corner[2] and z < scene.upper[2]:
        if x >= scene.upper[0] or y < scene.corner[1] or y >= scene.upper[1] or x < scene.corner[0]:
            return 0
        k = int((z - scene.corner[2]) * scene.per_mm[2])
        j = int((y - scene.corner[1]) * scene.per_mm[1])
        i = int((x - scene.corner[0]) * scene.per_mm[0])
        return int(scene.cells[k, j, i])
    if x < scene.reach[0] and abs(y) < scene.reach[1]:
        for plate in range(len(scene.plate_low)):
            if z >= scene.plate_low[plate] and z < scene.plate_high[plate]:
                return int(scene.plate_hand[plate])
    return 0
