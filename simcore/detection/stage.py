"""The stage: y = h * S + k * (sqrt(V) z1) + lag y of the view before; then electronic noise, gain, flat field.

Views are independent but for lag. Each is filtered by one thread and read out in its turn; what is random is a
function of seed, realisation, view, row and column. So bytes depend neither on the number of threads nor on what ran
first.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import numba
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from simcore.core import rng
from simcore.core.artifacts import Report, frozen
from simcore.core.geometry import AcquisitionGeometry
from simcore.core.progress import Progress, silent
from simcore.detection.exposure_range import Range, range_of
from simcore.detection.filters import Beam, Filters, filters
from simcore.detection.kernels import add_filtered, add_white, filter_signal, flatten, pad, read_out, times_normals
from simcore.detection.pattern import Pattern, pattern
from simcore.detection.spec import DetectionSpec, GaussianNoise
from simcore.detection.stack import DetectedStack, Expected

FloatArray = NDArray[np.float32]
NO_VIEW = np.empty((0, 0), np.float32)
FEW_QUANTA = 50.0
"""Below so many a pixel the numbers of quanta are not normal."""
SAMPLES = 8
"""Every so many pixels and rows count for the median of signal-to-noise ratios."""


def detect_views(
    expected: Expected,
    spec: DetectionSpec,
    geometry: AcquisitionGeometry,
    seed: int,
    progress: Progress = silent,
) -> DetectedStack:
    """See ``simcore.detection.detect``."""
    expected.check(geometry)
    beam = Beam(expected.object_height_mm, expected.rays_per_pixel_edge)
    brightest = max(float(view.max()) for view in expected.signal) * (1 + spec.lag * (geometry.views > 1))
    limits = range_of(spec, brightest)
    blur, own = filters(spec, geometry, beam), pattern(spec.pattern, geometry.detector)
    calibrated = _calibrated(expected, spec, own, blur, seed)
    raw = np.empty(expected.signal.shape, np.uint16)
    processed = np.empty_like(raw)
    views, earlier = [], NO_VIEW
    for view, charge in enumerate(_charges(expected, spec, blur, seed)):
        counts = _read(view, charge, earlier, spec, limits, own, seed, raw[view])
        above, below = flatten(
            raw[view],
            expected.flat_of(view),
            calibrated,
            own.dead,
            spec.flat_field.dead_pixels == "interpolate",
            spec.flat_field.open_field_value / limits.gain,
            spec.offset_DN,
            processed[view],
        )
        cut = {"processed_above": above, "processed_below": below}
        views.append(counts | _expected_facts(expected, view, spec, limits, blur) | cut)
        earlier = charge if spec.lag > 0 else NO_VIEW
        progress((view + 1) / geometry.views, f"view {view + 1} of {geometry.views}")
    report = _report(spec, limits, own, views)
    dead = np.argwhere(own.dead).astype(np.int32)
    return DetectedStack(raw, processed, dead, limits.gain, spec.flat_field.open_field_value, geometry, report)


def _charges(expected: Expected, spec: DetectionSpec, blur: Filters, seed: int) -> Iterator[FloatArray]:
    """Charge of every view in turn, keV, before electronic noise; as many are made at once as there are threads."""
    threads = numba.get_num_threads()
    waiting: deque[Future[FloatArray]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        for view in range(len(expected.signal)):
            waiting.append(pool.submit(_charge, view, expected, spec, blur, seed))
            if len(waiting) > threads:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


def _charge(view: int, expected: Expected, spec: DetectionSpec, blur: Filters, seed: int) -> FloatArray:
    room = np.empty(blur.shape, np.float32)
    pad(expected.signal[view], room)
    spectrum = scipy.fft.rfft2(room)
    filter_signal(spectrum, blur.oblique[view], blur.signal)
    noise = spec.noise
    if isinstance(noise, GaussianNoise) and blur.noise is not None:
        pad(expected.variance[view], room)
        times_normals(room, rng.key(seed, "detector", "quanta", noise.realisation, view))
        add_filtered(spectrum, scipy.fft.rfft2(room), blur.noise)
    ny, nx = expected.signal.shape[1:]
    # A copy without gaps: kernels run over it in vectors, and are compiled once.
    charge = np.ascontiguousarray(scipy.fft.irfft2(spectrum, s=blur.shape, overwrite_x=True)[:ny, :nx])
    if isinstance(noise, GaussianNoise) and blur.noise is None:
        add_white(charge, expected.variance[view], rng.key(seed, "detector", "quanta", noise.realisation, view))
    return charge


def _read(
    view: int,
    charge: FloatArray,
    earlier: FloatArray,
    spec: DetectionSpec,
    limits: Range,
    own: Pattern,
    seed: int,
    raw: NDArray[np.uint16],
) -> Report:
    noise, sigma, key = spec.noise, 0.0, np.zeros(2, np.uint64)
    if isinstance(noise, GaussianNoise):
        sigma, key = limits.electronic_keV, rng.key(seed, "detector", "electronics", noise.realisation, view)
    full, empty, total = read_out(
        charge,
        earlier,
        spec.lag,
        sigma,
        key,
        own.gain,
        own.dead,
        limits.gain,
        spec.offset_DN,
        float(limits.limit),
        raw,
    )
    live = raw.size - int(own.dead.sum())
    return {"saturated_pixels": full, "pixels_at_zero": empty, "mean_DN": total / live if live else None}


def _calibrated(expected: Expected, spec: DetectionSpec, own: Pattern, blur: Filters, seed: int) -> FloatArray:
    """The gain map as calibration knows it: exact, or with the noise of so many open-field exposures, those of the
    middle view."""
    frames = spec.flat_field.frames
    if frames is None:
        return own.known
    if expected.flat_variance is None:
        raise ValueError("flat_field.frames needs the variance of the open field: give flat_variance")
    middle = len(expected.signal) // 2
    flat = expected.flat_of(middle)
    variance = expected.flat_variance if expected.flat_variance.ndim == 2 else expected.flat_variance[middle]
    room = np.empty(blur.shape, np.float32)
    pad(frozen(variance / (np.float32(frames) * flat**2)), room)
    times_normals(room, rng.key(spec.pattern.serial, "detector", "flat frames", frames))
    if blur.noise is not None:
        room = scipy.fft.irfft2(scipy.fft.rfft2(room) * blur.noise, s=blur.shape)
    noise = room[: flat.shape[0], : flat.shape[1]]
    return np.asarray(own.known * (1 + noise), np.float32)


def _expected_facts(expected: Expected, view: int, spec: DetectionSpec, limits: Range, blur: Filters) -> Report:
    signal = expected.signal[view, ::SAMPLES, ::SAMPLES].astype(np.float64)
    variance = expected.variance[view, ::SAMPLES, ::SAMPLES].astype(np.float64)
    lit = variance > 0
    quanta = signal[lit] ** 2 / variance[lit]
    if not len(quanta):
        return {"snr": None, "fewest_quanta": None}
    noise = variance[lit] * blur.noise_gain + limits.electronic_keV**2 + 1 / (12 * limits.gain**2)
    return {"snr": float(np.median(signal[lit] / np.sqrt(noise))), "fewest_quanta": float(quanta.min())}


def _report(spec: DetectionSpec, limits: Range, own: Pattern, views: list[Report]) -> Report:
    def total(name: str) -> int:
        return sum(view[name] for view in views)

    remarks = []
    for name, what in (
        ("saturated_pixels", f"raw pixels stand at the largest number, {limits.limit}"),
        ("pixels_at_zero", "raw pixels would lie below 0 and are 0: raise offset_DN"),
        ("processed_above", "For Processing pixels exceed 65535 and are cut: lower flat_field.open_field_value"),
        ("processed_below", "For Processing pixels would lie below 0 and are 0"),
    ):
        if total(name):
            remarks.append(f"{total(name)} {what}")
    quanta = [view["fewest_quanta"] for view in views if view["fewest_quanta"] is not None]
    if isinstance(spec.noise, GaussianNoise) and quanta and min(quanta) < FEW_QUANTA:
        remarks.append(
            f"some pixels receive {min(quanta):.3g} quanta only: their noise is drawn as normal, which holds above "
            f"about {FEW_QUANTA:g}"
        )
    return {
        "gain_DN_per_keV": limits.gain,
        "electronic_keV": limits.electronic_keV,
        "largest_DN": limits.limit,
        "dead_pixels": int(own.dead.sum()),
        "views": views,
        "remarks": remarks,
    }
