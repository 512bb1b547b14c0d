"""The exposure that a target needs: put back, it gives the target."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pydantic import ValidationError

from simcore.core.errors import SpecError
from simcore.physics.exposure import (
    AirKerma,
    ContrastToNoise,
    DetectorSignal,
    GlandularDose,
    Response,
    TubeLoad,
    solve,
)

RESPONSE = Response(dose_mGy=0.27, load_mAs=12.0, signal=70.0, variance=9.0, contrast=4.0, electronic_variance=30.0)


def test_the_target_is_met() -> None:
    assert solve(AirKerma(mGy=4.0), RESPONSE) == 4.0
    assert solve(GlandularDose(mGy=1.3), RESPONSE) * RESPONSE.dose_mGy == pytest.approx(1.3, rel=1e-12)
    assert solve(TubeLoad(mAs=60.0), RESPONSE) * RESPONSE.load_mAs == pytest.approx(60.0, rel=1e-12)
    assert solve(DetectorSignal(value=500.0), RESPONSE) * RESPONSE.signal == pytest.approx(500.0, rel=1e-12)


@pytest.mark.parametrize("ratio", [0.01, 1.0, 5.0, 100.0])
@pytest.mark.parametrize("electronic", [0.0, 30.0, 1e4])
def test_contrast_to_noise_is_met_with_electronic_noise_too(ratio: float, electronic: float) -> None:
    response = Response(0.27, 12.0, 70.0, 9.0, 4.0, electronic)
    kerma = solve(ContrastToNoise(ratio=ratio), response)
    noise = math.sqrt(kerma * response.variance + electronic)
    assert kerma * response.contrast / noise == pytest.approx(ratio, rel=1e-9)


def test_views_share_the_exposure() -> None:
    np.testing.assert_allclose(AirKerma().shares(5), 0.2)
    np.testing.assert_allclose(AirKerma(view_shares=(1.0, 2.0, 1.0)).shares(3), [0.25, 0.5, 0.25])
    with pytest.raises(SpecError, match=r"physics\.exposure\.view_shares: 3 shares for 5 views"):
        AirKerma(view_shares=(1.0, 2.0, 1.0)).shares(5)
    with pytest.raises(ValidationError, match="above 0"):
        AirKerma(view_shares=(0.0, 0.0))
