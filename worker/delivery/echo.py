"""Testing a destination: an association, C-ECHO, and which of our SOP classes it accepts."""

from __future__ import annotations

import time
from typing import Any

from pydicom.uid import (
    BreastProjectionXRayImageStorageForPresentation,
    BreastProjectionXRayImageStorageForProcessing,
    BreastTomosynthesisImageStorage,
    Comprehensive3DSRStorage,
    CTImageStorage,
    DigitalMammographyXRayImageStorageForPresentation,
    DigitalMammographyXRayImageStorageForProcessing,
    ExplicitVRLittleEndian,
    ImplicitVRLittleEndian,
    ParametricMapStorage,
    SegmentationStorage,
)

from simcore.core.errors import SimulationError
from tomosim_contract.destination import Destination
from worker.delivery import association
from worker.delivery.association import Kind
from worker.settings import Settings

LABEL_MAP_SEGMENTATION = "1.2.840.10008.5.1.4.1.1.66.7"

SOP_CLASSES = (
    DigitalMammographyXRayImageStorageForProcessing,
    DigitalMammographyXRayImageStorageForPresentation,
    BreastProjectionXRayImageStorageForProcessing,
    BreastProjectionXRayImageStorageForPresentation,
    BreastTomosynthesisImageStorage,
    LABEL_MAP_SEGMENTATION,
    SegmentationStorage,
    ParametricMapStorage,
    Comprehensive3DSRStorage,
    CTImageStorage,
)
"""What cases consist of (simcore.dicom)."""


def echo(destination: Destination, settings: Settings) -> dict[str, Any]:
    """reachable, code, message, seconds, accepted and refused: as in the API."""
    kinds = [
        Kind(str(c), str(syntax)) for c in SOP_CLASSES for syntax in (ExplicitVRLittleEndian, ImplicitVRLittleEndian)
    ]
    started = time.monotonic()
    try:
        peer = association.connect(
            destination,
            kinds,
            allowed=settings.allowed_destinations,
            secrets=settings.resolved_secrets_folder,
        )
        try:
            peer.echo()
            accepted = [str(c) for c in SOP_CLASSES if peer.accepts(str(c))]
        finally:
            peer.close()
    except SimulationError as error:
        return _answer(False, error.code, str(error), started, [])
    what = "it answered" if peer.offers_echo else "it accepted the association (and offers no C-ECHO)"
    return _answer(
        True, "ok", f"{what}; it accepts {len(accepted)} of our {len(SOP_CLASSES)} classes", started, accepted
    )


def _answer(reachable: bool, code: str, message: str, started: float, accepted: list[str]) -> dict[str, Any]:
    refused = [str(c) for c in SOP_CLASSES if str(c) not in accepted] if reachable else []
    return {
        "reachable": reachable,
        "code": code,
        "message": message,
        "seconds": round(time.monotonic() - started, 3),
        "accepted": [association.name_of(c) for c in accepted],
        "refused": [association.name_of(c) for c in refused],
    }
