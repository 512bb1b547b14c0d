"""The detector that absorbs every photon and counts its energy where it fell."""

from __future__ import annotations

from typing import Literal

from simcore.core.spec_base import Spec, quantity


class Ideal(Spec):
    """Nothing is lost, nothing spreads beyond the aperture."""

    kind: Literal["ideal"] = "ideal"
    electrons_per_keV: float = quantity(
        "electrons read per absorbed energy; the unit of electronic noise alone",
        unit="1/keV",
        default=20.0,
        gt=0.0,
        le=1000.0,
    )
