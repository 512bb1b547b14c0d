"""Primary signal on the coarse grid and where photons scatter, from a few rays a cell."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simcore.core.geometry import AcquisitionGeometry
from simcore.kernels import prange
from simcore.physics.spectrum import Emission
from simcore.transport.collisions import Screen
from simcore.transport.compiled import inner, outer
from simcore.transport.histories import Beam, Start
from simcore.transport.response import Response, worth
from simcore.transport.scene import ANY, Layers, Scene, Setting, hand_at
from simcore.transport.views import shares_of

FloatArray = NDArray[np.float64]
RAYS_PER_EDGE = 2
GROUPS = 12
SHADOW = 0.15
"""Optical thickness of tissue from which on a cell of the detector counts as the breast's shadow."""


class PrimaryMaps(NamedTuple):
    """float64 (views, rows, columns) each: primary signal, keV / mm^2 per photon and steradian; optical thickness of
    tissue and of plates at the mean energy; and whether a cell lies in the breast's shadow (bool)."""

    signal: FloatArray
    tissue: FloatArray
    plates: FloatArray
    shadow: NDArray[np.bool_]

    def of(self, view: int) -> PrimaryMaps:
        """Those of one view, with its axis."""
        one = slice(view, view + 1)
        return PrimaryMaps(self.signal[one], self.tissue[one], self.plates[one], self.shadow[one])


class Groups(NamedTuple):
    """The spectrum in a few groups: energy, share of the photons, attenuation (hands, groups) in 1/mm, the last group
    the mean energy."""

    energy: FloatArray
    share: FloatArray
    hand: FloatArray


def groups_of(spectrum: Emission, beam: Beam) -> Groups:
    """About GROUPS groups of equal numbers of photons, each at its mean energy."""
    shares = shares_of(spectrum)[spectrum.photons > 0]
    group = np.minimum(GROUPS - 1, (np.cumsum(shares) - shares / 2) * GROUPS).astype(np.int64)
    total = np.bincount(group, shares, GROUPS).astype(np.float64)
    energy = np.bincount(group, shares * beam.energy, GROUPS)
    used = total > 0
    sums = np.stack([np.bincount(group, shares * hand, GROUPS) for hand in beam.hand.T.astype(np.float64)])
    mean = beam.hand.T.astype(np.float64) @ shares
    return Groups(
        energy=energy[used] / total[used],
        share=total[used],
        hand=np.ascontiguousarray(np.column_stack([sums[:, used] / total[used], mean])),
    )


def primary_maps(
    setting: Setting, geometry: AcquisitionGeometry, groups: Groups, screens: list[Screen], starts: list[Start],
    response: Response, shape: tuple[int, int],
) -> PrimaryMaps:  # fmt: skip
    """Maps of all views from RAYS_PER_EDGE^2 rays a cell."""
    out = np.zeros((3, len(screens), *shape))
    plates = np.zeros(len(setting.scene.hands), np.bool_)
    plates[setting.scene.plate_hand] = True
    for view, (screen, start) in enumerate(zip(screens, starts, strict=True)):
        layers = setting.layers(geometry.sources[view][2])
        _cast(setting.scene, layers, groups, plates, screen, start, response, out[:, view])
    return PrimaryMaps(out[0], out[1], out[2], out[1] > SHADOW)


@outer
def _cast(
    scene: Scene, layers: Layers, groups: Groups, plates: NDArray[np.bool_], screen: Screen, start: Start,
    response: Response, out: FloatArray,
) -> None:  # fmt: skip
    rows, columns = out.shape[1:]
    for j in prange(rows):
        depth = np.empty(len(groups.energy) + 1)
        for i in range(columns):
            for ray in range(RAYS_PER_EDGE * RAYS_PER_EDGE):
                a = (j + (ray // RAYS_PER_EDGE + 0.5) / RAYS_PER_EDGE) / rows
                b = (i + (ray % RAYS_PER_EDGE + 0.5) / RAYS_PER_EDGE) / columns
                signal, tissue, plate = _ray(a, b, scene, layers, groups, plates, screen, start, response, depth)
                out[0, j, i] += signal / RAYS_PER_EDGE**2
                out[1, j, i] += tissue / RAYS_PER_EDGE**2
                out[2, j, i] += plate / RAYS_PER_EDGE**2


@inner
def _ray(
    a: float, b: float, scene: Scene, layers: Layers, groups: Groups, plates: NDArray[np.bool_], screen: Screen,
    start: Start, response: Response, depth: FloatArray,
) -> tuple[float, float, float]:  # fmt: skip
    """Signal, optical thickness of tissue and of plates of a ray to a point of the field."""
    sx, sy, sz = start.source
    dx = start.first[0] + a * start.rows[0] + b * start.columns[0] - sx
    dy = start.first[1] + a * start.rows[1] + b * start.columns[1] - sy
    dz = start.first[2] + a * start.rows[2] + b * start.columns[2] - sz
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    stretch = length / abs(dz)
    depth[:] = 0.0
    plate = 0.0
    last = len(depth) - 1
    for step in range(len(layers.top)):
        thickness = layers.thickness[step] * stretch
        z = layers.top[step] - 0.5 * layers.thickness[step]
        hand = layers.hand[step]
        if hand == ANY:
            share = (sz - z) / -dz
            hand = hand_at(sx + dx * share, sy + dy * share, z, scene)
        if hand > 0:
            for group in range(last + 1):
                depth[group] += groups.hand[hand, group] * thickness
            if plates[hand]:
                plate += groups.hand[hand, last] * thickness
    n, row, column = screen.normal, screen.row, screen.column
    cosine = -(dx * n[0] + dy * n[1] + dz * n[2]) / length
    slope_x = (dx * column[0] + dy * column[1] + dz * column[2]) / (length * cosine)
    slope_y = (dx * row[0] + dy * row[1] + dz * row[2]) / (length * cosine)
    x, y = (
        b * math.sqrt(start.columns[0] ** 2 + start.columns[1] ** 2 + start.columns[2] ** 2),
        (2 * a - 1) * screen.middle,
    )
    signal = 0.0
    for group in range(last):
        first, _ = worth(groups.energy[group], cosine, x, y, slope_x, slope_y, response)
        signal += groups.share[group] * groups.energy[group] * first * math.exp(-depth[group])
    return signal * cosine / (length * length), depth[last] - plate, plate
