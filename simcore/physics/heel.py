"""The heel effect: beside the central ray the beam crosses more or less of the anode, and its filters at a slant."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simcore.physics.attenuation import attenuation
from simcore.physics.materials import material
from simcore.physics.spec import TubeSpec
from simcore.physics.spectrum import LEAST_SHARE, Emission, air_kerma, emission, through_filters, unfiltered
from simcore.physics.tables import arrays

FloatArray = NDArray[np.float64]
TARGET_DEGREES = 22.0
"""Of the tables; usual for mammography with its tilt."""
SLANTS = 4
ONE_METRE_MM = 1000.0


def take_off_angle(target_degrees: float, towards_anode: ArrayLike, sideways: ArrayLike) -> FloatArray:
    """Angle between photons and the surface of the anode, degrees.

    target_degrees: angle between that surface and the central ray.
    towards_anode, sideways: distance from the central ray over the distance along it, 1, broadcast; the anode stands
    on the nipple's side.
    """
    target = np.deg2rad(target_degrees)
    sine = (np.sin(target) - np.cos(target) * np.asarray(towards_anode)) / slant(towards_anode, sideways)
    return np.asarray(np.rad2deg(np.arcsin(np.clip(sine, -1.0, 1.0))))


def slant(towards_anode: ArrayLike, sideways: ArrayLike) -> FloatArray:
    """Path through a layer across the central ray over its thickness, 1; arguments as of ``take_off_angle``."""
    return np.asarray(np.sqrt(1 + np.square(towards_anode) + np.square(sideways)))


def emission_beside(
    tube: TubeSpec,
    air_mm: float,
    towards_anode: float,
    sideways: float,
    target_degrees: float = TARGET_DEGREES,
) -> Emission:
    """The spectrum of a tube behind its filters and air on a ray beside the central one, a steradian.

    air_mm: along the central ray; other arguments as of ``take_off_angle``. A measured spectrum stays as it is.
    raises: ValueError for an angle to the anode that the tables lack.
    """
    if tube.measured is not None:
        return emission(tube, air_mm)
    angle = float(take_off_angle(target_degrees, towards_anode, sideways))
    return _emission_at(tube, air_mm, angle, float(slant(towards_anode, sideways)))


def heel_factor(
    tube: TubeSpec,
    air_mm: float,
    towards_anode: ArrayLike,
    sideways: ArrayLike,
    target_degrees: float = TARGET_DEGREES,
) -> FloatArray:
    """Air kerma beside the central ray over that on it, at the same distance from the focal spot, 1.

    Arguments as of ``emission_beside``, arrays broadcast; returns: their common shape. 1 for a measured spectrum.
    raises: ValueError for angles to the anode that the tables lack.
    """
    along, across = np.broadcast_arrays(np.asarray(towards_anode, np.float64), np.asarray(sideways, np.float64))
    if along.size == 0 or tube.measured is not None:
        return np.ones(along.shape)
    angles, slants = take_off_angle(target_degrees, along, across), slant(along, across)
    knots = np.asarray(arrays("anodes")["angles"], np.float64)[::-1]
    _check(np.append(angles, target_degrees))
    steps = np.linspace(1.0, max(float(slants.max()), 1.0 + 1e-6), SLANTS)
    logs = np.array([[_log_kerma(tube, air_mm, float(knot), float(step)) for knot in knots] for step in steps])
    paths = _paths(knots)
    place = np.minimum(((slants - 1.0) / (steps[1] - steps[0])).astype(np.int64), SLANTS - 2)
    share = (slants - steps[place]) / (steps[1] - steps[0])
    rows = np.array([np.interp(_paths(angles), paths, row) for row in logs])
    below, above = (np.take_along_axis(rows, (place + step)[None], axis=0)[0] for step in (0, 1))
    axis = _log_kerma(tube, air_mm, target_degrees, 1.0)
    return np.asarray(np.exp((1 - share) * below + share * above - axis))


def _emission_at(tube: TubeSpec, air_mm: float, angle: float, factor: float) -> Emission:
    energies, photons = unfiltered(tube.anode, tube.kVp)
    air = np.exp(-attenuation(material("air"), energies) * air_mm * factor)
    photons = photons * _anode_ratio(tube.anode, tube.kVp, angle, energies) * air
    photons = photons * through_filters(tube, energies, factor)
    strong = photons > LEAST_SHARE * photons.max()
    return Emission(energies[strong], photons[strong], True)


def _log_kerma(tube: TubeSpec, air_mm: float, angle: float, factor: float) -> float:
    beam = _emission_at(tube, air_mm, angle, factor)
    return float(np.log(air_kerma(beam.energies_keV, beam.photons, ONE_METRE_MM)))


def _anode_ratio(anode: str, kVp: float, angle: float, energies: FloatArray) -> FloatArray:
    """Photons at an angle to the anode over those at the target angle of the tables, at energies of ``unfiltered``."""
    _check(np.array([angle]))
    table = arrays("anodes")
    row = [str(name) for name in table["anodes"]].index(anode)
    volts = np.asarray(table["angle_kilovolts"], np.float64)
    edges = np.asarray(table["bin_edges_keV"], np.float64)
    middles, lines = (edges[1:] + edges[:-1]) / 2, np.asarray(table["line_keV"], np.float64)[row]
    parts = []
    for name, places in (("log_continuum", middles), ("log_lines", lines)):
        logs = np.asarray(table[name], np.float64)[row].copy()
        for step in range(len(volts) - 2, -1, -1):
            logs[step][:, places > volts[step]] = logs[step + 1][:, places > volts[step]]
            logs[step][:, ~logs[step].any(axis=0)] = logs[step + 1][:, ~logs[step].any(axis=0)]
        parts.append(logs)
    logs = np.concatenate(parts, axis=2)
    paths = _paths(np.asarray(table["angles"], np.float64)[::-1])
    place, share = _between(paths, float(_paths(np.array([angle]))[0]))
    at_angle = (1 - share) * logs[:, ::-1][:, place] + share * logs[:, ::-1][:, place + 1]
    step, weight = _between(volts, kVp)
    ratios = np.exp((1 - weight) * at_angle[step] + weight * at_angle[step + 1])
    places = np.concatenate([middles, lines])
    order = np.argsort(places, kind="stable")
    return np.asarray(ratios[order][np.searchsorted(places[order], energies)])


def _between(knots: FloatArray, value: float) -> tuple[int, float]:
    """The knot below a value, and its share of the way to the next."""
    place = min(max(int(np.searchsorted(knots, value)) - 1, 0), len(knots) - 2)
    return place, (value - knots[place]) / (knots[place + 1] - knots[place])


def _paths(angles: FloatArray) -> FloatArray:
    """Path in the anode over the depth of a photon's origin: what its attenuation goes with."""
    return np.asarray(1 / np.sin(np.deg2rad(angles)))


def _check(angles: FloatArray) -> None:
    knots = np.asarray(arrays("anodes")["angles"], np.float64)
    if not (angles.min() >= knots[0] and angles.max() <= knots[-1]):
        raise ValueError(
            f"photons leave the anode at {angles.min():.3g} to {angles.max():.3g} degrees to its surface; the table "
            f"has {knots[0]:g} to {knots[-1]:g}: use a larger target angle or a narrower field"
        )
