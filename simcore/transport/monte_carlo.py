"""All views of one volume by Monte Carlo: raw signal of scatter and energy that is left behind, with their blocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.core.geometry import AcquisitionGeometry
from simcore.core.progress import Progress
from simcore.core.rng import stream
from simcore.physics.spectrum import Emission
from simcore.transport.collisions import LEFT, SHARED, STARTED
from simcore.transport.histories import Habits, run_histories
from simcore.transport.primary import PrimaryMaps, groups_of, primary_maps
from simcore.transport.response import Response
from simcore.transport.scene import Setting
from simcore.transport.tables import tables_of
from simcore.transport.views import area_of, beam_of, cell_sides, coarse_shape, screen_of, start_of

FloatArray = NDArray[np.float64]
BLOCKS = 64
"""Histories of a view are summed in so many blocks, each for itself and then in their order: results do not depend on
the number of threads, and the blocks tell the statistical error."""
HABITS = Habits(sites=8, roulette=0.8, upward=0.25)
DENSITY = 1.5
BESIDE = 0.5
"""Share of the rays that miss the breast which are followed: plates scatter less than tissue."""


@dataclass(frozen=True, eq=False)
class Sums:
    """Per photon and steradian that the source emits, block by block.

    signal:  float64 (views, blocks, 2, rows, columns): energy absorbed in the detector, keV / mm^2, and sum of its
             squares, keV^2 / mm^2.
    deposit: float64 (views, blocks, materials), keV. depth: (views, blocks, layers of cells), keV in tissue.
    started, left, shared: (views, blocks), keV: sent to the detector, gone from the zone, cut at the lowest energy.
    primary: maps without noise.
    """

    signal: FloatArray
    deposit: FloatArray
    depth: FloatArray
    started: FloatArray
    left: FloatArray
    shared: FloatArray
    primary: PrimaryMaps


def mean(blocks: FloatArray) -> FloatArray:
    """Mean over the blocks, axis 1."""
    return np.asarray(blocks.mean(axis=1))


def error(blocks: FloatArray) -> FloatArray:
    """Standard error of the mean over the blocks, axis 1."""
    return np.asarray(blocks.std(axis=1, ddof=1) / np.sqrt(blocks.shape[1]))


def simulate(
    setting: Setting,
    geometry: AcquisitionGeometry,
    spectrum: Emission,
    response: Response,
    *,
    rays: int,
    grid_mm: float,
    capped: tuple[int, ...],
    seed: int,
    purpose: str,
    progress: Progress,
    habits: Habits = HABITS,
) -> Sums:
    """Follows ``rays`` rays a view.

    capped: labels whose attenuation is limited on flights after a scatter (see tables_of).
    purpose: name of the stream of random numbers.
    """
    shape = coarse_shape(geometry, grid_mm)
    beam = beam_of(setting, spectrum)
    tables = tables_of(setting.materials, float(beam.energy[-1]), capped, DENSITY)
    everywhere = np.ones(shape)
    views = range(geometry.views)
    screens = [screen_of(geometry, view, shape) for view in views]
    starts = [start_of(geometry, view, everywhere, np.zeros(3)) for view in views]
    maps = primary_maps(setting, geometry, groups_of(spectrum, beam), screens, starts, response, shape)
    signal = np.zeros((len(views), BLOCKS, 2, *shape))
    deposit = np.zeros((len(views), BLOCKS, len(setting.materials)))
    depth = np.zeros((len(views), BLOCKS, len(setting.scene.cells)))
    energy = np.zeros((len(views), BLOCKS, 3))
    for view in views:
        progress(view / len(views), f"view {view + 1} of {len(views)}")
        random = stream(seed, "transport", purpose, view)
        kept = np.where(maps.shadow[view], 1.0, BESIDE if maps.shadow[view].any() else 1.0)
        start = start_of(geometry, view, kept, random.random(3))
        key = np.uint64(random.integers(2**64, dtype=np.uint64))
        run_histories(
            rays, key, setting.scene, setting.layers(geometry.sources[view][2]), beam, tables, start, screens[view],
            response, habits, signal[view], deposit[view], depth[view], energy[view],
        )  # fmt: skip
    per_photon = area_of(geometry) * BLOCKS / rays
    sides = cell_sides(geometry, shape)
    return Sums(
        signal=signal * (per_photon / (sides[0] * sides[1])),
        deposit=deposit * per_photon,
        depth=depth * per_photon,
        started=energy[..., STARTED] * per_photon,
        left=energy[..., LEFT] * per_photon,
        shared=energy[..., SHARED] * per_photon,
        primary=maps,
    )


def imbalance(sums: Sums) -> tuple[FloatArray, FloatArray]:
    """Energy that is sent out and neither absorbed nor gone, relative to what is sent out, and its standard error, of
    every view: 0 within statistics."""
    missing = sums.started - sums.left - sums.shared - sums.deposit.sum(axis=-1)
    return mean(missing) / mean(sums.started), error(missing) / mean(sums.started)
