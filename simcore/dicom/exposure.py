"""Tube, filter, load and dose in the words of DICOM: what is simulated, and zero for what is not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from simcore.dicom.values import decimal


@dataclass(frozen=True)
class Exposure:
    """Technique of a whole acquisition; load and dose are shared equally by its views, 0 where not simulated.

    peak_kV:         kV. anode, filter_material: terms of DICOM (TUNGSTEN, RHODIUM, ...), "NONE" for no filter.
    filter_mm:       thickness of the filter, mm. half_value_layer_mm: mm of aluminium.
    load_mAs, seconds: tube load, and time that the tube radiates.
    entrance_dose_mGy, glandular_dose_mGy: dose at the entrance of the breast, mean dose of its glandular tissue.
    remark:          what a reader must know.
    """

    peak_kV: float
    anode: str = "SIMULATED"
    filter_material: str = "NONE"
    filter_mm: float = 0.0
    half_value_layer_mm: float = 0.0
    load_mAs: float = 0.0
    seconds: float = 0.0
    entrance_dose_mGy: float = 0.0
    glandular_dose_mGy: float = 0.0
    remark: str = "simulation; what is not modelled stands as 0"

    @classmethod
    def monoenergetic(cls, energy_keV: float) -> Exposure:
        """A source of one energy, without tube and dose."""
        return cls(
            energy_keV,
            remark="monoenergetic simulation: peak kV is the photon energy; load and dose not modelled, stand as 0",
        )

    @property
    def current_mA(self) -> float:
        """Mean tube current, mA."""
        return self.load_mAs / self.seconds if self.seconds else 0.0

    def filter(self) -> dict[str, Any]:
        """Filter attributes."""
        if self.filter_material == "NONE":
            return {"FilterType": "NONE", "FilterMaterial": "NONE"}
        thickness = decimal(self.filter_mm)
        return {
            "FilterType": "FLAT",
            "FilterMaterial": self.filter_material,
            "FilterThicknessMinimum": thickness,
            "FilterThicknessMaximum": thickness,
        }

    def load(self, share: float) -> dict[str, float]:
        """Tube load attributes of a share (one view, or 1 for all), as floats."""
        return {
            "ExposureInmAs": self.load_mAs * share,
            "ExposureTimeInms": 1000.0 * self.seconds * share,
            "XRayTubeCurrentInmA": self.current_mA,
        }

    def dose(self, share: float) -> dict[str, str]:
        """Dose attributes of a share: Organ Dose is in dGy."""
        return {
            "OrganDose": decimal(self.glandular_dose_mGy * share / 100.0),
            "EntranceDoseInmGy": decimal(self.entrance_dose_mGy * share),
        }
