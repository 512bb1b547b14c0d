"""How much a case is exposed: by air kerma, dose, tube load, detector signal or contrast to noise, in closed form.

Signal, its quantum noise and dose are proportional to the incident air kerma, so one projection and one transport serve
every exposure.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from simcore.core.errors import SpecError
from simcore.core.spec_base import Spec, quantity

Share = Annotated[float, Field(ge=0.0, le=1e6)]


class _Exposure(Spec):
    """What all exposures share."""

    view_shares: tuple[Share, ...] | None = Field(
        None,
        strict=False,
        min_length=1,
        max_length=101,
        description="share of each view in the exposure, on any scale; the same for all where not given [1]",
    )

    @model_validator(mode="after")
    def _some_exposure(self) -> Self:
        if self.view_shares is not None and not sum(self.view_shares) > 0:
            raise ValueError("view_shares must have a share above 0")
        return self

    def shares(self, views: int) -> list[float]:
        """Of each view, summing to 1. raises: SpecError where there are as many shares as another number of views"""
        if self.view_shares is None:
            return views * [1.0 / views]
        if len(self.view_shares) != views:
            message = f"{len(self.view_shares)} shares for {views} views: one for each view, or none"
            raise SpecError(
                f"physics.exposure.view_shares: {message}",
                problems=[{"field": "physics.exposure.view_shares", "value": None, "message": message}],
            )
        total = sum(self.view_shares)
        return [share / total for share in self.view_shares]


class AirKerma(_Exposure):
    """Incident air kerma: at the reference point of the dose, without backscatter, of all views together."""

    kind: Literal["air_kerma"] = "air_kerma"
    mGy: float = quantity("incident air kerma of all views", unit="mGy", default=5.0, gt=0.0, le=1000.0)


class GlandularDose(_Exposure):
    """Mean glandular dose of this breast, of all views together."""

    kind: Literal["mean_glandular_dose"] = "mean_glandular_dose"
    mGy: float = quantity("mean glandular dose of all views", unit="mGy", default=1.3, gt=0.0, le=100.0)


class TubeLoad(_Exposure):
    """Tube current times time, of all views together."""

    kind: Literal["tube_load"] = "tube_load"
    mAs: float = quantity("tube current times time of all views", unit="mAs", default=60.0, gt=0.0, le=10000.0)


class DetectorSignal(_Exposure):
    """Automatic exposure: pixel value behind the densest part of the breast, mean over the views."""

    kind: Literal["detector_signal"] = "detector_signal"
    value: float = quantity("pixel value above the offset, of a mean view", unit="1", default=400.0, gt=0.0, le=65535.0)


class ContrastToNoise(_Exposure):
    """Automatic exposure: contrast of 0.2 mm of aluminium to the noise of a pixel behind the densest part of the
    breast, in a view of mean exposure."""

    kind: Literal["contrast_to_noise"] = "contrast_to_noise"
    ratio: float = quantity("contrast to noise of a pixel", unit="1", default=1.0, gt=0.0, le=1000.0)


ExposureSpec = Annotated[
    AirKerma | GlandularDose | TubeLoad | DetectorSignal | ContrastToNoise,
    Field(discriminator="kind", description="how much the case is exposed"),
]
"""Union by ``kind``."""


@dataclass(frozen=True)
class Response:
    """What a case gives for an incident air kerma of 1 mGy in all its views together.

    dose_mGy: mean glandular dose. load_mAs: tube current times time. signal: pixel value above the offset behind the
    densest part of the breast, in a view of mean exposure. variance: of its quantum noise there. contrast: what 0.2 mm
    of aluminium takes from that signal. electronic_variance: of a pixel, whatever the exposure.
    """

    dose_mGy: float
    load_mAs: float
    signal: float
    variance: float
    contrast: float
    electronic_variance: float


def solve(spec: ExposureSpec, response: Response) -> float:
    """Incident air kerma of all views together, mGy."""
    if isinstance(spec, AirKerma):
        return spec.mGy
    if isinstance(spec, GlandularDose):
        return spec.mGy / response.dose_mGy
    if isinstance(spec, TubeLoad):
        return spec.mAs / response.load_mAs
    if isinstance(spec, DetectorSignal):
        return spec.value / response.signal
    # (K c)^2 = r^2 (K v + e): the positive root.
    half = spec.ratio**2 * response.variance / (2 * response.contrast**2)
    return half + math.sqrt(half**2 + (spec.ratio / response.contrast) ** 2 * response.electronic_variance)
