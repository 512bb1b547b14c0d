"""What to ask of a case with an X-ray tube, scatter, a detector with noise, and dose: ``physics.kind = "xray"``."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from simcore.core.spec_base import Spec
from simcore.detection.spec import DetectionSpec
from simcore.physics.exposure import AirKerma, ExposureSpec
from simcore.physics.spec import MaterialsSpec, TubeSpec
from simcore.projection.spec import PhysicsSpec
from simcore.transport.spec import TransportSpec


class XraySpec(Spec):
    """Spectrum, scatter, detector, noise, dose."""

    kind: Literal["xray"] = "xray"
    tube: TubeSpec = TubeSpec()
    materials: MaterialsSpec = MaterialsSpec()
    transport: TransportSpec = TransportSpec()
    exposure: ExposureSpec = AirKerma()
    detector: DetectionSpec = DetectionSpec()

    @classmethod
    def example(cls) -> XraySpec:
        return cls()

    @model_validator(mode="after")
    def _exposure_can_be_met(self) -> Self:
        by_value = self.exposure.kind == "detector_signal"
        by_noise = self.exposure.kind == "contrast_to_noise" and self.detector.electronic_noise.unit == "DN"
        if (by_value or by_noise) and self.detector.gain_DN_per_keV is None:
            raise ValueError(
                f"exposure.kind = {self.exposure.kind!r} asks for pixel values: detector.gain_DN_per_keV must be given"
            )
        measured = self.tube.measured
        if self.exposure.kind == "tube_load" and measured is not None and measured.mGy_per_mAs is None:
            raise ValueError(
                "exposure.kind = 'tube_load' needs the output of the measured spectrum: tube.measured.mGy_per_mAs"
            )
        return self

    def projection_parameters(self) -> dict[str, Any]:
        """What the primary projections depend on."""
        return {
            "tube": self.tube.model_dump(),
            "materials": self.materials.model_dump(),
            "converter": self.detector.converter.model_dump(),
        }

    def transport_parameters(self) -> dict[str, Any]:
        """What scatter and dose depend on."""
        return {**self.projection_parameters(), "transport": self.transport.model_dump()}

    def detection_parameters(self) -> dict[str, Any]:
        """What the detected views depend on beside those."""
        return {"exposure": self.exposure.model_dump(), "detector": self.detector.model_dump()}


def _with_kind(data: Any) -> Any:
    """Specifications written when there was one kind name none."""
    return {"kind": "monoenergetic", **data} if isinstance(data, dict) else data


AnyPhysicsSpec = Annotated[
    PhysicsSpec | XraySpec,
    Field(discriminator="kind", description="how X-rays become pixel values"),
    BeforeValidator(_with_kind),
]
"""Union by ``kind``."""
