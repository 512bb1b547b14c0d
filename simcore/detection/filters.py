"""The filters of signal and noise at the frequencies of a padded view.

Signal: aperture, converter, focal spot; over what the rays of a pixel have averaged already. Oblique incidence differs
from view to view and multiplies it along the rows.

Noise: a pixel sums the quanta over its aperture, so the power of quanta before sampling is folded at the sampling
frequency,

    |k(f)|^2 ~ sum over n of power(|f + n / pixel|) A(f + n / pixel)^2,   k(0) = 1,

A the aperture's transfer. Where the quanta are not correlated k is 1, as the sum over A^2 is constant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from simcore.core.geometry import AcquisitionGeometry
from simcore.detection.blur import (
    QuantumPower,
    RadialFunction,
    aperture_mm,
    converter_transfer,
    oblique_transfer,
    quantum_power,
    table_power,
)
from simcore.detection.spec import DetectionSpec, GaussianNoise
from simcore.detection.transfer import TablePower

FloatArray = NDArray[np.float64]
PADDING = 128
"""Pixels beyond the view, half of them on each side: filters have died away there."""
NODES = 65
ALIASES = 3
RADII = 8192


@dataclass(frozen=True)
class Beam:
    """How the signal of a stack came about.

    object_height_mm: middle of the breast above the detector, for the blur of the focal spot.
    rays_per_pixel_edge: a pixel's signal is the mean over n x n rays; 1: of the ray to its centre.
    """

    object_height_mm: float = 45.0
    rays_per_pixel_edge: int = 1


@dataclass(frozen=True, eq=False)
class Filters:
    """Of one stack.

    shape: of a padded view. signal: float32 (rows, columns // 2 + 1). noise: the same, None for white noise.
    oblique: complex64 (views, rows). noise_gain: variance of the noise over that of large areas.
    """

    shape: tuple[int, int]
    signal: NDArray[np.float32]
    noise: NDArray[np.float32] | None
    oblique: NDArray[np.complex64]
    noise_gain: float


def filters(spec: DetectionSpec, geometry: AcquisitionGeometry, beam: Beam) -> Filters:
    """raises: SpecError where a table does not fit the pixel (see blur)."""
    pixel = geometry.detector.pixel
    rows, columns = (int(scipy.fft.next_fast_len(n + PADDING, real=True)) for n in _size(geometry))
    down, across = scipy.fft.fftfreq(rows, pixel), scipy.fft.rfftfreq(columns, pixel)
    transfer = converter_transfer(spec, pixel)
    aperture = aperture_mm(spec.converter, pixel)
    spot = _spot_on_detector(spec, geometry, beam)
    edges = [
        np.sinc(f * aperture) * np.sinc(f * spot) / _mean_of_rays(f * pixel, beam.rays_per_pixel_edge)
        for f in (down, across)
    ]
    signal = radial(transfer, down, across, pixel) * np.outer(*edges)
    power = _pixel_power(spec, transfer, down, across, pixel)
    noise = None if power is None else np.sqrt(np.maximum(power, 0.0)).astype(np.float32)
    oblique = [oblique_transfer(spec, down, tangent) for tangent in tangents(geometry)]
    return Filters(
        (rows, columns),
        signal.astype(np.float32),
        noise,
        np.array(oblique, np.complex64),
        1.0 if power is None else float(_mean_over_plane(power, columns)),
    )


def tangents(geometry: AcquisitionGeometry) -> FloatArray:
    """Of the angle at which rays meet the middle of the chest-wall edge, along the detector's rows index, (views,):
    positive where photons go on towards higher rows."""
    values = []
    for view in range(geometry.views):
        origin, row_direction = geometry.detector_frame(view)
        ray = origin - geometry.sources[view]
        values.append(float(ray @ row_direction / abs(ray @ geometry.normal(view))))
    return np.array(values)


def radial(function: RadialFunction, down: FloatArray, across: FloatArray, pixel: float) -> FloatArray:
    """A function of the frequency's magnitude on a grid of them, by a fine table."""
    table = np.linspace(0, np.sqrt(0.5) / pixel * 1.01, RADII)
    values = function(table)
    first = np.abs(down[: len(down) // 2 + 1])
    half = np.interp(np.hypot(first[:, None], across), table, values)
    return np.asarray(half[_mirrored(len(down))])


def _pixel_power(
    spec: DetectionSpec, transfer: RadialFunction, down: FloatArray, across: FloatArray, pixel: float
) -> FloatArray | None:
    if isinstance(spec.noise, GaussianNoise) and isinstance(spec.noise.power, TablePower):
        return radial(table_power(spec.noise.power, pixel), down, across, pixel)
    quanta = quantum_power(spec, transfer)
    if quanta is None or quanta.floor == 1.0 or bool(np.all(quanta.power(np.linspace(0, 1 / pixel, 64)) == 1.0)):
        return None
    return _folded(quanta, aperture_mm(spec.converter, pixel), down, across, pixel)


def _folded(quanta: QuantumPower, aperture: float, down: FloatArray, across: FloatArray, pixel: float) -> FloatArray:
    """The sum over aliases: the first term on every frequency, the others, which are smooth, on nodes. What the power
    falls to is the same in all, and its sum is known."""
    nodes = np.linspace(0, 0.5 / pixel, NODES)
    others = np.full((NODES, NODES), quanta.floor * (pixel / aperture) ** 2)
    shifts = [(m, n) for m in range(-ALIASES, ALIASES + 1) for n in range(-ALIASES, ALIASES + 1) if (m, n) != (0, 0)]
    for m, n in shifts:
        f_down, f_across = nodes + m / pixel, nodes + n / pixel
        above = quanta.power(np.hypot(f_down[:, None], f_across)) - quanta.floor
        others += above * np.outer(np.sinc(f_down * aperture) ** 2, np.sinc(f_across * aperture) ** 2)
    spline = RectBivariateSpline(nodes, nodes, others)
    first = np.abs(down[: len(down) // 2 + 1])
    rest = spline(np.minimum(first, nodes[-1]), np.minimum(across, nodes[-1]))
    main = (radial(quanta.power, down, across, pixel) - quanta.floor) * np.outer(
        np.sinc(down * aperture) ** 2, np.sinc(across * aperture) ** 2
    )
    power = main + rest[_mirrored(len(down))]
    return np.asarray(power / power[0, 0])


def _mirrored(rows: int) -> NDArray[np.int64]:
    """For each row of a transform that of the same magnitude of frequency in its first half."""
    places = np.arange(rows)
    return np.minimum(places, rows - places)


def _mean_over_plane(power: FloatArray, columns: int) -> float:
    """Mean over all frequencies of which a real transform holds half."""
    weights = np.full(power.shape[1], 2.0)
    weights[0] = 1.0
    if columns % 2 == 0:
        weights[-1] = 1.0
    return float((power * weights).mean(axis=0).sum() / weights.sum())


def _mean_of_rays(cycles: FloatArray, rays: int) -> FloatArray:
    """Transfer of the mean over so many rays across a pixel; cycles: per pixel."""
    inner = np.sinc(cycles / rays)
    return np.asarray(np.sinc(cycles) / inner) if rays > 1 else np.ones_like(cycles)


def _spot_on_detector(spec: DetectionSpec, geometry: AcquisitionGeometry, beam: Beam) -> float:
    """Edge of the focal spot's image through a point at the middle of the breast, mm."""
    height = geometry.source_to_detector
    return spec.focal_spot_mm * beam.object_height_mm / (height - beam.object_height_mm)


def _size(geometry: AcquisitionGeometry) -> tuple[int, int]:
    return geometry.detector.ny, geometry.detector.nx
