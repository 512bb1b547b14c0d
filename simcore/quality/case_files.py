"""A case folder as ``tomosim simulate --out`` writes it, read view by view and slice by slice.

What is needed of the DICOM objects stands in standard attributes; the grid and the open-field value stand in their
private JSON element.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
from numpy.typing import NDArray
from pydicom.errors import InvalidDicomError
from pydicom.pixels import iter_pixels

from simcore.core.errors import SpecError
from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid

PRIVATE_GROUP = 0x0099
PRIVATE_CREATOR = "TOMOSIM 1"
VOLUME = "tomosynthesis.dcm"
LABELS = "labels.dcm"


@dataclass(frozen=True)
class CaseFiles:
    """The files of one case below ``folder``."""

    folder: Path

    @cached_property
    def manifest(self) -> dict[str, Any]:
        return self._json("manifest.json")

    @cached_property
    def geometry(self) -> AcquisitionGeometry:
        return AcquisitionGeometry.from_dict(self._json("geometry.json"))

    @cached_property
    def projections(self) -> list[Path]:
        """One file a view, in the order of the views.

        raises: SpecError where their number is not that of the views.
        """
        files = sorted((self.folder / "projections").glob("*.dcm"))
        if len(files) != self.geometry.views:
            raise _unreadable(f"{self.folder} holds {len(files)} projections of {self.geometry.views} views")
        return files

    def projection(self, view: int) -> tuple[NDArray[np.uint16], float]:
        """Stored values of one view, uint16 (ny, nx), and the value of the open field."""
        dataset = self._dicom(self.projections[view])
        return dataset.pixel_array, float(_private(dataset)["open_field"])

    @cached_property
    def volume_grid(self) -> Grid:
        return Grid.from_dict(_private(self._header(VOLUME))["grid"])

    @cached_property
    def volume_values(self) -> tuple[float, float]:
        """(slope, intercept): attenuation [1/mm] = slope x stored value + intercept."""
        groups = self._header(VOLUME).SharedFunctionalGroupsSequence[0]
        mapping = groups.RealWorldValueMappingSequence[0]
        return float(mapping.RealWorldValueSlope), float(mapping.RealWorldValueIntercept)

    def slices(self) -> Iterator[tuple[NDArray[np.uint16], NDArray[np.uint8]]]:
        """(stored values, labels) of every slice, (ny, nx), from the breast support upwards.

        raises: SpecError where labels and volume do not lie on the same grid.
        """
        if Grid.from_dict(_private(self._header(LABELS))["grid"]) != self.volume_grid:
            raise _unreadable(f"{LABELS} and {VOLUME} in {self.folder} do not lie on the same grid")
        yield from zip(iter_pixels(self.folder / VOLUME), iter_pixels(self.folder / LABELS), strict=True)

    def _json(self, name: str) -> dict[str, Any]:
        try:
            return json.loads((self.folder / name).read_bytes())  # type: ignore[no-any-return]
        except (OSError, ValueError) as error:
            raise _unreadable(f"{self.folder / name}: {error}") from error

    def _header(self, name: str) -> pydicom.Dataset:
        return self._dicom(self.folder / name, stop_before_pixels=True)

    def _dicom(self, path: Path, stop_before_pixels: bool = False) -> pydicom.Dataset:
        try:
            return pydicom.dcmread(path, stop_before_pixels=stop_before_pixels)
        except (OSError, InvalidDicomError) as error:
            raise _unreadable(f"{path}: {error}") from error


def _private(dataset: pydicom.Dataset) -> dict[str, Any]:
    try:
        block = dataset.private_block(PRIVATE_GROUP, PRIVATE_CREATOR)
        return json.loads(block[0x01].value)  # type: ignore[no-any-return]
    except (KeyError, ValueError) as error:
        raise _unreadable(f"{dataset.get('SOPInstanceUID')} is not an object of tomosim: {error}") from error


def _unreadable(what: str) -> SpecError:
    return SpecError(f"not a case: {what}; 'tomosim simulate SPEC.json --out DIR' writes one", code="case-not-readable")
