"""The heel effect against the package that its table comes from."""

from __future__ import annotations

import numpy as np
import pytest

from simcore.physics.heel import emission_beside, heel_factor, slant, take_off_angle
from simcore.physics.spec import FilterSpec, MeasuredSpectrum, TubeSpec
from simcore.physics.spectrum import air_kerma, emission, value_layer

W_RH = TubeSpec(inherent=(FilterSpec(material="beryllium", thickness_mm=1.0),))
"""28 kV, 0.05 mm of rhodium."""
KERMA_ON_THE_AXIS = 0.0214471
"""mGy a mAs at 1 m: SpekPy 2.5.4 ("casim", steps of 0.1 keV), target angle 22 degrees."""
LAYER_ON_THE_AXIS = 0.45638
"""mm Al, there too."""


@pytest.mark.parametrize(
    ("target", "towards_anode", "sideways", "layer", "kerma"),
    [
        (22.0, 0.29, 0.0, 0.48303, 0.0159572),
        (22.0, 0.15, 0.0, 0.46411, 0.0200469),
        (22.0, -0.15, 0.0, 0.44966, 0.0212812),
        (22.0, -0.29, 0.0, 0.44225, 0.0201637),
        (22.0, 0.0, 0.20, 0.45328, 0.0206842),
        (16.0, 0.0, 0.0, 0.46229, 0.0208873),
        (16.0, -0.20, 0.0, 0.44987, 0.0208796),
    ],
)
def test_the_beam_weakens_and_hardens_towards_the_anode(
    target: float, towards_anode: float, sideways: float, layer: float, kerma: float
) -> None:
    """SpekPy 2.5.4 with 1 mm of beryllium, at the same distance; aluminium is crossed at a slant there, too."""
    beam = emission_beside(W_RH, 0.0, towards_anode, sideways, target)
    obliquity = float(slant(towards_anode, sideways))
    axis = emission_beside(W_RH, 0.0, 0.0, 0.0)
    harder = value_layer(beam.energies_keV, beam.photons) / obliquity / value_layer(axis.energies_keV, axis.photons)
    assert harder == pytest.approx(layer / LAYER_ON_THE_AXIS, rel=3e-3)
    assert air_kerma(beam.energies_keV, beam.photons, 1000.0) == pytest.approx(kerma, rel=0.015)
    ratio = heel_factor(W_RH, 0.0, towards_anode, sideways, target) * _kerma_on_axis(target)
    assert ratio == pytest.approx(kerma, rel=0.015)
    relative = heel_factor(W_RH, 0.0, towards_anode, sideways, target) * _kerma_on_axis(target) / _kerma_on_axis(22.0)
    assert relative == pytest.approx(kerma / KERMA_ON_THE_AXIS, rel=3e-3)


def _kerma_on_axis(target: float) -> float:
    beam = emission_beside(W_RH, 0.0, 0.0, 0.0, target)
    return air_kerma(beam.energies_keV, beam.photons, 1000.0)


@pytest.mark.parametrize("kVp", [20.0, 23.1, 28.4, 49.0])
@pytest.mark.parametrize("anode", ["W", "Mo", "Rh"])
def test_the_central_ray_is_that_of_the_tube(anode: str, kVp: float) -> None:
    tube = TubeSpec(anode=anode, kVp=kVp, filters=(FilterSpec(material="rhodium", thickness_mm=0.025),))
    beside, plain = emission_beside(tube, 600.0, 0.0, 0.0), emission(tube, 600.0)
    np.testing.assert_array_equal(beside.energies_keV, plain.energies_keV)
    np.testing.assert_allclose(beside.photons, plain.photons, rtol=1e-12)
    anodewards = heel_factor(tube, 600.0, [0.0, 0.1, 0.2, 0.3], 0.0)
    assert anodewards[0] == pytest.approx(1.0)
    assert (np.diff(anodewards) < 0).all()


def test_tungsten_at_19_cm_beside_the_axis() -> None:
    """22 degrees, 65 cm: -25 % towards the anode, -7 % towards the cathode, with the filters that are crossed."""
    anode, cathode = heel_factor(W_RH, 650.0, [19.0 / 65.0, -19.0 / 65.0], 0.0)
    assert anode == pytest.approx(0.75, abs=0.015)
    assert cathode == pytest.approx(0.93, abs=0.015)


def test_the_factor_keeps_the_shape_and_is_even_in_the_other_direction() -> None:
    factors = heel_factor(W_RH, 600.0, np.array([0.0, 0.15, 0.25])[None, :], np.array([-0.15, 0.0, 0.15])[:, None])
    assert factors.shape == (3, 3)
    np.testing.assert_allclose(factors[0], factors[2])
    assert heel_factor(W_RH, 600.0, np.zeros(0), 0.0).shape == (0,)
    assert take_off_angle(22.0, [0.0, np.tan(np.deg2rad(10.0))], 0.0) == pytest.approx([22.0, 12.0])


def test_a_measured_spectrum_has_no_heel() -> None:
    tube = TubeSpec(measured=MeasuredSpectrum(energies_keV=(18.0, 20.0), photons=(1.0, 2.0)))
    assert (heel_factor(tube, 600.0, [0.0, 0.3], 0.0) == 1).all()
    np.testing.assert_array_equal(emission_beside(tube, 600.0, 0.3, 0.0).photons, emission(tube, 600.0).photons)


def test_an_angle_that_the_table_lacks_is_refused() -> None:
    for field in (0.38, -0.40):
        with pytest.raises(ValueError, match="the table has 3 to 40: use a larger target angle or a narrower field"):
            heel_factor(W_RH, 600.0, field, 0.0)
    with pytest.raises(ValueError, match="use a larger target angle"):
        emission_beside(W_RH, 600.0, 0.30, 0.0, 17.0)
