"""What a photon that reaches the detector is worth: grid, then absorption."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simcore.transport.compiled import inner

FloatArray = NDArray[np.float64]
STEP_KEV = 0.5
COSINES = 64
TANGENTS = 48
STEEPEST = 4.0
"""Tangents of the grid's table end here: a photon as oblique as that counts as this one."""


@dataclass(frozen=True, eq=False)
class DetectorResponse:
    """Energy that the detector takes of a photon.

    energies_keV: (n,) ascending. cosines: (m,) ascending, of the angle to the detector's normal, within (0, 1].
    absorbed:     (n, m), mean absorbed energy over photon energy.
    squared:      (n, m), mean square of the same ratio; ``absorbed`` where not given: all of a photon or nothing.
    raises: ValueError for shapes that differ and values outside of 0 to 1.
    """

    energies_keV: FloatArray
    cosines: FloatArray
    absorbed: FloatArray
    squared: FloatArray | None = None

    def __post_init__(self) -> None:
        shape = (len(self.energies_keV), len(self.cosines))
        for name in ("absorbed", "squared"):
            table = getattr(self, name)
            if table is None:
                continue
            if table.shape != shape:
                raise ValueError(f"{name} has the shape {table.shape}; energies and cosines make it {shape}")
            if not (np.min(table) >= 0 and np.max(table) <= 1):
                raise ValueError(f"{name} = {np.min(table):g} .. {np.max(table):g} must lie within 0 and 1")


IDEAL = DetectorResponse(np.array([1.0]), np.array([1.0]), np.ones((1, 1)))
"""Takes the whole energy of every photon."""


@dataclass(frozen=True, eq=False)
class GridTransmission:
    """Share of the photons that an antiscatter grid lets through, by their direction against the strips.

    energies_keV: (n,). across, along: (a,), (b,) ascending tangents from 0 of the angle to the strips' own direction,
        across and along the strips.
    transmission: (n, a, b), 0 to 1.
    strips_along: the strips run along "y" (the chest wall, as in mammography) or "x".
    focus_mm:     height of the line that the strips point to, above the chest-wall edge of the detector (strips along
        y) or above its middle (along x); inf for parallel strips.
    """

    energies_keV: FloatArray
    across: FloatArray
    along: FloatArray
    transmission: FloatArray
    strips_along: Literal["x", "y"] = "y"
    focus_mm: float = np.inf

    def __post_init__(self) -> None:
        shape = (len(self.energies_keV), len(self.across), len(self.along))
        if self.transmission.shape != shape:
            raise ValueError(f"transmission has the shape {self.transmission.shape}; its axes make it {shape}")
        if not (np.min(self.transmission) >= 0 and np.max(self.transmission) <= 1):
            raise ValueError("transmission must lie within 0 and 1")
        if not self.focus_mm > 0:
            raise ValueError(f"focus_mm = {self.focus_mm:g} must be above 0")


class Response(NamedTuple):
    """Regular tables for the kernels.

    absorbed: float32 (energies, COSINES + 1, 2), from 0 keV in steps of STEP_KEV; ratio and mean square.
    grid:     float32 (energies, TANGENTS + 1, TANGENTS + 1), across and along; empty without a grid.
    across_x: whether "across" is along x; per_focus: 1 / focus_mm.
    """

    absorbed: NDArray[np.float32]
    grid: NDArray[np.float32]
    across_x: bool
    per_focus: float


def tabulated(response: DetectorResponse, grid: GridTransmission | None, highest_keV: float) -> Response:
    """Both tables resampled linearly; beyond their ends they stay as at the end."""
    energies = np.arange(0.0, highest_keV + 2 * STEP_KEV, STEP_KEV)
    cosines = np.linspace(0.0, 1.0, COSINES + 1)
    squared = response.absorbed if response.squared is None else response.squared
    absorbed = np.stack(
        [
            _along(_along(table, response.cosines, cosines, 1), response.energies_keV, energies, 0)
            for table in (response.absorbed, squared)
        ],
        axis=-1,
    )
    table = np.empty((0, 0, 0))
    if grid is not None:
        tangents = np.linspace(0.0, STEEPEST, TANGENTS + 1)
        table = _along(grid.transmission, grid.energies_keV, energies, 0)
        table = _along(_along(table, grid.across, tangents, 1), grid.along, tangents, 2)
    return Response(
        absorbed=np.ascontiguousarray(absorbed, np.float32),
        grid=np.ascontiguousarray(table, np.float32),
        across_x=grid is None or grid.strips_along == "y",
        per_focus=0.0 if grid is None else 1.0 / grid.focus_mm,
    )


def _along(table: FloatArray, old: FloatArray, new: FloatArray, axis: int) -> FloatArray:
    return np.apply_along_axis(lambda values: np.interp(new, old, values), axis, table)


@inner
def worth(
    energy: float, cosine: float, x: float, y: float, slope_x: float, slope_y: float, response: Response
) -> tuple[float, float]:
    """Mean of absorbed energy over photon energy, and of its square, of a photon at (x, y) mm on the detector that has
    moved by (slope_x, slope_y) for each mm towards it."""
    place = energy * (1 / STEP_KEV)
    row = int(place)
    rest = place - row
    column = int(cosine * COSINES + 0.5)
    low, high = response.absorbed[row, column], response.absorbed[row + 1, column]
    first = low[0] + rest * (high[0] - low[0])
    second = low[1] + rest * (high[1] - low[1])
    if response.grid.size > 0:
        through = _through(row, rest, x, y, slope_x, slope_y, response)
        first *= through
        second *= through
    return first, second


@inner
def _through(row: int, rest: float, x: float, y: float, slope_x: float, slope_y: float, response: Response) -> float:
    if response.across_x:
        across, along = slope_x - x * response.per_focus, slope_y
    else:
        across, along = slope_y - y * response.per_focus, slope_x
    scale = TANGENTS / STEEPEST
    a = min(abs(across) * scale, TANGENTS - 1e-6)
    b = min(abs(along) * scale, TANGENTS - 1e-6)
    i, j = int(a), int(b)
    a, b = a - i, b - j
    total = 0.0
    for step in range(2):
        table = response.grid[row + step]
        value = (1 - a) * ((1 - b) * table[i, j] + b * table[i, j + 1])
        value += a * ((1 - b) * table[i + 1, j] + b * table[i + 1, j + 1])
        total += value * (rest if step else 1 - rest)
    return total
