"""What to ask of a case with an X-ray tube, scatter, a detector with noise, and dose: ``physics.kind = "xray"``."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

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
