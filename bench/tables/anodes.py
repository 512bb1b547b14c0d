"""Unfiltered spectra of the anodes, as SpekPy gives them at one target angle, and how they change beside the axis.

Continuum and lines stand apart: a line keeps its energy, the continuum is a mean over bins of 0.5 keV. Photons a cm2,
mAs and keV (continuum) or a cm2 and mAs (lines) at 1 m, without any filter, the air left out.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ANODES = ("W", "Mo", "Rh")
TARGET_ANGLE = 22.0
LOWEST_KV, HIGHEST_KV = 20, 49
BIN_KEV, STEPS_A_BIN, LOWEST_KEV = 0.5, 5, 1.0
TAKE_OFF_ANGLES = (3.0, 4.0, 5.0, 6.5, 8.0, 10.0, 13.0, 17.0, 22.0, 28.0, 36.0, 40.0)
KV_OF_ANGLES = (20, 28, 49)
PHYSICS = "casim"
LEAST_LINE = 1e-5


def anode_tables(path: Path) -> None:
    """Writes the table.

    continuum: (anode, kV, bin); lines: (anode, kV, line), line_keV: (anode, line), 0 where there is none;
    log_continuum, log_lines: natural logarithm of the ratio to the target angle, (anode, kV, angle, bin or line).
    """
    steps = BIN_KEV / STEPS_A_BIN
    bins = round((HIGHEST_KV - LOWEST_KEV) / BIN_KEV)
    kilovolts = range(LOWEST_KV, HIGHEST_KV + 1)
    whole = [[_parts(anode, kv, TARGET_ANGLE, steps, bins) for kv in kilovolts] for anode in ANODES]
    places = [_lines(rows[-1][1], steps) for rows in whole]
    most = max(len(groups) for groups in places)
    continuum = np.array([[_means(part) for part, _ in rows] for rows in whole])
    lines = np.array(
        [[_sums(part, groups, most) for _, part in rows] for rows, groups in zip(whole, places, strict=True)]
    )
    energies = LOWEST_KEV + steps * (np.arange(bins * STEPS_A_BIN) + 0.5)
    line_keV = np.array(
        [
            _sums(rows[-1][1] * energies, groups, most) / np.maximum(_sums(rows[-1][1], groups, most), 1e-300)
            for rows, groups in zip(whole, places, strict=True)
        ]
    )
    logs: tuple[list[FloatArray], list[FloatArray]] = ([], [])
    for anode, groups in zip(ANODES, places, strict=True):
        for kv in KV_OF_ANGLES:
            axis = _parts(anode, kv, TARGET_ANGLE, steps, bins)
            for angle in TAKE_OFF_ANGLES:
                beside = _parts(anode, kv, angle, steps, bins)
                logs[0].append(_log_ratio(_means(beside[0]), _means(axis[0])))
                logs[1].append(_log_ratio(_sums(beside[1], groups, most), _sums(axis[1], groups, most)))
    shape = (len(ANODES), len(KV_OF_ANGLES), len(TAKE_OFF_ANGLES), -1)
    np.savez_compressed(
        path,
        anodes=np.array(ANODES),
        kilovolts=np.array(kilovolts),
        bin_edges_keV=LOWEST_KEV + BIN_KEV * np.arange(bins + 1),
        continuum=continuum.astype(np.float32),
        line_keV=line_keV.astype(np.float32),
        lines=lines.astype(np.float32),
        target_angle=TARGET_ANGLE,
        angles=np.array(TAKE_OFF_ANGLES),
        angle_kilovolts=np.array(KV_OF_ANGLES),
        log_continuum=np.array(logs[0]).reshape(shape).astype(np.float16),
        log_lines=np.array(logs[1]).reshape(shape).astype(np.float16),
    )


@cache
def _parts(anode: str, kv: int, take_off: float, steps: float, bins: int) -> tuple[FloatArray, FloatArray]:
    """Continuum and lines over fine bins, photons a cm2, mAs and keV at 1 m; zeros above the tube voltage.

    SpekPy counts x from the anode to the cathode: a take-off angle below the target angle has x below 0.
    """
    import spekpy

    sideways = 100.0 * np.tan(np.deg2rad(take_off - TARGET_ANGLE))
    parts = []
    for kind in ({"char": False}, {"brem": False}):
        spectrum = spekpy.Spek(
            kvp=kv, th=TARGET_ANGLE, targ=anode, dk=steps, physics=PHYSICS, x=sideways, y=0.0, z=100.0, **kind
        )
        _, fluence = spectrum.get_spectrum()
        row = np.zeros(bins * STEPS_A_BIN)
        row[: len(fluence)] = fluence * (1 + (sideways / 100.0) ** 2)
        parts.append(row)
    return parts[0], parts[1]


def _means(fine: FloatArray) -> FloatArray:
    return fine.reshape(-1, STEPS_A_BIN).mean(axis=1)


def _lines(fine: FloatArray, steps: float) -> list[int]:
    """Bins that hold a line."""
    sums = fine.reshape(-1, STEPS_A_BIN).sum(axis=1) * steps
    return [int(row) for row in np.flatnonzero(sums > LEAST_LINE * sums.max())]


def _sums(fine: FloatArray, bins: list[int], length: int) -> FloatArray:
    """Photons of the lines in some bins, filled up with zeros to a length."""
    sums = fine.reshape(-1, STEPS_A_BIN).sum(axis=1)[bins] * BIN_KEV / STEPS_A_BIN
    return np.concatenate([sums, np.zeros(length - len(bins))])


def _log_ratio(part: FloatArray, whole: FloatArray) -> FloatArray:
    there = (whole > 0) & (part > 0)
    return np.where(there, np.log(np.where(there, part, 1.0) / np.where(there, whole, 1.0)), 0.0)
