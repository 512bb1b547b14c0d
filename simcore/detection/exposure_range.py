"""Whether what a pixel receives fits into what it holds; the gain where the specification leaves it open."""

from __future__ import annotations

from dataclasses import dataclass

from simcore.core.errors import SpecError
from simcore.detection.spec import DetectionSpec

FULL_SCALE = 0.8
"""Where the brightest expected pixel stands of the range, where the gain is not given."""


@dataclass(frozen=True)
class Range:
    """gain: DN per keV. limit: largest raw number. electronic_keV: standard deviation of the electronic noise."""

    gain: float
    limit: int
    electronic_keV: float


def range_of(spec: DetectionSpec, brightest_keV: float) -> Range:
    """brightest_keV: largest expected energy of a pixel, lag included.

    raises: SpecError (detector-saturated) where it exceeds what a pixel holds and is not to be cut.
    """
    largest = 2**spec.bits - 1
    per_keV = spec.converter.electrons_per_keV
    well_keV = spec.full_well_electrons / per_keV if spec.full_well_electrons is not None else float("inf")
    gain = spec.gain_DN_per_keV
    if gain is None:
        gain = FULL_SCALE * (largest - spec.offset_DN) / min(brightest_keV, well_keV) if brightest_keV > 0 else 1.0
    bits_keV = (largest - spec.offset_DN) / gain
    holds = min(bits_keV, well_keV)
    if brightest_keV > holds and spec.saturation == "refuse":
        raise _saturated(spec, brightest_keV, bits_keV, well_keV, gain)
    noise = spec.electronic_noise
    sigma = noise.sigma / (per_keV if noise.unit == "electrons" else gain)
    limit = min(largest, int(spec.offset_DN + gain * well_keV)) if well_keV < bits_keV else largest
    return Range(gain, limit, sigma)


def _saturated(spec: DetectionSpec, brightest: float, bits: float, well: float, gain: float) -> SpecError:
    holds = min(bits, well)
    if well < bits:
        field, value = "full_well_electrons", spec.full_well_electrons
        needed = f"{brightest * spec.converter.electrons_per_keV:.4g} electrons"
        remedy = f"full_well_electrons to at least {brightest * spec.converter.electrons_per_keV:.4g}"
    else:
        field, value = "gain_DN_per_keV", gain
        needed = f"{spec.offset_DN + gain * brightest:.0f} DN of {2**spec.bits - 1}"
        most = float(f"{(1 - 1e-3) * (2**spec.bits - 1 - spec.offset_DN) / brightest:.3g}")
        remedy = f"gain_DN_per_keV to at most {0.99 * most:.3g}"
    message = (
        f"the exposure saturates the detector: the brightest pixel is expected to receive {brightest:.4g} keV, which "
        f"needs {needed}; allowed are {holds:.4g} keV. Lower the exposure to at most {0.99 * holds / brightest:.3g} "
        f'of this one, or set {remedy}, or saturation to "clip"'
    )
    problems = [{"field": field, "value": value, "message": message}]
    return SpecError(message, code="detector-saturated", problems=problems)
