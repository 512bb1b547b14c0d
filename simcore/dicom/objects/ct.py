"""The slices of the volume as CT images, for viewers and toolboxes that know nothing of tomosynthesis."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from functools import partial
from importlib import resources

import numpy as np
from pydicom.uid import CTImageStorage

from simcore.core.errors import ExportError
from simcore.dicom.common import (
    Instance,
    breast_code,
    date_time,
    items,
    set_pixels,
)
from simcore.dicom.study import CT, Study, source_volume
from simcore.dicom.values import decimal


def files(study: Study) -> Iterator[tuple[str, Callable[[], Instance]]]:
    for k in range(study.volume.grid.shape[0]):
        yield f"ct/{k + 1:04d}.dcm", partial(ct_image, study, k)


def water_per_mm(energy_keV: float) -> float:
    """Attenuation coefficient of water, 1/mm, log-log interpolated in simcore/data/attenuation_of_water.csv.

    raises: ExportError outside the energies of the table.
    """
    with resources.files("simcore.data").joinpath("attenuation_of_water.csv").open(encoding="utf-8") as lines:
        rows = [(float(r["energy_keV"]), float(r["mu_per_mm"])) for r in csv.DictReader(lines)]
    energies, values = (np.log(column) for column in zip(*rows, strict=True))
    if not energies[0] <= np.log(energy_keV) <= energies[-1]:
        raise ExportError(
            f"CT numbers at {energy_keV:g} keV: the table of water goes from {rows[0][0]:g} to {rows[-1][0]:g} keV; "
            "leave 'ct' out of export.extra_objects"
        )
    return float(np.exp(np.interp(np.log(energy_keV), energies, values)))


def ct_image(study: Study, k: int) -> Instance:
    """Slice ``k`` (0-based) with the stored values of the volume; the rescaling gives Hounsfield units."""
    dataset = study.dataset(CT, CTImageStorage, "CT", k + 1)
    volume, spec = study.volume, study.spec
    sx, sy, sz = (decimal(spacing) for spacing in volume.grid.spacing)
    water = water_per_mm(study.case.energy_keV)
    slope = 1000.0 * volume.slope / water
    intercept = 1000.0 * (volume.intercept - water) / water
    position = study.frames.image_position(volume.grid, k)
    # A required attribute; the patient stands, for which there is no term.
    dataset.PatientPosition = ""
    dataset.Laterality = spec.laterality
    dataset.BodyPartExamined = "BREAST"
    dataset.AnatomicRegionSequence = breast_code()
    dataset.ImageType = ["DERIVED", "PRIMARY", "AXIAL"]
    dataset.ImageComments = f"tomosynthesis reconstruction, {study.case.reconstruction}; {study.exposure.remark}"
    dataset.AcquisitionDate, dataset.AcquisitionTime = spec.date, spec.time
    dataset.AcquisitionDateTime = date_time(spec)
    dataset.AcquisitionNumber = 1
    dataset.QualityControlImage = "YES"
    dataset.BurnedInAnnotation = "NO"
    dataset.LossyImageCompression = "00"
    dataset.KVP = decimal(study.exposure.peak_kV)
    dataset.PixelSpacing = [sy, sx]
    dataset.SliceThickness = dataset.SpacingBetweenSlices = sz
    dataset.ImageOrientationPatient = study.frames.image_orientation()
    dataset.ImagePositionPatient = position
    dataset.SliceLocation = decimal(float(volume.grid.centres("z")[k]))
    dataset.SourceImageSequence = items(source_volume(study, frame=k + 1))
    dataset.PhotometricInterpretation = "MONOCHROME2"
    dataset.RescaleSlope = decimal(slope)
    dataset.RescaleIntercept = decimal(intercept)
    dataset.RescaleType = "HU"
    low, high = study.volume_window
    dataset.WindowCenter = decimal(slope * (low + high) / 2 + intercept)
    dataset.WindowWidth = decimal(max(slope * (high - low), 1.0))
    study.add_private(dataset, "ct", value_slope=volume.slope, value_intercept=volume.intercept, value_unit="1/mm")
    return set_pixels(dataset, volume.data[k : k + 1], 16)
