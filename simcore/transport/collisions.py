"""One photon: where it is, how it scatters, what it leaves behind."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simcore.transport import draws
from simcore.transport.cells import LABELS
from simcore.transport.compiled import inner
from simcore.transport.response import Response, worth
from simcore.transport.scene import Scene
from simcore.transport.tables import (
    ABSORBED,
    COHERENT,
    INCOHERENT,
    LOWEST_KEV,
    QUANTILES,
    SCATTERED,
    STEP_KEV,
    Tables,
)

PER_ELECTRON = 1 / 510.99895
ALONG_Z = 0.99999
LEVEL = 1e-9
STARTED, LEFT, SHARED = 0, 1, 2

Vector = NDArray[np.float64]


class Screen(NamedTuple):
    """The detector of one view as it counts scatter: a coarse grid of its surface.

    origin: corner of the cell [0, 0], mm. row, column: unit vectors of the row and the column index. normal: towards
    the source. per_mm: cells a mm along rows and columns. middle: of the rows, mm from the corner.
    """

    origin: Vector
    row: Vector
    column: Vector
    normal: Vector
    per_mm: Vector
    middle: float


class Tally(NamedTuple):
    """Sums of a block of histories.

    signal: float64 (2, rows, columns), absorbed energy (keV) and its square.
    deposit: float64 (materials,), keV. depth: float64 (layers of cells,), keV in tissue.
    energy: float64 (3,), keV: STARTED, LEFT the zone, SHARED among no material (below the lowest energy).
    """

    signal: NDArray[np.float64]
    deposit: NDArray[np.float64]
    depth: NDArray[np.float64]
    energy: NDArray[np.float64]


@inner
def attenuated(energy: float, material: int, tables: Tables) -> tuple[float, float]:
    """Photo-absorption and scattering, 1/mm."""
    place = (energy - LOWEST_KEV) * (1 / STEP_KEV)
    row = int(place)
    rest = place - row
    low, high = tables.attenuation[row, material], tables.attenuation[row + 1, material]
    absorbed = low[ABSORBED] + rest * (high[ABSORBED] - low[ABSORBED])
    scattered = low[SCATTERED] + rest * (high[SCATTERED] - low[SCATTERED])
    return absorbed, scattered


@inner
def majorant(energy: float, tables: Tables) -> float:
    """1/mm"""
    place = (energy - LOWEST_KEV) * (1 / STEP_KEV)
    row = int(place)
    return float(tables.majorant[row] + (place - row) * (tables.majorant[row + 1] - tables.majorant[row]))


@inner
def scattered(state: np.uint64, energy: float, material: int, tables: Tables) -> tuple[np.uint64, float, float]:
    """State, cosine of the angle and energy after coherent or incoherent scattering."""
    row = int((energy - LOWEST_KEV) * (1 / STEP_KEV))
    state, u = draws.uniform(state)
    kind = COHERENT if u < tables.coherent[row, material] else INCOHERENT
    state, u = draws.uniform(state)
    quantiles = tables.cosines[kind, int(energy + u), material]  # of one of the two energies beside, by chance
    state, u = draws.uniform(state)
    place = u * QUANTILES
    below = int(place)
    cosine = quantiles[below] + (place - below) * (quantiles[below + 1] - quantiles[below])
    after = energy if kind == COHERENT else energy / (1 + energy * PER_ELECTRON * (1 - cosine))
    return state, cosine, after


@inner
def turned(state: np.uint64, u: float, v: float, w: float, cosine: float) -> tuple[np.uint64, float, float, float]:
    """State and the direction at an angle to (u, v, w), turned about it by chance."""
    state, azimuth = draws.uniform(state)
    azimuth *= 2 * math.pi
    sine = math.sqrt(max(0.0, 1 - cosine * cosine))
    a, b = sine * math.cos(azimuth), sine * math.sin(azimuth)
    if abs(w) > ALONG_Z:
        return state, a, b, cosine * (1.0 if w > 0 else -1.0)
    across = math.sqrt(1 - w * w)
    x = (u * w * a - v * b) / across + u * cosine
    y = (v * w * a + u * b) / across + v * cosine
    z = -a * across + w * cosine
    length = 1 / math.sqrt(x * x + y * y + z * z)
    return state, x * length, y * length, z * length


@inner
def way_out(x: float, y: float, z: float, u: float, v: float, w: float, scene: Scene) -> float:
    """Distance to the border of the zone, mm."""
    end = (scene.low[2] - z) / w if w < 0 else (scene.high[2] - z) / max(w, LEVEL)
    if u < 0:
        end = min(end, (scene.low[0] - x) / u)
    elif u > 0:
        end = min(end, (scene.high[0] - x) / u)
    if v < 0:
        end = min(end, (scene.low[1] - y) / v)
    elif v > 0:
        end = min(end, (scene.high[1] - y) / v)
    return float(end)


@inner
def left_behind(z: float, material: int, energy: float, scene: Scene, tally: Tally) -> None:
    """Counts energy that is absorbed at a height z in a material."""
    tally.deposit[material] += energy
    if material < LABELS:
        tally.depth[min(len(tally.depth) - 1, int((z - scene.corner[2]) * scene.per_mm[2]))] += energy


@inner
def seen(
    x: float, y: float, z: float, u: float, v: float, w: float, energy: float, weight: float, screen: Screen,
    response: Response, tally: Tally,
) -> None:  # fmt: skip
    """Counts what arrives at the detector of a photon that is on its way down, free from here."""
    n, o, row, column = screen.normal, screen.origin, screen.row, screen.column
    cosine = -(u * n[0] + v * n[1] + w * n[2])
    if cosine < LEVEL:
        return
    distance = ((x - o[0]) * n[0] + (y - o[1]) * n[1] + (z - o[2]) * n[2]) / cosine
    dx, dy, dz = x + u * distance - o[0], y + v * distance - o[1], z + w * distance - o[2]
    along_column = dx * column[0] + dy * column[1] + dz * column[2]
    along_row = dx * row[0] + dy * row[1] + dz * row[2]
    i, j = along_column * screen.per_mm[1], along_row * screen.per_mm[0]
    if i >= 0 and j >= 0 and i < tally.signal.shape[2] and j < tally.signal.shape[1]:
        slope_x = (u * column[0] + v * column[1] + w * column[2]) / cosine
        slope_y = (u * row[0] + v * row[1] + w * row[2]) / cosine
        first, second = worth(energy, cosine, along_column, along_row - screen.middle, slope_x, slope_y, response)
        tally.signal[0, int(j), int(i)] += weight * energy * first
        tally.signal[1, int(j), int(i)] += weight * energy * energy * second
