"""Bodies for the transport of photons: that of TG-195 case 3, blocks, and a breast of ellipsoids."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import Phantom
from simcore.core.geometry import AcquisitionGeometry, Detector
from simcore.core.grid import Grid
from simcore.core.tissues import Tissue
from simcore.physics.materials import Material, material, mixture
from simcore.physics.spectrum import Emission
from simcore.transport.cells import CARDS, LABELS, Cells
from simcore.transport.scene import Body, Plate, Setting, setting_of

VOLUMES_OF_INTEREST = ((50, 50, 0), (20, 0, 0), (50, 0, 0), (80, 0, 0), (50, -50, 0), (50, 0, -15), (50, 0, 15))
"""Of TG-195 case 3: centres (x, y, z), mm, z from the middle of the breast; 20 x 20 x 10 mm."""
MIX, SKIN, FIRST_VOLUME = 1, 2, 3


def arc(
    angles: list[float], distance: float = 660.0, pivot: float = 0.0, support: float = 15.0,
    field: tuple[int, int] = (260, 140),
) -> AcquisitionGeometry:  # fmt: skip
    """A tube that turns towards -y, over a detector of 1 mm pixels (rows, columns)."""
    radians = np.deg2rad(np.array(angles, np.float64))
    radius = distance - pivot
    sources = np.stack([0 * radians, -radius * np.sin(radians), pivot + radius * np.cos(radians)], axis=1)
    return AcquisitionGeometry(
        -np.rad2deg(radians), sources, Detector(*field, 1.0), np.zeros(len(angles)), pivot, distance, support
    )


def beam(energies_keV: Sequence[float], photons: Sequence[float] = (1.0,)) -> Emission:
    """Photons of a few energies."""
    return Emission(np.array(energies_keV), np.array(photons), False)


def tg195_setting() -> Setting:
    """Half a cylinder of 20 % gland by weight, 50 mm thick under 2 mm of skin, PMMA plates, water behind, air above.
    The seven volumes of interest have labels of their own, from FIRST_VOLUME on."""
    z, y, x = np.meshgrid(np.arange(50) - 24.5, np.arange(200) - 99.5, np.arange(100) + 0.5, indexing="ij")
    radius = np.hypot(x, y)
    labels = np.zeros(radius.shape, np.uint16)
    labels[radius < 100] = SKIN
    labels[(radius < 98) & (np.abs(z) < 23)] = MIX
    for number, (cx, cy, cz) in enumerate(VOLUMES_OF_INTEREST):
        labels[(np.abs(x - cx) < 10) & (np.abs(y - cy) < 10) & (np.abs(z - cz) < 5)] = FIRST_VOLUME + number
    mix = mixture("20 % gland", [(material("adipose"), 0.8), (material("gland"), 0.2)], density_g_cm3=0.952)
    tissues: list[Material | None] = [None, mix, material("skin"), *[mix] * len(VOLUMES_OF_INTEREST)]
    plates = [Plate(material("pmma"), 13.0, 15.0), Plate(material("pmma"), 65.0, 67.0)]
    return setting_of(
        pure_cells(labels, (0.0, -100.0, 15.0)), [*tissues, *[None] * (LABELS - len(tissues))], plates,
        Body(material("water"), 170.0), (140.0, 130.0), material("air"),
    )  # fmt: skip


def pure_cells(labels: NDArray[np.uint16], corner: tuple[float, float, float]) -> Cells:
    """Cells of 1 mm, each of one label."""
    hands = np.repeat(np.arange(LABELS, dtype=np.uint8)[:, None], CARDS, axis=1)
    upper = tuple(c + n for c, n in zip(corner, labels.shape[::-1], strict=True))
    return Cells(labels, hands, corner, (1.0, 1.0, 1.0), upper)  # type: ignore[arg-type]


def block_setting(substance: Material, size: tuple[float, float, float], bottom: float = 0.0) -> Setting:
    """A block (x, y, z) of one material on a support of nothing, its middle at y = 0, no body, no plates."""
    counts = tuple(round(edge) for edge in size[::-1])
    cells = pure_cells(np.ones(counts, np.uint16), (0.0, -size[1] / 2, bottom))
    return setting_of(cells, [None, substance, *[None] * (LABELS - 2)], [], None, (size[0], size[1] / 2))


def breast(thickness: float, voxel: float = 0.5, depth: float = 90.0, half: float = 95.0, seed: int = 3) -> Phantom:
    """A rounded half ellipse with 1.5 mm of skin and gland of ellipsoids, in the support frame."""
    counts = [round(extent / voxel) for extent in (thickness, 220.0, 100.0)]
    grid = Grid(tuple(counts), (voxel,) * 3, (0.0, -110.0, 0.0))  # type: ignore[arg-type]
    z, y, x = (grid.centres(axis).astype(np.float32) for axis in "zyx")
    z, y = z[:, None, None] - thickness / 2, y[:, None]
    radius = np.sqrt((x / depth) ** 2 + (y / half) ** 2)

    def inside(shrink: float) -> NDArray[np.bool_]:
        r = np.sqrt((x / (depth - shrink)) ** 2 + (y / (half - shrink)) ** 2)
        return np.abs(z) <= (thickness / 2 - shrink) * np.sqrt(np.clip(1 - r**5, 0, 1))

    labels = np.zeros(grid.shape, np.uint8)
    labels[inside(0.0) & (radius < 1)] = Tissue.SKIN
    inner = inside(1.5)
    labels[inner] = Tissue.ADIPOSE
    random = np.random.default_rng(seed)
    for _ in range(70):
        cx, cy, cz = random.uniform(15, 70), random.normal(0, 22), random.uniform(-0.25, 0.25) * thickness
        a, b, c = random.uniform(3, 13, 3)
        near = ((x - cx) / a) ** 2 + ((y - cy) / b) ** 2 + ((z - cz) / c * 1.4) ** 2 < 1
        labels[near & inner] = Tissue.GLAND
    return Phantom(labels, grid)


def pmma_plates(bottom: float, thickness: float) -> list[Plate]:
    """Support and paddle of 2 mm of PMMA under and on a breast."""
    pmma = material("pmma")
    return [Plate(pmma, bottom - 2.0, bottom), Plate(pmma, bottom + thickness, bottom + thickness + 2.0)]
