"""Histories of photons by expected values: nothing that can be calculated on the way is left to chance.

First flight: a march through all steps from the uppermost plate to the support. At each step the photon is absorbed in
part and scattered in part; the absorbed part is counted, and a few places to scatter at are drawn from all steps by how
much of what is scattered there reaches the detector.

Every later flight goes from the scatter to the border of the zone at once, on points of Woodcock tracking (E. Woodcock
et al., ANL-7050, 1965). They serve four ends: the product of (1 - mu / M) is an unbiased transmission, scored at the
detector; every point counts the photo-absorption expected there; the sum of what is scattered is the weight that goes
on (implicit capture and forced collision); and one point is drawn as the next place of scattering. Russian roulette
ends photons that weigh less than is usual at their depth.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simcore.kernels import prange
from simcore.transport import draws
from simcore.transport.cells import CARDS
from simcore.transport.collisions import (
    LEFT,
    SHARED,
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
from simcore.transport.compiled import inner, outer
from simcore.transport.response import Response
from simcore.transport.scene import ANY, Layers, Scene, hand_at
from simcore.transport.tables import ABSORBED, LOWEST_KEV, SCATTERED, Tables

Floats = NDArray[np.float64]
KRONECKER = (0.8191725133961645, 0.6710436067037893, 0.5497004779019703)
"""Powers of 1 / 1.2207..., the root of x^4 = x + 1: points of low discrepancy in three dimensions."""


class Beam(NamedTuple):
    """The spectrum of a view, and how histories are drawn from it.

    energy: keV. cumulative: of the drawing, which favours energies that get through; weight: corrects for it.
    attenuation: float32 (energies, materials, 2), 1/mm. hand: float32 (energies, hands), mean of a hand's cards, 1/mm.
    decay: 1/mm, how a photon's usual weight falls with depth.
    """

    energy: Floats
    cumulative: Floats
    weight: Floats
    attenuation: NDArray[np.float32]
    hand: NDArray[np.float32]
    decay: Floats


class Start(NamedTuple):
    """Where rays of a view go: from the source to points of the detector's surface.

    source: mm. first, rows, columns: corner of the field and its two edges as vectors, mm. normal: of the field.
    kept: float64 (rows, columns), share of the rays towards each part of the field that are followed; they weigh more.
    shift: (3,) of the sequence.
    """

    source: Floats
    first: Floats
    rows: Floats
    columns: Floats
    normal: Floats
    kept: Floats
    shift: Floats


class Habits(NamedTuple):
    """Variance reduction. sites: places to scatter at, a ray. roulette: the weight, in shares of the usual one, below
    which photons are ended by chance. upward: share of the photons on their way up that are followed."""

    sites: int
    roulette: float
    upward: float


class Scratch(NamedTuple):
    """Of the steps of a first flight: sum of what was scattered so far, how far along the ray, material, importance."""

    sum: Floats
    distance: Floats
    material: NDArray[np.int64]
    importance: Floats


@outer
def run_histories(
    rays: int, key: np.uint64, scene: Scene, layers: Layers, beam: Beam, tables: Tables, start: Start, screen: Screen,
    response: Response, habits: Habits, signal: Floats, deposit: Floats, depth: Floats, energy: Floats,
) -> None:  # fmt: skip
    """Follows ``rays`` rays; the sums of block b stand in signal[b], deposit[b], depth[b], energy[b] (see Tally).

    Rays weigh cos / r^2 of their points of the field: times area / rays the sums are per photon and steradian.
    """
    blocks = len(signal)
    steps = len(layers.top)
    for block in prange(blocks):
        tally = Tally(signal[block], deposit[block], depth[block], energy[block])
        scratch = Scratch(np.empty(steps), np.empty(steps), np.empty(steps, np.int64), np.empty(steps))
        for index in range(rays * block // blocks, rays * (block + 1) // blocks):
            _history(index, key, scene, layers, beam, tables, start, screen, response, habits, scratch, tally)


@inner
def _history(
    index: int, key: np.uint64, scene: Scene, layers: Layers, beam: Beam, tables: Tables, start: Start, screen: Screen,
    response: Response, habits: Habits, scratch: Scratch, tally: Tally,
) -> None:  # fmt: skip
    state = draws.start(key, index)
    a = (index * KRONECKER[0] + start.shift[0]) % 1.0
    b = (index * KRONECKER[1] + start.shift[1]) % 1.0
    c = (index * KRONECKER[2] + start.shift[2]) % 1.0
    kept = start.kept[int(a * start.kept.shape[0]), int(b * start.kept.shape[1])]
    state, u = draws.uniform(state)
    if u > kept:
        return
    dx = start.first[0] + a * start.rows[0] + b * start.columns[0] - start.source[0]
    dy = start.first[1] + a * start.rows[1] + b * start.columns[1] - start.source[1]
    dz = start.first[2] + a * start.rows[2] + b * start.columns[2] - start.source[2]
    per_length = 1 / math.sqrt(dx * dx + dy * dy + dz * dz)
    dx, dy, dz = dx * per_length, dy * per_length, dz * per_length
    n = start.normal
    line = min(len(beam.energy) - 1, np.searchsorted(beam.cumulative, c))
    weight = -(dx * n[0] + dy * n[1] + dz * n[2]) * per_length * per_length / kept * beam.weight[line]
    tally.energy[STARTED] += weight * beam.energy[line]
    if dz > -1e-6:
        tally.energy[LEFT] += weight * beam.energy[line]
        return
    state, total = _march(state, line, weight, dx, dy, dz, scene, layers, beam, start, scratch, tally)
    if total > 0.0:
        _sites(
            state,
            line,
            weight * total,
            dx,
            dy,
            dz,
            scene,
            layers,
            beam,
            tables,
            start,
            screen,
            response,
            habits,
            scratch,
            tally,
        )


@inner
def _march(
    state: np.uint64, line: int, weight: float, u: float, v: float, w: float, scene: Scene, layers: Layers, beam: Beam,
    start: Start, scratch: Scratch, tally: Tally,
) -> tuple[np.uint64, float]:  # fmt: skip
    """Counts what is absorbed on the first flight; returns the state and the sum of what is scattered, of a weight of
    1, in units of importance. Every step has one point, which follows the cells: longer steps miss thin skin."""
    energy, decay = beam.energy[line], beam.decay[line]
    state, place = draws.uniform(state)
    state, card_start = draws.uniform(state)
    card = int(card_start * CARDS)
    sx, sy, sz = start.source
    transmission, total = 1.0, 0.0
    for step in range(len(layers.top)):
        thickness = layers.thickness[step]
        z = layers.top[step] - place * thickness
        distance = (z - sz) / w
        hand = layers.hand[step]
        if hand == ANY:
            x, y = sx + u * distance, sy + v * distance
            inside = x >= scene.low[0] and x < scene.high[0] and abs(y) < scene.high[1]
            hand = hand_at(x, y, z, scene) if inside else 0
        card = card + 4 if card < CARDS - 4 else card + 4 - CARDS
        material = int(scene.hands[hand, card])
        mu = beam.hand[line, hand]
        importance = math.exp(decay * (scene.high[2] - z)) if z < scene.high[2] else 1.0
        if mu > 0.0:
            passed = math.exp(mu * thickness / w)
            fluence = transmission * (1 - passed) / mu
            transmission *= passed
            part = beam.attenuation[line, material]
            left_behind(z, material, weight * energy * fluence * part[ABSORBED], scene, tally)
            total += fluence * part[SCATTERED] * importance
        scratch.sum[step] = total
        scratch.distance[step] = distance
        scratch.material[step] = material
        scratch.importance[step] = importance
    tally.energy[LEFT] += weight * energy * transmission
    return state, total


@inner
def _sites(
    state: np.uint64, line: int, weight: float, u: float, v: float, w: float, scene: Scene, layers: Layers, beam: Beam,
    tables: Tables, start: Start, screen: Screen, response: Response,
    habits: Habits, scratch: Scratch, tally: Tally,
) -> None:  # fmt: skip
    """Scatters a ray at some of its steps, drawn systematically by their importance."""
    state, place = draws.uniform(state)
    last = len(layers.top) - 1
    usual = weight / habits.sites
    step = 0
    for site in range(habits.sites):
        target = (site + place) / habits.sites * scratch.sum[last]
        while step < last and scratch.sum[step] < target:
            step += 1
        distance = scratch.distance[step]
        x, y, z = start.source[0] + u * distance, start.source[1] + v * distance, start.source[2] + w * distance
        state = _follow(
            state, x, y, z, u, v, w, beam.energy[line], usual / scratch.importance[step], scratch.material[step],
            usual, beam.decay[line], scene, tables, screen, response, habits, tally,
        )  # fmt: skip


@inner
def _follow(
    state: np.uint64, x: float, y: float, z: float, u: float, v: float, w: float, energy: float, weight: float,
    material: int, usual: float, decay: float, scene: Scene, tables: Tables, screen: Screen, response: Response,
    habits: Habits, tally: Tally,
) -> np.uint64:  # fmt: skip
    """A photon from its first scatter, at (x, y, z) in a material, to its end."""
    while True:
        before = energy
        state, cosine, energy = scattered(state, energy, material, tables)
        left_behind(z, material, weight * (before - energy), scene, tally)
        state, u, v, w = turned(state, u, v, w, cosine)
        if energy < LOWEST_KEV:
            tally.energy[SHARED] += weight * energy
            return state
        if w > 0.0:
            state, chance = draws.uniform(state)
            if chance > habits.upward:
                return state
            weight /= habits.upward
        if z >= scene.high[2]:  # scattered in the air above
            distance = (scene.high[2] - z) / w if w < -1e-3 else 0.0
            x, y, z = x + u * distance, y + v * distance, scene.high[2] - 1e-9
            outside = x < scene.low[0] or x > scene.high[0] or abs(y) > scene.high[1]
            if w >= -1e-3 or outside:
                tally.energy[LEFT] += weight * energy
                return state
        end = way_out(x, y, z, u, v, w, scene)
        state, transmission, share, distance, material = _flight(
            state, x, y, z, u, v, w, energy, weight, end, scene, tables, tally
        )
        tally.energy[LEFT] += weight * transmission * energy
        if w < 0.0 and z + w * end < scene.low[2] + 1e-6:
            seen(x, y, z, u, v, w, energy, weight * transmission, screen, response, tally)
        if share <= 0.0:
            return state
        x, y, z = x + u * distance, y + v * distance, z + w * distance
        weight *= share
        least = habits.roulette * usual * math.exp(-decay * (scene.high[2] - z))
        if weight < least:
            state, chance = draws.uniform(state)
            if chance * least > weight:
                return state
            weight = least


@inner
def _flight(
    state: np.uint64, x: float, y: float, z: float, u: float, v: float, w: float, energy: float, weight: float,
    end: float, scene: Scene, tables: Tables, tally: Tally,
) -> tuple[np.uint64, float, float, float, int]:  # fmt: skip
    """State, transmission to the border, share that is scattered, and a place of scattering: distance and material."""
    step = 1 / majorant(energy, tables)
    distance, transmission, share = 0.0, 1.0, 0.0
    chosen, material_there = 0.0, 0
    while True:
        state, chance = draws.uniform(state)
        distance -= math.log(chance) * step
        if distance >= end:
            break
        hand = hand_at(x + u * distance, y + v * distance, z + w * distance, scene)
        if hand == 0:
            continue
        state, chance = draws.uniform(state)
        place = chance * CARDS
        card = int(place)
        material = int(scene.hands[hand, card])
        absorbed, scatter = attenuated(energy, material, tables)
        left_behind(z + w * distance, material, weight * energy * transmission * absorbed * step, scene, tally)
        part = transmission * scatter * step
        share += part
        if (place - card) * share < part:
            chosen, material_there = distance, material
        transmission *= 1 - (absorbed + scatter) * step
    return state, transmission, share, chosen, material_there
