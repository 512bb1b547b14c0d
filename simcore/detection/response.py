"""Absorbed energy and its variance of one photon, over energy and angle of incidence.

Photons are absorbed by the photo-effect; a K photon may follow and leave through either face of the layer
(free path of the layer, isotropic). With p_i the probability that a photon of line i leaves, given an absorption,

    signal   = a (E - sum p_i E_i)
    variance = a ((1 - sum p_i) E^2 + sum p_i (E - E_i)^2) / swank,

a = fill x transmission of the cover x (1 - exp(-mu t / cos)). Quanta are Poisson, so the sums of these over photons are
mean and variance of a pixel (R. K. Swank, J. Appl. Phys. 44 (1973) 4199).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simcore.detection.converters.csi import CaesiumIodide
from simcore.detection.converters.ideal import Ideal
from simcore.detection.converters.selenium import Selenium
from simcore.physics.attenuation import attenuation, cross_sections
from simcore.physics.materials import Material, material
from simcore.physics.tables import elements, k_shells

FloatArray = NDArray[np.float64]
Converter = CaesiumIodide | Selenium | Ideal
DEPTHS = 32
COSINES = 64


class Response(NamedTuple):
    """Per photon that falls on the cover, in the common shape of energies and cosines.

    absorbed: probability that it is absorbed. signal: mean energy that stays, keV. variance: what it adds to the
    variance of a pixel, keV^2.
    """

    absorbed: FloatArray
    signal: FloatArray
    variance: FloatArray

    @property
    def swank(self) -> FloatArray:
        """signal^2 / (absorbed variance): the fluctuations of one absorbed photon, K fluorescence included."""
        return np.asarray(self.signal**2 / (self.absorbed * self.variance))


class ResponseTable(NamedTuple):
    """As a transport counts photons by energy and angle.

    energies_keV: (n,), ascending. cosines: (m,), ascending. absorbed: (n, m), mean energy that stays over that of the
    photon. squared: (n, m), mean square of the same; over ``swank`` it makes the variance of a pixel.
    """

    energies_keV: FloatArray
    cosines: FloatArray
    absorbed: FloatArray
    squared: FloatArray
    swank: float


class KLine(NamedTuple):
    """A fluorescence line: probability of it per absorption above the edge, energies in keV."""

    share: FloatArray
    energy: float


def response(converter: Converter, energies_keV: ArrayLike, cosines: ArrayLike = 1.0) -> Response:
    """What a photon leaves in the converter: the weights of signal and variance, and the table of a transport.

    energies_keV: 1 to 150. cosines: of the angle of incidence, above 0; both are broadcast, e.g. (n, 1) and (m,).
    """
    energies, cosines = np.broadcast_arrays(np.asarray(energies_keV, np.float64), np.asarray(cosines, np.float64))
    if cosines.size and not (cosines.min() > 0 and cosines.max() <= 1):
        raise ValueError(f"cosines of {cosines.min():g} .. {cosines.max():g} are outside of 0 .. 1")
    if isinstance(converter, Ideal):
        return Response(np.ones(energies.shape), energies * 1.0, energies**2)
    layer = material(converter.material)
    depth = cross_sections(layer, energies).photo * converter.thickness_mm / cosines
    cover = attenuation(material(converter.cover_material), energies) * converter.cover_mm / cosines
    absorbed = converter.fill_factor * np.exp(-cover) * -np.expm1(-depth)
    mean, square = energies * 1.0, energies**2
    for line in k_lines(layer, energies):
        leaves = line.share * escape(layer, converter.thickness_mm, depth, line.energy)
        mean = mean - leaves * line.energy
        square = square + leaves * ((energies - line.energy) ** 2 - energies**2)
    return Response(absorbed, absorbed * mean, absorbed * square / converter.swank)


def response_table(converter: Converter, highest_keV: float) -> ResponseTable:
    """The response from 1 keV in steps of 0.5 keV to the first one at or above ``highest_keV``, over 64 cosines.

    The cover is in it: it is no plate of the transport as well.
    """
    energies = np.arange(2, 2 * np.ceil(2 * highest_keV) / 2 + 1) / 2
    cosines = np.arange(1, COSINES + 1) / COSINES
    answer = response(converter, energies[:, None], cosines)
    swank = 1.0 if isinstance(converter, Ideal) else converter.swank
    ratio = energies[:, None]
    return ResponseTable(energies, cosines, answer.signal / ratio, swank * answer.variance / ratio**2, swank)


def k_lines(layer: Material, energies: FloatArray) -> list[KLine]:
    """K-alpha and K-beta of every element of a layer whose edge the energies reach."""
    photo = {
        symbol: fraction * np.exp(np.interp(np.log(energies), np.log(table.energies), np.log(table.photo)))
        for symbol, fraction in layer.mass_fractions.items()
        for table in [elements()[symbol]]
    }
    total = sum(photo.values())
    lines = []
    for symbol, part in photo.items():
        shell = k_shells().get(symbol)
        if shell is None:
            continue
        share = np.where(energies > shell.edge_keV, part / total * shell.k_share * shell.fluorescence_yield, 0.0)
        if share.any():
            lines.append(KLine(share * shell.k_alpha_share, shell.k_alpha_keV))
            lines.append(KLine(share * (1 - shell.k_alpha_share), shell.k_beta_keV))
    return lines


def absorbed_depths(depth: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Places between the faces, 0 to 1, and weights that sum to 1, of where photons are absorbed.

    depth: free paths through the layer along the photon, any shape; both results have one axis more, the last.
    """
    nodes, weights = np.polynomial.legendre.leggauss(DEPTHS)
    places = (nodes + 1) / 2
    density = weights * np.exp(-depth[..., None] * places)
    return places, density / density.sum(axis=-1, keepdims=True)


def escape(layer: Material, thickness: float, depth: FloatArray, line_keV: float) -> FloatArray:
    """Probability that an isotropic photon of the line leaves the layer."""
    from scipy.special import expn

    places, weights = absorbed_depths(depth)
    paths = float(attenuation(layer, line_keV)) * thickness
    leaves = (expn(2, paths * places) + expn(2, paths * (1 - places))) / 2
    return np.asarray((weights * leaves).sum(axis=-1))
