"""Determinism, what changes with what, the fixed pattern, and what is refused or told."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from simcore.core.errors import SpecError
from simcore.detection import detect
from simcore.detection.converters.csi import CaesiumIodide
from simcore.detection.converters.selenium import Selenium
from simcore.detection.filters import tangents
from simcore.detection.pattern import pattern
from simcore.detection.spec import DetectionSpec, FixedPattern, FlatField, GaussianNoise
from simcore.detection.stack import Expected
from simcore.detection.transfer import RationalTransfer, TablePower, TableTransfer

_spec = importlib.util.spec_from_file_location("scenes", Path(__file__).with_name("scenes.py"))
scenes = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(scenes)

FULL = DetectionSpec(
    converter=CaesiumIodide(),
    transfer=RationalTransfer(half_per_mm=3.0),
    electronic_noise=scenes.ELECTRONICS,
    pattern=scenes.SPOTTED,
    lag=0.05,
)


def textured(place, quanta=800.0):
    signal = quanta * scenes.KEV * np.random.default_rng(2).uniform(0.3, 1.0, (place.views, 96, 120)).astype(np.float32)
    flat = np.full((96, 120), quanta * scenes.KEV, np.float32)
    return Expected(signal, 20 * signal, flat, flat_variance=20 * flat)


def test_same_bytes_on_one_and_two_threads(threads):
    place = scenes.geometry(views=5, ny=96, nx=120, half=10.0)
    stacks = []
    for count in (1, 2):
        threads(count)
        stacks.append(detect(textured(place), FULL, place, 4))
    assert np.array_equal(stacks[0].raw, stacks[1].raw)
    assert np.array_equal(stacks[0].processed, stacks[1].processed)
    assert stacks[0].report == stacks[1].report


def test_a_view_hangs_on_no_other_but_for_lag():
    place, fewer = scenes.geometry(views=4, ny=96, nx=120), scenes.geometry(views=2, ny=96, nx=120)
    expected = textured(place)
    part = Expected(expected.signal[:2], expected.variance[:2], expected.flat, expected.flat_variance)
    spec = FULL.with_(lag=0.0, gain_DN_per_keV=0.5)
    assert np.array_equal(detect(expected, spec, place, 4).raw[:2], detect(part, spec, fewer, 4).raw)


@pytest.mark.parametrize("spec", [scenes.PLAIN, FULL.with_(lag=0.0, pattern=FixedPattern())], ids=["white", "csi"])
def test_realisations_and_views_are_independent(spec):
    place = scenes.geometry(views=2, ny=2048, nx=1024)
    expected = scenes.uniform(place, 800)
    one, other = (
        detect(expected, spec.with_(noise=GaussianNoise(realisation=n)), place, 4).raw.astype(np.float64)
        for n in (0, 1)
    )
    again = detect(expected, spec.with_(noise=GaussianNoise(realisation=1)), place, 5).raw.astype(np.float64)
    pairs = [(one[0], other[0]), (one[1], other[1]), (one[0], one[1]), (other[0], again[0])]
    # Neighbours are correlated, so the estimate scatters a little more than 1 / sqrt(pixels) = 7e-4.
    assert np.mean([np.corrcoef(a.ravel(), b.ravel())[0, 1] for a, b in pairs]) == pytest.approx(0, abs=1e-3)
    assert all(abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 4e-3 for a, b in pairs)


def test_the_realisation_changes_noise_only():
    place = scenes.geometry(views=2, ny=96, nx=120, half=10.0)
    stacks = [
        detect(textured(place), FULL.with_(noise=GaussianNoise(realisation=n)), place, 4, lambda *_: None)
        for n in range(40)
    ]
    quiet = detect(textured(place), FULL.with_(noise={"kind": "none"}), place, 4)
    assert not np.array_equal(stacks[0].raw, stacks[1].raw)
    for stack in stacks[1:]:
        assert np.array_equal(stack.dead, stacks[0].dead)
        assert stack.gain_DN_per_keV == stacks[0].gain_DN_per_keV
    mean = np.mean([stack.raw.astype(np.float64) for stack in stacks], axis=0)
    spread = np.std([stack.raw.astype(np.float64) for stack in stacks], axis=0)
    error = (mean - quiet.raw) / np.maximum(spread / np.sqrt(40), 0.3)
    assert error.mean() == pytest.approx(0, abs=0.05)
    assert error.std() == pytest.approx(1, abs=0.1)


def test_without_noise_bytes_hang_on_no_seed():
    place = scenes.geometry(ny=96, nx=120)
    silent = FULL.with_(noise={"kind": "none"})
    assert np.array_equal(detect(textured(place), silent, place, 1).raw, detect(textured(place), silent, place, 2).raw)


def test_pattern_is_that_of_the_serial_number():
    detector = scenes.geometry(ny=600, nx=500).detector
    one, again = pattern(scenes.SPOTTED, detector), pattern(scenes.SPOTTED, detector)
    other = pattern(scenes.SPOTTED.with_(serial=4), detector)
    assert np.array_equal(one.gain, again.gain)
    assert np.array_equal(one.dead, again.dead)
    assert not np.array_equal(one.gain, other.gain)
    assert not np.array_equal(one.dead, other.dead)
    assert one.known.mean(dtype=np.float64) == pytest.approx(1, abs=1e-6)
    assert one.known.std() == pytest.approx(np.hypot(0.03, 0.01), rel=0.05)
    assert one.dead.all(axis=0).sum() == 2
    assert one.dead.sum() == pytest.approx(300 + 2 * 600, abs=3)


def test_dead_pixels_give_the_offset_and_are_interpolated_or_left():
    place = scenes.geometry(ny=96, nx=120)
    spec = scenes.SILENT.with_(pattern=FixedPattern(dead_fraction=0.01, dead_columns=1))
    expected = scenes.uniform(place, 1000)
    stack = detect(expected, spec, place, 0)
    dead = np.zeros((96, 120), bool)
    dead[tuple(stack.dead.T)] = True
    assert stack.report["dead_pixels"] == dead.sum() > 96
    assert np.all(stack.raw[0][dead] == 100)
    assert np.all(stack.processed[0] == 16000)
    left = detect(expected, spec.with_(flat_field=FlatField(dead_pixels="leave")), place, 0)
    assert np.all(left.processed[0][dead] == 0)
    assert np.all(left.processed[0][~dead] == 16000)


def test_a_gain_map_of_few_frames_leaves_its_noise():
    place = scenes.geometry(views=2, ny=512, nx=512)
    expected = scenes.uniform(place, 1000)
    expected = Expected(expected.signal, expected.variance, expected.flat, flat_variance=20 * expected.flat)
    spec = scenes.SILENT.with_(flat_field=FlatField(frames=4), pattern=scenes.SPOTTED.with_(dead_columns=0))
    stack = detect(expected, spec, place, 0)
    relative = stack.processed.astype(np.float64) / 16000
    assert relative[0].std() == pytest.approx(np.sqrt(1 / 4000), rel=0.02)
    assert np.array_equal(stack.processed[0], stack.processed[1])
    with pytest.raises(ValueError, match="give flat_variance"):
        detect(scenes.uniform(place, 1000), spec, place, 0)


def test_lag_shows_a_part_of_the_view_before():
    place = scenes.geometry(views=3, ny=96, nx=120)
    expected = scenes.uniform(place, 1000)
    signal = expected.signal.copy()
    signal[1] = 0.0
    lagging = Expected(signal, 20 * signal, expected.flat)
    raw = detect(lagging, scenes.SILENT.with_(lag=0.04), place, 0).raw.astype(np.float64) - 100
    assert raw.mean(axis=(1, 2)) == pytest.approx([10000, 400, 10000])


def test_oblique_incidence_blurs_along_the_tube_travel_and_to_one_side():
    place = scenes.geometry(views=3, ny=257, nx=257, pixel=0.05, half=25.0)
    signal = np.zeros((3, 257, 257), np.float32)
    signal[:, 128, 128] = 1e5
    flat = np.full((257, 257), 1e5, np.float32)
    spec = scenes.SILENT.with_(
        converter=Selenium(fluorescence_blur=False, cover_mm=0.0), offset_DN=3000.0, bits=16, gain_DN_per_keV=0.5
    )
    raw = detect(Expected(signal, signal, flat), spec, place, 0).raw.astype(np.float64) - 3000
    assert tangents(place) == pytest.approx(np.tan(np.deg2rad([25, 0, -25])))
    positions = np.arange(257) - 128.0
    near = slice(108, 149)
    moments = []
    for view in range(3):
        line = raw[view, near, near].sum(axis=1) / raw[view, near, near].sum()
        across = raw[view, near, near].sum(axis=0) / raw[view, near, near].sum()
        moments.append([(line * positions[near] ** power).sum() for power in (1, 2, 3)])
        assert (across * positions[near]).sum() == pytest.approx(0, abs=0.02)
    # Photons of the first view go on towards higher rows: skewed that way, the last one the other way.
    assert moments[0][2] > moments[1][2] + 0.05 > moments[2][2] + 0.1
    widened = (moments[0][1] - moments[1][1]) * 0.05**2
    from simcore.physics.attenuation import cross_sections
    from simcore.physics.materials import material

    mu = float(cross_sections(material("selenium"), 20.0).photo) / np.cos(np.deg2rad(25))
    z = np.linspace(0, 0.2, 20001)
    density = np.exp(-mu * z)
    density /= density.sum()
    spread = (density * z**2).sum() - (density * z).sum() ** 2
    assert widened == pytest.approx(spread * np.tan(np.deg2rad(25)) ** 2, rel=0.1)


def test_a_point_does_not_come_back_at_the_other_side():
    place = scenes.geometry(ny=256, nx=256)
    signal = np.zeros((1, 256, 256), np.float32)
    signal[0, 3, 3] = 1e6
    flat = np.full((256, 256), 1e6, np.float32)
    spec = FULL.with_(noise={"kind": "none"}, pattern=FixedPattern(), lag=0.0, gain_DN_per_keV=0.05, offset_DN=5000.0)
    raw = detect(Expected(signal, signal, flat), spec.with_(bits=16), place, 0).raw[0].astype(np.float64) - 5000
    assert raw[3, 3] > 2000
    assert abs(raw[3, 13]) > 5
    assert abs(raw[-40:]).max() == 0
    assert abs(raw[:, -40:]).max() == 0


def test_an_exposure_that_saturates_is_refused_with_a_remedy_that_works():
    place = scenes.geometry(ny=96, nx=120)
    spec = scenes.PLAIN.with_(bits=12)
    with pytest.raises(
        SpecError, match=r"saturates .* 2e\+04 keV, which needs 10100 DN of 4095; allowed are 7990"
    ) as no:
        detect(scenes.uniform(place, 1000), spec, place, 0)
    assert no.value.code == "detector-saturated"
    words = str(no.value).split()
    part = float(words[words.index("most") + 1])
    detect(scenes.uniform(place, 1000 * part), spec, place, 0)
    gain = float(str(no.value).split("gain_DN_per_keV to at most ")[1].split(",")[0])
    detect(scenes.uniform(place, 1000), spec.with_(gain_DN_per_keV=gain), place, 0)
    cut = detect(scenes.uniform(place, 1000), spec.with_(saturation="clip"), place, 0)
    assert cut.report["views"][0]["saturated_pixels"] == 96 * 120
    assert cut.raw.max() == 4095
    assert any("11520 raw pixels stand at the largest number, 4095" in remark for remark in cut.report["remarks"])


def test_a_full_well_saturates_too():
    place = scenes.geometry(ny=96, nx=120)
    spec = scenes.PLAIN.with_(full_well_electrons=2e5)
    with pytest.raises(
        SpecError, match=r"needs 4e\+05 electrons; allowed are 1e\+04 keV.*full_well_electrons to at least 4e\+05"
    ):
        detect(scenes.uniform(place, 1000), spec, place, 0)
    cut = detect(scenes.uniform(place, 1000), spec.with_(saturation="clip"), place, 0)
    assert cut.raw.max() == 5100


def test_an_open_gain_puts_the_brightest_pixel_at_80_percent():
    place = scenes.geometry(ny=96, nx=120)
    stack = detect(scenes.uniform(place, 1000), scenes.SILENT.with_(gain_DN_per_keV=None), place, 0)
    assert stack.raw.max() == pytest.approx(100 + 0.8 * (65535 - 100), abs=1)


def test_electronic_noise_in_numbers_is_that_of_the_raw_image():
    place = scenes.geometry(ny=512, nx=512)
    dark = scenes.uniform(place, 0.0, flat=1e4)
    spec = scenes.PLAIN.with_(electronic_noise={"sigma": 2.28, "unit": "DN"})
    assert detect(dark, spec, place, 0).raw.std() == pytest.approx(np.sqrt(2.28**2 + 1 / 12), rel=0.01)


def test_what_is_cut_and_what_is_few_is_told():
    place = scenes.geometry(ny=96, nx=120)
    report = detect(scenes.uniform(place, 20, flat=100.0), scenes.PLAIN.with_(offset_DN=0.0), place, 0).report
    assert any("20 quanta only" in remark for remark in report["remarks"])
    dark = detect(
        scenes.uniform(place, 0.0, flat=1e4),
        scenes.PLAIN.with_(offset_DN=0.0, electronic_noise=scenes.ELECTRONICS),
        place,
        0,
    )
    assert dark.report["views"][0]["pixels_at_zero"] == pytest.approx(0.5 * 96 * 120, rel=0.1)
    assert any("would lie below 0" in remark for remark in dark.report["remarks"])
    bright = detect(scenes.uniform(place, 1000, flat=100.0), scenes.PLAIN, place, 0)
    assert bright.report["views"][0]["processed_above"] == 96 * 120
    assert np.all(bright.processed == 65535)


def test_tables_that_do_not_fit_the_pixel_are_refused():
    place = scenes.geometry(ny=96, nx=120)
    short = {"frequencies_per_mm": [0.0, 4.0], "values": [1.0, 0.3]}
    with pytest.raises(SpecError, match=r"transfer\.frequencies_per_mm end at 4 per mm; .* Nyquist frequency 5 "):
        detect(scenes.uniform(place, 100), scenes.PLAIN.with_(transfer=TableTransfer(**short)), place, 0)
    with pytest.raises(SpecError, match=r"noise\.power\.frequencies_per_mm end at 4"):
        detect(scenes.uniform(place, 100), scenes.noisy(noise=GaussianNoise(power=TablePower(**short))), place, 0)
    sharp = TableTransfer(frequencies_per_mm=[0.0, 5.0], values=[1.0, 0.9])
    with pytest.raises(SpecError, match=r"0\.9\d* at \d.* above the 0\.\d+ of the aperture of 0\.1 mm"):
        detect(scenes.uniform(place, 100), scenes.PLAIN.with_(transfer=sharp), place, 0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"signal": np.zeros((1, 96, 119), np.float32)}, r"signal has shape \(1, 96, 119\)"),
        ({"variance": np.zeros((1, 96, 120))}, "variance is float64"),
        ({"signal": np.full((1, 96, 120), np.nan, np.float32)}, "signal reaches from nan"),
        ({"signal": np.full((1, 96, 120), -1, np.float32)}, "must be finite and not below 0"),
        ({"flat": np.zeros((96, 120), np.float32)}, "flat is 0"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(change, message):
    place = scenes.geometry(ny=96, nx=120)
    arrays = {"signal": np.ones((1, 96, 120), np.float32), "variance": np.ones((1, 96, 120), np.float32)}
    arrays["flat"] = np.ones((96, 120), np.float32)
    with pytest.raises(ValueError, match=message):
        detect(Expected(**(arrays | change)), scenes.PLAIN, place, 0)
