"""Transport of photons as nature does it, without any variance reduction: what the one of the product is compared with.

It shares the product's scene, tables and scattering, and nothing of its estimators: every photon starts isotropically,
flies to its next collision (Woodcock tracking), is absorbed or scattered there as a whole, and counts where it ends.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simcore.core.geometry import AcquisitionGeometry
from simcore.core.rng import stream
from simcore.kernels import njit, prange
from simcore.physics.spectrum import Emission
from simcore.transport import draws
from simcore.transport.cells import CARDS
from simcore.transport.collisions import (
    LEFT,
    STARTED,
    Screen,
    Tally,
    attenuated,
    left_behind,
    majorant,
    scattered,
    seen,
    turned,
    way_out,
)
from simcore.transport.compiled import inner
from simcore.transport.histories import Beam, Start
from simcore.transport.monte_carlo import BLOCKS, Sums
from simcore.transport.primary import groups_of, primary_maps
from simcore.transport.response import Response
from simcore.transport.scene import Scene, Setting, hand_at
from simcore.transport.tables import LOWEST_KEV, Tables, tables_of
from simcore.transport.views import beam_of, cell_sides, coarse_shape, field_of, screen_of, shares_of, start_of

Floats = NDArray[np.float64]


def simulate_analog(
    setting: Setting, geometry: AcquisitionGeometry, spectrum: Emission, response: Response, *, photons: int,
    grid_mm: float, seed: int,
) -> Sums:  # fmt: skip
    """As simcore.transport.monte_carlo.simulate, with ``photons`` photons a view that fly towards the detector."""
    shape = coarse_shape(geometry, grid_mm)
    beam = beam_of(setting, spectrum)
    shares = shares_of(spectrum)[spectrum.photons > 0]
    beam = beam._replace(cumulative=np.cumsum(shares))
    tables = tables_of(setting.materials, float(beam.energy[-1]), (), 1.0)
    views = range(geometry.views)
    screens = [screen_of(geometry, view, shape) for view in views]
    starts = [start_of(geometry, view, np.ones(shape), np.zeros(3)) for view in views]
    maps = primary_maps(setting, geometry, groups_of(spectrum, beam), screens, starts, response, shape)
    signal = np.zeros((len(views), BLOCKS, 2, *shape))
    deposit = np.zeros((len(views), BLOCKS, len(setting.materials)))
    depth = np.zeros((len(views), BLOCKS, len(setting.scene.cells)))
    energy = np.zeros((len(views), BLOCKS, 3))
    for view in views:
        key = np.uint64(stream(seed, "analog", view).integers(2**64, dtype=np.uint64))
        air = -1 if setting.air is None else setting.air
        _run(
            photons, key, setting.scene, beam, tables, starts[view], screens[view], response, air,
            signal[view], deposit[view], depth[view], energy[view],
        )  # fmt: skip
        per_photon = BLOCKS / photons * _solid_angle(geometry, view)
        for sums in (signal, deposit, depth, energy):
            sums[view] *= per_photon
    sides = cell_sides(geometry, shape)
    return Sums(
        signal / (sides[0] * sides[1]),
        deposit,
        depth,
        energy[..., STARTED],
        energy[..., LEFT],
        0 * energy[..., 0],
        maps,
    )


def _solid_angle(geometry: AcquisitionGeometry, view: int) -> float:
    """Of the detector, sr, by the midpoints of 400 x 400 parts."""
    first, rows, columns = field_of(geometry, view)
    share = (np.arange(400) + 0.5) / 400
    to = first + share[:, None, None] * rows + share[None, :, None] * columns - geometry.sources[view]
    area = np.linalg.norm(rows) * np.linalg.norm(columns)
    return float(np.mean(-(to @ geometry.normal(view)) / np.linalg.norm(to, axis=-1) ** 3) * area)


@njit(parallel=True, fastmath=True, error_model="numpy")
def _run(
    photons: int, key: np.uint64, scene: Scene, beam: Beam, tables: Tables, start: Start, screen: Screen,
    response: Response, air: int, signal: Floats, deposit: Floats, depth: Floats, energy: Floats,
) -> None:  # fmt: skip
    blocks = len(signal)
    for block in prange(blocks):
        tally = Tally(signal[block], deposit[block], depth[block], energy[block])
        for index in range(photons * block // blocks, photons * (block + 1) // blocks):
            _photon(index, key, scene, beam, tables, start, screen, response, air, tally)


@inner
def _direction(state: np.uint64, start: Start) -> tuple[np.uint64, float, float, float]:
    """Towards a point of the field, as often as its solid angle is large."""
    n = start.normal
    height = -(
        (start.first[0] - start.source[0]) * n[0]
        + (start.first[1] - start.source[1]) * n[1]
        + (start.first[2] - start.source[2]) * n[2]
    )
    while True:
        state, a = draws.uniform(state)
        state, b = draws.uniform(state)
        x = start.first[0] + a * start.rows[0] + b * start.columns[0] - start.source[0]
        y = start.first[1] + a * start.rows[1] + b * start.columns[1] - start.source[1]
        z = start.first[2] + a * start.rows[2] + b * start.columns[2] - start.source[2]
        length = math.sqrt(x * x + y * y + z * z)
        state, chance = draws.uniform(state)
        if chance < (height / length) ** 3:
            return state, x / length, y / length, z / length


@inner
def _photon(
    index: int, key: np.uint64, scene: Scene, beam: Beam, tables: Tables, start: Start, screen: Screen,
    response: Response, air: int, tally: Tally,
) -> None:  # fmt: skip
    state, u, v, w = _direction(draws.start(key, index), start)
    state, chance = draws.uniform(state)
    energy = beam.energy[min(len(beam.energy) - 1, np.searchsorted(beam.cumulative, chance))]
    tally.energy[STARTED] += energy
    x, y, z = start.source[0], start.source[1], start.source[2]
    way = (z - scene.high[2]) / -w
    order = 0
    if air >= 0:
        absorbed, scatter = attenuated(energy, air, tables)
        state, chance = draws.uniform(state)
        free = -math.log(chance) / (absorbed + scatter)
        if free < way:
            state, chance = draws.uniform(state)
            if chance * (absorbed + scatter) < absorbed:
                tally.deposit[air] += energy
                return
            x, y, z = x + u * free, y + v * free, z + w * free
            before = energy
            state, cosine, energy = scattered(state, energy, air, tables)
            tally.deposit[air] += before - energy
            state, u, v, w = turned(state, u, v, w, cosine)
            order = 1
            if w > -1e-3:
                tally.energy[LEFT] += energy
                return
            way = (z - scene.high[2]) / -w
    x, y, z = x + u * way, y + v * way, scene.high[2] - 1e-9
    if x < scene.low[0] or x > scene.high[0] or abs(y) > scene.high[1]:
        tally.energy[LEFT] += energy
        return
    _walk(state, x, y, z, u, v, w, energy, order, scene, tables, screen, response, tally)


@inner
def _walk(
    state: np.uint64, x: float, y: float, z: float, u: float, v: float, w: float, energy: float, order: int,
    scene: Scene, tables: Tables, screen: Screen, response: Response, tally: Tally,
) -> None:  # fmt: skip
    end = way_out(x, y, z, u, v, w, scene)
    while True:
        most = majorant(energy, tables)
        state, chance = draws.uniform(state)
        step = -math.log(chance) / most
        if step >= end:
            tally.energy[LEFT] += energy
            if order > 0 and w < 0 and z + w * end < scene.low[2] + 1e-6:
                seen(x, y, z, u, v, w, energy, 1.0, screen, response, tally)
            return
        x, y, z, end = x + u * step, y + v * step, z + w * step, end - step
        hand = hand_at(x, y, z, scene)
        if hand == 0:
            continue
        state, chance = draws.uniform(state)
        material = int(scene.hands[hand, int(chance * CARDS)])
        absorbed, scatter = attenuated(energy, material, tables)
        state, chance = draws.uniform(state)
        chance *= most
        if chance >= absorbed + scatter:
            continue
        if chance < absorbed:
            left_behind(z, material, energy, scene, tally)
            return
        before = energy
        state, cosine, energy = scattered(state, energy, material, tables)
        left_behind(z, material, before - energy, scene, tally)
        if energy < LOWEST_KEV:
            return
        state, u, v, w = turned(state, u, v, w, cosine)
        end = way_out(x, y, z, u, v, w, scene)
        order += 1
