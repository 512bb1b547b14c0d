"""How far the signal of a photon spreads within the converter: its transfer, and the noise power it leaves.

Both are functions of the frequency's magnitude, without the pixel's aperture and before sampling. Noise power is that
of the quanta, 1 at frequency 0.

K fluorescence: of the energy E of a photon, E_i may be absorbed at another place, or leave. With s_i the probability of
line i and e_i that it then leaves, and M_i(f) = (mu_i / 2 pi f) atan(2 pi f / mu_i) the transfer of an isotropic photon
to where it is absorbed (of a layer without faces; photons that stay fly less far, so the blur is rather too large),

    transfer  ~ E - sum s_i E_i + sum s_i (1 - e_i) E_i M_i
    power     ~ (1 - sum s_i) E^2 + sum s_i e_i (E - E_i)^2
                + sum s_i (1 - e_i) ((E - E_i)^2 + E_i^2 + 2 (E - E_i) E_i M_i),

the last because both deposits are of one photon.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simcore.core.errors import SpecError
from simcore.detection.converters.csi import CaesiumIodide
from simcore.detection.converters.selenium import Selenium
from simcore.detection.response import Converter, escape, k_lines
from simcore.detection.spec import DetectionSpec, GaussianNoise
from simcore.detection.transfer import RationalTransfer, TablePower, TableTransfer, WhitePower
from simcore.physics.attenuation import attenuation, cross_sections
from simcore.physics.materials import material

FloatArray = NDArray[np.float64]
RadialFunction = Callable[[FloatArray], FloatArray]
ABOVE_APERTURE = 0.05
"""A measured MTF may exceed that of the aperture by so much."""


class QuantumPower(NamedTuple):
    """Noise power of the quanta before sampling.

    power: over frequency [1/mm], 1 at 0. floor: what it falls to.
    """

    power: RadialFunction
    floor: float


def aperture_mm(converter: Converter, pixel: float) -> float:
    """Edge of the area of a pixel that collects."""
    return float(pixel * np.sqrt(getattr(converter, "fill_factor", 1.0)))


def converter_transfer(spec: DetectionSpec, pixel: float) -> RadialFunction:
    """What light, charge and K photons leave of a structure, over frequency [1/mm].

    raises: SpecError where a table ends below the Nyquist frequency of the pixel, or exceeds its aperture's transfer.
    """
    transfer, converter = spec.transfer, spec.converter
    if isinstance(transfer, RationalTransfer):
        return lambda f: 1 / (1 + (f / transfer.half_per_mm) ** transfer.power)
    if isinstance(transfer, TableTransfer):
        _reaches(transfer.frequencies_per_mm, pixel, "transfer")
        return _without_aperture(transfer, aperture_mm(converter, pixel), pixel)
    if isinstance(converter, Selenium) and converter.fluorescence_blur:
        return _fluorescence(converter, spec.reference_energy_keV)[0]
    return np.ones_like


def quantum_power(spec: DetectionSpec, transfer: RadialFunction) -> QuantumPower | None:
    """Correlation of the quantum noise before sampling; None where there is none, or where a table gives that of the
    pixels themselves."""
    noise, converter = spec.noise, spec.converter
    if not isinstance(noise, GaussianNoise) or isinstance(noise.power, WhitePower | TablePower):
        return None
    if isinstance(converter, CaesiumIodide):
        white = converter.uncorrelated
        return QuantumPower(lambda f: white + (1 - white) * transfer(f) ** 2, white)
    if isinstance(converter, Selenium) and converter.fluorescence_blur:
        return _fluorescence(converter, spec.reference_energy_keV)[1]
    return None


def oblique_transfer(spec: DetectionSpec, frequency: FloatArray, tangent: float) -> NDArray[np.complex128]:
    """Transfer of photons that cross the converter at an angle and are absorbed at any depth: the transform of an
    exponential that ends at the back face, about its mean (the detector of a geometry lies where photons stop on the
    average).

    frequency: along the direction they lean to, 1/mm. tangent: of the angle of incidence.
    """
    converter = spec.converter
    if not spec.oblique_incidence or not isinstance(converter, CaesiumIodide | Selenium) or tangent == 0.0:
        return np.ones(frequency.shape, np.complex128)
    mu = float(cross_sections(material(converter.material), spec.reference_energy_keV).photo)
    mu *= float(np.hypot(1.0, tangent))  # paths are longer than the depth
    depth = converter.thickness_mm
    absorbed = -np.expm1(-mu * depth)
    turn = 2j * np.pi * frequency * tangent
    mean = 1 / mu - depth * np.exp(-mu * depth) / absorbed
    return np.asarray(mu * -np.expm1(-(mu + turn) * depth) / ((mu + turn) * absorbed) * np.exp(turn * mean))


def table_power(spec: TablePower, pixel: float) -> RadialFunction:
    """The measured power of pixels, 1 at frequency 0.

    raises: SpecError where it ends below the Nyquist frequency.
    """
    _reaches(spec.frequencies_per_mm, pixel, "noise.power")
    values = np.array(spec.values) / spec.values[0]
    return lambda f: np.interp(f, spec.frequencies_per_mm, values)


def _reaches(frequencies: list[float], pixel: float, field: str) -> None:
    nyquist = 0.5 / pixel
    if frequencies[-1] < nyquist * (1 - 1e-6):
        message = (
            f"{field}.frequencies_per_mm end at {frequencies[-1]:g} per mm; they must reach the Nyquist frequency "
            f"{nyquist:g} of a pixel of {pixel:g} mm: give values up to there"
        )
        problems = [{"field": f"{field}.frequencies_per_mm", "value": frequencies[-1], "message": message}]
        raise SpecError(message, problems=problems)


def _without_aperture(transfer: TableTransfer, aperture: float, pixel: float) -> RadialFunction:
    nodes = np.linspace(0, 0.5 / pixel, 513)
    values = np.interp(nodes, transfer.frequencies_per_mm, transfer.values)
    own = np.sinc(nodes * aperture)
    above = values - own
    worst = int(np.argmax(above))
    if above[worst] > ABOVE_APERTURE:
        message = (
            f"transfer.values give {values[worst]:.3f} at {nodes[worst]:.3g} per mm, above the {own[worst]:.3f} of the "
            f"aperture of {aperture:.3g} mm alone: the table is of smaller pixels, or converter.fill_factor is smaller"
        )
        problems = [{"field": "transfer.values", "value": float(values[worst]), "message": message}]
        raise SpecError(message, problems=problems)
    return lambda f: np.interp(f, nodes, values / own)


def _fluorescence(converter: Selenium, energy: float) -> tuple[RadialFunction, QuantumPower]:
    layer = material(converter.material)
    at = np.array(energy)
    depth = cross_sections(layer, at).photo * converter.thickness_mm
    lines = []
    for line in k_lines(layer, at):
        share, leaves = float(line.share), float(escape(layer, converter.thickness_mm, depth, line.energy))
        lines.append((line.energy, float(attenuation(layer, line.energy)), share * (1 - leaves), share * leaves))
    gone = sum(lost * e for e, _, _, lost in lines)
    kept = sum(stays * e for e, _, stays, _ in lines)
    square = energy**2 + sum(lost * ((energy - e) ** 2 - energy**2) for e, _, _, lost in lines)
    apart = sum(stays * 2 * (energy - e) * e for e, _, stays, _ in lines)

    def transfer(f: FloatArray) -> FloatArray:
        spread = sum(stays * e * _isotropic(f, mu) for e, mu, stays, _ in lines)
        return np.asarray((energy - gone - kept + spread) / (energy - gone))

    def power(f: FloatArray) -> FloatArray:
        spread = sum(stays * 2 * (energy - e) * e * _isotropic(f, mu) for e, mu, stays, _ in lines)
        return np.asarray((square - apart + spread) / square)

    return transfer, QuantumPower(power, float((square - apart) / square))


def _isotropic(f: FloatArray, mu: float) -> FloatArray:
    """(mu / 2 pi f) atan(2 pi f / mu)."""
    x = np.maximum(2 * np.pi * np.asarray(f, np.float64) / mu, 1e-9)
    return np.asarray(np.arctan(x) / x)
