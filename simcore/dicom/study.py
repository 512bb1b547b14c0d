"""The study that all objects of one export belong to, and the acquisition attributes they share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import Dataset
from pydicom.uid import BreastTomosynthesisImageStorage

from simcore.core.artifacts import Phantom, ProjectionStack, Volume
from simcore.core.grid import Grid
from simcore.dicom.common import (
    base_dataset,
    breast_code,
    code,
    item,
    items,
    private_json,
    view_code,
)
from simcore.dicom.exposure import Exposure
from simcore.dicom.geometry import Beam, Frames, beam, gantry_angle
from simcore.dicom.identity import CaseDescription, Identifiers
from simcore.dicom.lesions import Lesion
from simcore.dicom.resampling import Lookup
from simcore.dicom.spec import ExportSpec
from simcore.dicom.values import decimal

MAMMOGRAPHY = "projections, one file a view"
BREAST_PROJECTION = "projections, multi-frame"
TOMOSYNTHESIS = "reconstruction"
LABELS = "tissue labels"
LESIONS = "lesions"
PRESENTATION = "views for presentation"
SYNTHETIC_2D = "synthetic 2D"
CT = "reconstruction, CT slices"
ATTENUATION = "true attenuation"
REPORT = "lesion report"

SERIES_NUMBERS = {
    MAMMOGRAPHY: 1,
    BREAST_PROJECTION: 2,
    TOMOSYNTHESIS: 3,
    LABELS: 4,
    LESIONS: 5,
    PRESENTATION: 6,
    SYNTHETIC_2D: 7,
    CT: 8,
    ATTENUATION: 9,
    REPORT: 10,
}


@dataclass(frozen=True)
class Study:
    """What every object of one export needs to know.

    phantom: compressed, support frame; lookup: its voxels at those of the volume; lesions: what is known of them.
    thickness: distance of the plates, mm; force: N, 0 where it is not known.
    projection_window, volume_window: stored values (low, high) that show the breast.
    """

    spec: ExportSpec
    case: CaseDescription
    ids: Identifiers
    stack: ProjectionStack
    volume: Volume
    phantom: Phantom
    lookup: Lookup
    lesions: tuple[Lesion, ...]
    thickness: float
    force: float
    projection_window: tuple[float, float]
    volume_window: tuple[float, float]

    @property
    def frames(self) -> Frames:
        return Frames(self.stack.geometry, gantry_angle(self.spec))

    @property
    def exposure(self) -> Exposure:
        return self.case.exposure or Exposure.monoenergetic(self.case.energy_keV)

    @property
    def view_share(self) -> float:
        """Part of load and dose that one view has."""
        return 1.0 / self.stack.geometry.views

    def beam(self, view: int) -> Beam:
        return beam(self.frames, view, self.thickness)

    def dataset(self, series: str, sop_class: str, modality: str, instance: int = 1) -> Dataset:
        """A new object of a series with all that is common."""
        return base_dataset(
            self.spec,
            self.case,
            self.ids,
            sop_class=sop_class,
            series=series,
            series_number=SERIES_NUMBERS[series],
            description=f"SYNTHETIC {series}",
            modality=modality,
            instance=instance,
        )

    def add_private(self, dataset: Dataset, schema: str, **facts: Any) -> None:
        """The private block: what the standard does not carry, and the geometry in plain words.

        The signal is open_field x I / I0 + offset with an ideal flat field, I0 without anything in the beam; plates in
        it (support, paddle) have slab_integral as their line integral along z.
        """
        private_json(
            dataset,
            {
                "schema": f"tomosim-{schema}/1",
                "identity": self.case.identity,
                "seed": self.case.seed,
                "software_version": self.case.software_version,
                "energy_keV": self.case.energy_keV,
                "open_field": float(self.stack.open_field),
                "offset": 0.0,
                "flat_field": "ideal",
                **({"slab_integral": self.stack.slab_integral} if self.stack.slab_integral else {}),
                "geometry": self.stack.geometry.to_dict(),
                **facts,
            },
        )


def set_detector(dataset: Dataset, study: Study) -> None:
    """Digital X-Ray Detector macro of the simulated detector."""
    detector = study.stack.geometry.detector
    edge = decimal(detector.pixel)
    dataset.DetectorType = "DIRECT"
    dataset.DetectorConfiguration = "AREA"
    dataset.DetectorID = "SIMULATED"
    dataset.DetectorDescription = "SIMULATED flat detector"
    dataset.DateOfLastDetectorCalibration = study.spec.date
    dataset.TimeOfLastDetectorCalibration = study.spec.time
    dataset.DetectorBinning = ["1", "1"]
    dataset.DetectorElementPhysicalSize = [edge, edge]
    dataset.DetectorElementSpacing = [edge, edge]
    dataset.DetectorActiveShape = "RECTANGLE"
    dataset.DetectorActiveDimensions = [decimal(size) for size in detector_size(study)]
    dataset.DetectorActiveOrigin = ["0", "0"]


def detector_size(study: Study) -> tuple[float, float]:
    """Edges of the detector along the column (y) and along the row (x), mm, as DICOM orders them."""
    detector = study.stack.geometry.detector
    return detector.ny * detector.pixel, detector.nx * detector.pixel


def set_compression(dataset: Dataset, study: Study) -> None:
    """Thickness [mm] and force [N] of the compressed breast."""
    dataset.BodyPartThickness = decimal(study.thickness)
    dataset.CompressionForce = decimal(study.force)
    dataset.PaddleDescription = "SIMULATED FLAT PADDLE"


def set_exposure(dataset: Dataset, study: Study, share: float = 1.0) -> None:
    """Tube and dose of a share of the acquisition: one view, or all."""
    exposure = study.exposure
    dataset.KVP = decimal(exposure.peak_kV)
    # A point source: its focal spot has no extent.
    dataset.FocalSpots = "0"
    dataset.AnodeTargetMaterial = exposure.anode
    dataset.update(item(**exposure.dose(share)))
    dataset.ExposureControlMode = "MANUAL"
    dataset.ExposureControlModeDescription = exposure.remark


def set_breast_image(dataset: Dataset, study: Study) -> None:
    """Quality control mark, view and breast attributes that every breast image has."""
    dataset.QualityControlImage = "YES"
    dataset.BurnedInAnnotation = "NO"
    dataset.LossyImageCompression = "00"
    dataset.BreastImplantPresent = "NO"
    dataset.PartialView = "NO"
    dataset.ViewCodeSequence = view_code(study.spec)
    dataset.AcquisitionContextSequence = []


def frame_anatomy(study: Study) -> Dataset:
    """Item of the Frame Anatomy macro."""
    anatomy = Dataset()
    anatomy.AnatomicRegionSequence = breast_code()
    anatomy.FrameLaterality = study.spec.laterality
    return anatomy


def source_volume(study: Study, frame: int | None = None) -> Dataset:
    """Reference to the volume that an object was made from: to a frame (from 1) that lies voxel on voxel, or to all."""
    source = item(
        ReferencedSOPClassUID=BreastTomosynthesisImageStorage,
        ReferencedSOPInstanceUID=study.ids.instance(TOMOSYNTHESIS),
        PurposeOfReferenceCodeSequence=items(code("121322", "DCM", "Source image for image processing operation")),
    )
    if frame is not None:
        source.ReferencedFrameNumber = frame
        source.SpatialLocationsPreserved = "YES"
    return source


def volume_series(study: Study) -> Dataset:
    """Reference to the series of the volume, with its one instance."""
    volume = item(
        ReferencedSOPClassUID=BreastTomosynthesisImageStorage,
        ReferencedSOPInstanceUID=study.ids.instance(TOMOSYNTHESIS),
    )
    return item(SeriesInstanceUID=study.ids.series(TOMOSYNTHESIS), ReferencedInstanceSequence=items(volume))


def plane_groups(study: Study, grid: Grid) -> dict[str, Dataset]:
    """Pixel measures and orientation of every slice of ``grid``."""
    sx, sy, sz = (decimal(spacing) for spacing in grid.spacing)
    return {
        "PixelMeasures": item(PixelSpacing=[sy, sx], SliceThickness=sz, SpacingBetweenSlices=sz),
        "PlaneOrientation": item(ImageOrientationPatient=study.frames.image_orientation()),
    }


def breast_window(values: NDArray[np.uint16]) -> tuple[float, float]:
    """Stored values between which nearly all of a breast lies: 0.5 % and 99.5 % of ``values`` (any shape)."""
    low, high = np.percentile(values, (0.5, 99.5))
    return float(low), float(max(high, low + 1.0))
