"""Who and what a case is: unique identifiers that depend on nothing but the inputs and the content.

An archive keeps the old file silently when a known SOP Instance UID arrives with new content. All identifiers of a
case therefore hang on one root: the digest of ``CaseDescription``, of the export specification, of the geometry and
of every pixel that is written. The same inputs give the same identifiers and the same bytes; any change of content
gives a new study.
"""

from __future__ import annotations

import hashlib
import json
import uuid
from dataclasses import asdict, dataclass
from typing import Any

from simcore.dicom.exposure import Exposure

FORMAT = 3
"""Revision of what is written: raised whenever attributes change, so that old and new files differ in identity."""

_NAMESPACE = uuid.uuid5(uuid.NAMESPACE_DNS, "tomosim")

IMPLEMENTATION_UID = f"2.25.{uuid.uuid5(_NAMESPACE, 'implementation').int}"


@dataclass(frozen=True)
class CaseDescription:
    """What the files say about the simulation that made them.

    identity:         hexadecimal sha256 of the specification and the software version (may cover the inputs too).
    seed:             seed of the random streams.
    software_version: version of the simulation software.
    energy_keV:       photon energy that the values of the volume hold for, keV.
    detector_bits:    bits stored of a projection pixel, 10 to 16.
    reconstruction_kind: DICOM term of the reconstruction algorithm: FILTER_BACK_PROJ, ITERATIVE, ...
    reconstruction:   the reconstruction in words.
    attenuation_per_mm: true attenuation coefficient of every label at that energy, 1/mm; empty where not told.
    exposure:         tube, filter, load and dose; None for a monoenergetic source.
    """

    identity: str
    seed: int
    software_version: str
    energy_keV: float
    detector_bits: int = 16
    reconstruction_kind: str = "FILTER_BACK_PROJ"
    reconstruction: str = "filtered back-projection"
    attenuation_per_mm: tuple[float, ...] = ()
    exposure: Exposure | None = None

    @property
    def short(self) -> str:
        """The first 12 digits of the identity: for names that people read."""
        return self.identity[:12]


def content_root(case: CaseDescription, facts: dict[str, Any]) -> str:
    """The root of all identifiers: digest of the case and of ``facts`` (JSON-ready, with the pixel digests)."""
    text = json.dumps({"format": FORMAT, "case": asdict(case), "facts": facts}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True)
class Identifiers:
    """Unique identifiers under one root: ``ids.uid("series", "projections")``, at most 64 characters each."""

    root: str

    def uid(self, *what: str | int) -> str:
        """2.25.<UUIDv5> of the root and the path ``what``."""
        return f"2.25.{uuid.uuid5(_NAMESPACE, '/'.join([self.root, *map(str, what)])).int}"

    @property
    def study(self) -> str:
        return self.uid("study")

    @property
    def frame_of_reference(self) -> str:
        return self.uid("frame of reference")

    @property
    def irradiation_event(self) -> str:
        return self.uid("irradiation event")

    def series(self, name: str) -> str:
        return self.uid("series", name)

    def instance(self, name: str, number: int = 1) -> str:
        return self.uid("instance", name, number)
