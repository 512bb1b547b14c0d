"""What is put in comes out: variance, noise power, transfer, quantum efficiency, measured on the detector's numbers."""

import importlib.util
import math
from pathlib import Path

import numpy as np
import pytest

from simcore.detection import detect
from simcore.detection.converters.csi import CaesiumIodide
from simcore.detection.converters.selenium import Selenium
from simcore.detection.filters import Beam, filters
from simcore.detection.response import response
from simcore.detection.spec import DetectionSpec, ElectronicNoise, FixedPattern, GaussianNoise
from simcore.detection.stack import Expected
from simcore.detection.systems import detector_of
from simcore.detection.transfer import RationalTransfer, TablePower, TableTransfer
from simcore.quality.mtf import slanted_edge_mtf
from simcore.quality.noise import detective_quantum_efficiency, noise_power
from simcore.quality.texture import periodogram

_spec = importlib.util.spec_from_file_location("scenes", Path(__file__).with_name("scenes.py"))
scenes = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(scenes)

PIXEL = 0.1
GE = DetectionSpec(
    converter=CaesiumIodide(),
    transfer=RationalTransfer(half_per_mm=3.0, power=1.6),
    focal_spot_mm=0.0,
    bits=16,
    gain_DN_per_keV=0.5,
    offset_DN=100.0,
)
SELENIUM = GE.with_(converter=Selenium(), transfer={"kind": "aperture"})


def energies(stack, view=slice(None)):
    """keV that the raw numbers stand for."""
    return (stack.raw[view].astype(np.float64) - 100.0) / stack.gain_DN_per_keV


def squares(images, size=128):
    """All squares of an array (..., ny, nx) side by side, (count, size, size)."""
    *_, ny, nx = images.shape
    parts = images[..., : ny // size * size, : nx // size * size]
    parts = parts.reshape(-1, ny // size, size, nx // size, size)
    return parts.swapaxes(2, 3).reshape(-1, size, size)


def test_variance_is_that_of_electronics_quanta_and_structure():
    """variance = a + b S + c S^2 over four exposures, the three coefficients those of the specification."""
    spec = scenes.noisy(
        electronic_noise=ElectronicNoise(sigma=2000.0), pattern=FixedPattern(structure=0.004), gain_DN_per_keV=0.2
    )
    place = scenes.geometry(views=3, ny=512, nx=512)
    signals, variances = [], []
    for quanta in (100, 1000, 4000, 10000):
        own = detect(scenes.uniform(place, quanta), spec, place, 1)
        values = energies(own)
        signals.append(quanta * scenes.KEV)
        variances.append(values.var(axis=(1, 2)).mean() - 1 / (12 * 0.2**2))
    a, b, c = (100.0**2, scenes.KEV, 0.004**2)
    expected = [a + b * s + c * s * s for s in signals]
    assert variances == pytest.approx(expected, rel=0.02)
    measured = np.linalg.solve(
        np.vander(np.array(signals)[[0, 1, 3]], 3, increasing=True), np.array(variances)[[0, 1, 3]]
    )
    assert measured == pytest.approx([a, b, c], rel=0.06)


def expected_power(spec, frequency_shape, pixel=PIXEL):
    """|k|^2 by adding up aliases one by one, on the frequencies of fft2."""
    n = frequency_shape
    f = np.fft.fftfreq(n, pixel)
    power = np.zeros((n, n))
    t, e = spec.transfer, spec.converter.uncorrelated
    reach = 12
    for p in range(-reach, reach + 1):
        for q in range(-reach, reach + 1):
            u, v = f[:, None] + p / pixel, f + q / pixel
            blur = 1 / (1 + (np.hypot(u, v) / t.half_per_mm) ** t.power)
            power += (1 - e) * blur**2 * (np.sinc(u * pixel) * np.sinc(v * pixel)) ** 2
    return power + e


def test_noise_power_of_caesium_iodide_over_all_frequencies():
    place = scenes.geometry(views=4, ny=1024, nx=1024)
    expected = scenes.uniform(place, 1000)
    values = energies(detect(expected, GE, place, 3)) / 20000.0
    regions = squares(values)
    measured = np.mean([periodogram(region, PIXEL) for region in regions], axis=0)
    power = expected_power(GE, 128) * PIXEL**2 / 1000
    ratio = measured / power
    # Detrending takes the lowest frequencies, and 256 regions leave 6 % of noise a frequency.
    f = np.abs(np.fft.fftfreq(128, PIXEL))
    radius = np.hypot(f[:, None], f)
    for low, high in ((0.3, 1), (1, 2), (2, 3), (3, 4), (4, 5), (5, 7.1)):
        assert ratio[(radius >= low) & (radius < high)].mean() == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize("spec", [GE, SELENIUM, scenes.PLAIN], ids=["csi", "a-se", "ideal"])
def test_noise_power_times_kerma_is_constant(spec):
    place = scenes.geometry(views=2, ny=768, nx=768)
    curves = []
    for quanta in (300, 1200, 4800):
        values = energies(detect(scenes.uniform(place, quanta), spec, place, 3)) / (quanta * scenes.KEV)
        frequency, power = noise_power(squares(values), PIXEL)
        curves.append(power * quanta)
    band = frequency > 0.5
    for curve in curves[1:]:
        assert curve[band].mean() == pytest.approx(curves[0][band].mean(), rel=0.02)


def test_selenium_has_15_percent_more_power_at_low_frequencies():
    """One published measurement of a system: 15 %."""
    place = scenes.geometry(views=4, ny=1024, nx=1024)
    frequency, power = noise_power(squares(energies(detect(scenes.uniform(place, 2000), SELENIUM, place, 3))), PIXEL)
    low, high = power[(frequency > 0.2) & (frequency < 0.6)].mean(), power[frequency > 4].mean()
    assert low / high == pytest.approx(1.15, abs=0.05)


def test_power_of_a_table_is_met():
    table = TablePower(frequencies_per_mm=[0.0, 2.0, 5.0], values=[3.0, 1.5, 0.75])
    place = scenes.geometry(views=4, ny=1024, nx=1024)
    spec = scenes.noisy(noise=GaussianNoise(power=table))
    values = energies(detect(scenes.uniform(place, 1000), spec, place, 3)) / 20000.0
    frequency, power = noise_power(squares(values), PIXEL)
    for low, high in ((0.5, 1.5), (1.5, 3.0), (3.0, 5.0)):
        band = (frequency > low) & (frequency < high)
        expected = np.interp(frequency[band], table.frequencies_per_mm, table.values).mean() / 3.0 * PIXEL**2 / 1000
        assert power[band].mean() == pytest.approx(expected, rel=0.02)


def edge(place, rays=1, degrees=3.0, low=4e3, high=2e4):
    """A straight edge between two signals; every pixel the mean over rays x rays points of it."""
    n, m = place.detector.ny, place.detector.nx
    y, x = ((np.arange(k * rays) - (k * rays - 1) / 2) / rays for k in (n, m))
    side = x * math.cos(math.radians(degrees)) - y[:, None] * math.sin(math.radians(degrees)) > 0
    fine = np.where(side, high, low)
    signal = fine.reshape(n, rays, m, rays).mean(axis=(1, 3)).astype(np.float32)[None]
    return Expected(signal, 20 * signal, np.full((n, m), high, np.float32), rays_per_pixel_edge=rays)


@pytest.mark.parametrize("rays", [1, 4])
@pytest.mark.parametrize(
    ("spec", "known"),
    [
        (scenes.SILENT, lambda f: np.sinc(0.1 * f)),
        (GE.with_(noise={"kind": "none"}), lambda f: np.sinc(0.1 * f) / (1 + (f / 3.0) ** 1.6)),
        (
            scenes.SILENT.with_(
                transfer=TableTransfer(frequencies_per_mm=[0.0, 1.0, 3.0, 5.0], values=[1.0, 0.8, 0.4, 0.2])
            ),
            lambda f: np.interp(f, [0.0, 1.0, 3.0, 5.0], [1.0, 0.8, 0.4, 0.2]),
        ),
    ],
    ids=["aperture", "rational", "table"],
)
def test_slanted_edge_gives_back_the_transfer(spec, known, rays):
    """Within 0.01 up to 0.95 of Nyquist (there the sampled edge repeats itself)."""
    place = scenes.geometry(ny=400, nx=500)
    stack = detect(edge(place, rays), spec, place, 0)
    frequency, mtf = slanted_edge_mtf(energies(stack, 0), PIXEL, half_width_mm=12.0)
    # Along the normal of the edge, 3 degrees off the rows: the aperture is a little wider.
    band = frequency < 4.75
    assert mtf[band] == pytest.approx(known(frequency[band]), abs=0.01)


@pytest.mark.parametrize(
    ("system", "points"),
    [
        ("ge-senographe-ds", {1.0: 0.90, 2.0: 0.76, 4.0: 0.46}),
        ("ge-essential", {1.0: 0.85, 2.0: 0.59, 4.0: 0.24}),
        ("ge-pristina", {1.0: 0.84, 2.0: 0.66, 3.0: 0.47, 4.0: 0.32}),
    ],
)
def test_systems_have_their_published_transfer(system, points):
    spec = detector_of(system).with_(noise={"kind": "none"}, focal_spot_mm=0.0, pattern=FixedPattern(), bits=16)
    place = scenes.geometry(ny=400, nx=500)
    stack = detect(edge(place), spec, place, 0)
    frequency, mtf = slanted_edge_mtf(stack.processed[0], PIXEL, half_width_mm=12.0)
    for place_per_mm, value in points.items():
        assert np.interp(place_per_mm, frequency, mtf) == pytest.approx(value, abs=0.01)


def test_siemens_transfers_a_half_at_4_3_per_mm():
    spec = detector_of("siemens-inspiration").with_(noise={"kind": "none"}, focal_spot_mm=0.0, pattern=FixedPattern())
    place = scenes.geometry(ny=400, nx=500, pixel=0.085)
    frequency, mtf = slanted_edge_mtf(detect(edge(place), spec, place, 0).processed[0], 0.085, half_width_mm=12.0)
    assert np.interp(4.3, frequency, mtf) == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("converter", [CaesiumIodide(), Selenium()], ids=["csi", "a-se"])
def test_quantum_efficiency_is_that_of_the_converter(converter):
    """DQE = MTF^2 / (q K NNPS) from the numbers, against absorption, Swank factor and the filters."""
    spec = GE.with_(converter=converter, **({} if converter.kind == "csi" else {"transfer": {"kind": "aperture"}}))
    place = scenes.geometry(views=6, ny=1024, nx=1024)
    quanta = 2000.0  # that fall in, of 20 keV
    one = response(converter, 20.0)
    shape = (6, 1024, 1024)
    expected = Expected(
        np.full(shape, quanta * one.signal, np.float32),
        np.full(shape, quanta * one.variance, np.float32),
        np.full(shape[1:], quanta * one.signal, np.float32),
    )
    values = energies(detect(expected, spec, place, 5)) / float(quanta * one.signal)
    regions = squares(values)
    power = np.mean([periodogram(region, PIXEL) for region in regions], axis=0)
    f = np.fft.fftfreq(128, PIXEL)
    own = filters(spec, scenes.geometry(ny=1024, nx=1024), Beam())
    # Along a row, where the MTF is measured: the rows of frequencies beside the axis.
    along, beside = slice(4, 60), np.r_[2:6, 123:127]
    nnps = power[beside][:, along].mean(axis=0)
    columns = np.arange(own.signal.shape[1]) / (own.shape[1] * PIXEL)
    mtf = np.interp(f[along], columns, own.signal[0])
    rows = np.rint(f[beside] * own.shape[0] * PIXEL).astype(int)
    k_squared = np.mean([np.interp(f[along], columns, own.noise[row] ** 2) for row in rows], axis=0)
    dqe = detective_quantum_efficiency(mtf, nnps, quanta / PIXEL**2)
    known = float(one.absorbed * one.swank) * mtf**2 / k_squared
    for part in np.split(np.arange(56), 4):
        assert dqe[part].mean() == pytest.approx(known[part].mean(), rel=0.02)


def test_the_mean_is_unbiased_after_flat_field():
    place = scenes.geometry(views=4, ny=512, nx=512)
    rows, columns = np.meshgrid(np.linspace(0.7, 1.3, 512), np.linspace(0.9, 1.1, 512), indexing="ij")
    flat = (40000 * rows * columns).astype(np.float32)
    signal = np.broadcast_to((0.25 * flat)[None], (4, 512, 512)).copy()
    spec = GE.with_(pattern=scenes.SPOTTED, electronic_noise=ElectronicNoise(sigma=1000.0), gain_DN_per_keV=0.05)
    stack = detect(Expected(signal, 20 * signal, flat), spec, place, 9)
    assert stack.processed.mean() == pytest.approx(0.25 * 16000, rel=5e-4)
    thirds = stack.processed.reshape(4, 512, 4, 128).mean(axis=(0, 1, 3))
    assert thirds == pytest.approx(4000, rel=1e-3)


def test_siemens_loses_a_fifth_of_its_efficiency_at_0_4_mR():
    """One published measurement: DQE 20 % below its maximum. 0.4 mR are 3.5 uGy, with 4.5e6 photons per mm2 and mGy."""
    spec = detector_of("siemens-inspiration").with_(pattern=FixedPattern(), gain_DN_per_keV=1.0, lag=0.0)
    pixel = 0.085
    place = scenes.geometry(views=4, ny=768, nx=768, pixel=pixel)
    photons = 3.5e-3 * 4.5e6 * pixel**2
    one = response(spec.converter, 20.0)
    shape = (4, 768, 768)
    efficiencies = []
    for exposure in (photons, 20 * photons):
        signal, variance = (
            np.full(shape, exposure * float(weight), np.float32) for weight in (one.signal, one.variance)
        )
        stack = detect(Expected(signal, variance, signal[0]), spec.with_(bits=16), place, 1)
        frequency, power = noise_power(squares(stack.raw.astype(np.float64)), pixel)
        low = power[(frequency > 0.2) & (frequency < 0.8)].mean() / float(signal[0, 0, 0]) ** 2
        efficiencies.append(float(detective_quantum_efficiency(1.0, low, exposure / pixel**2)))
    assert 1 - efficiencies[0] / efficiencies[1] == pytest.approx(0.20, abs=0.07)


def test_hologic_has_its_electronic_noise_and_offset_in_the_dark():
    spec = detector_of("hologic-dimensions").with_(pattern=FixedPattern())
    place = scenes.geometry(ny=512, nx=512, pixel=0.14)
    dark = detect(scenes.uniform(place, 0.0, flat=1e5), spec, place, 0).raw
    assert dark.mean() == pytest.approx(53, abs=0.02)
    assert dark.std() == pytest.approx(np.hypot(2.28, np.sqrt(1 / 12)), rel=0.01)
