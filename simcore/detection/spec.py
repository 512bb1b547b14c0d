"""What to ask of a detector: converter, blur, noise, fixed pattern, read-out. Data alone."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from simcore.core.spec_base import Spec, quantity
from simcore.detection.converters.csi import CaesiumIodide
from simcore.detection.converters.ideal import Ideal
from simcore.detection.converters.selenium import Selenium
from simcore.detection.transfer import ApertureTransfer, ConverterPower, PowerSpec, TransferSpec

ConverterSpec = Annotated[
    CaesiumIodide | Selenium | Ideal,
    Field(discriminator="kind", description="what turns X-rays into signal"),
]
"""Union by ``kind``: a new converter is one file and one more member here."""


class NoNoise(Spec):
    """Expected values alone; the fixed pattern of the detector stays."""

    kind: Literal["none"] = "none"


class GaussianNoise(Spec):
    """Quantum noise, correlated as the converter does it, and electronic noise."""

    kind: Literal["gaussian-correlated"] = "gaussian-correlated"
    realisation: int = Field(
        0, ge=0, le=2**31 - 1, description="number of the noise realisation; changes the noise and nothing else [1]"
    )
    power: PowerSpec = ConverterPower()


NoiseSpec = Annotated[NoNoise | GaussianNoise, Field(discriminator="kind", description="random noise of every view")]


class ElectronicNoise(Spec):
    """Added to every pixel after all blur."""

    sigma: float = quantity("standard deviation", unit="electrons or DN", default=0.0, ge=0.0, le=1e6)
    unit: Literal["electrons", "DN"] = Field("electrons", description="unit of sigma")


class FixedPattern(Spec):
    """What one detector has and keeps: the same in every view, case and noise realisation."""

    serial: int = Field(0, ge=0, le=2**31 - 1, description="which detector: another one has another pattern [1]")
    gain_spread: float = quantity("standard deviation of the gain of pixels", unit="1", default=0.0, ge=0.0, le=0.1)
    column_spread: float = quantity(
        "standard deviation of the gain of whole columns", unit="1", default=0.0, ge=0.0, le=0.1
    )
    structure: float = quantity(
        "standard deviation of the gain that no flat field removes", unit="1", default=0.0, ge=0.0, le=0.1
    )
    dead_fraction: float = quantity("part of the pixels that give no signal", unit="1", default=0.0, ge=0.0, le=0.05)
    dead_columns: int = Field(0, ge=0, le=50, description="columns that give no signal [1]")


class FlatField(Spec):
    """How raw becomes For Processing."""

    frames: int | None = Field(
        None,
        ge=1,
        le=100000,
        description="open-field exposures that the gain map is measured from; where not given it is known exactly [1]",
    )
    dead_pixels: Literal["interpolate", "leave"] = Field(
        "interpolate", description="interpolate: the mean of the nearest pixels of the row that live on either side"
    )
    open_field_value: float = quantity(
        "pixel value where nothing but the plates is in the beam", unit="DN", default=16000.0, ge=100.0, le=60000.0
    )


class DetectionSpec(Spec):
    """From absorbed energy to numbers."""

    converter: ConverterSpec = Ideal()
    transfer: TransferSpec = ApertureTransfer()
    noise: NoiseSpec = GaussianNoise()
    electronic_noise: ElectronicNoise = ElectronicNoise()
    oblique_incidence: bool = Field(
        True, description="whether photons that cross the converter at the view's angle blur along the tube travel"
    )
    reference_energy_keV: float = quantity(
        "photon energy at which oblique incidence and K fluorescence blur", unit="keV", default=20.0, ge=5.0, le=60.0
    )
    focal_spot_mm: float = quantity(
        "edge of the focal spot, which blurs as at the middle of the breast; 0 for a point",
        unit="mm",
        default=0.3,
        ge=0.0,
        le=3.0,
    )
    lag: float = quantity(
        "part of a view's signal that the next one shows again (in the order of the views)",
        unit="1",
        default=0.0,
        ge=0.0,
        le=0.5,
    )
    gain_DN_per_keV: float | None = Field(
        None,
        gt=0.0,
        le=1e4,
        json_schema_extra={"unit": "DN/keV"},
        description="pixel values per absorbed energy; where not given, so that the brightest expected pixel stands at "
        "80 % of the range [DN/keV]",
    )
    offset_DN: float = quantity("pixel value without exposure", unit="DN", default=50.0, ge=0.0, le=60000.0)
    bits: int = Field(14, ge=8, le=16, description="bits of a raw pixel [1]")
    full_well_electrons: float | None = Field(
        None,
        gt=0.0,
        le=1e12,
        json_schema_extra={"unit": "electrons"},
        description="charge that a pixel holds; where not given, the bits limit it alone [electrons]",
    )
    saturation: Literal["refuse", "clip"] = Field(
        "refuse", description="what to do where the expected signal exceeds what a pixel can hold"
    )
    pattern: FixedPattern = FixedPattern()
    flat_field: FlatField = FlatField()

    @model_validator(mode="after")
    def _has_room(self) -> Self:
        largest = 2**self.bits - 1
        if self.offset_DN > 0.5 * largest:
            raise ValueError(
                f"offset_DN = {self.offset_DN:g} leaves less than half of the {self.bits} bits (up to {largest}) for "
                f"signal: at most {0.5 * largest:g}, or more bits"
            )
        return self
