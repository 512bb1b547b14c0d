"""Ground truth: the attenuation coefficient of the tissue at every voxel of the volume, as a Parametric Map."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import Dataset
from pydicom.sequence import Sequence
from pydicom.uid import ParametricMapStorage

from simcore.core.errors import ExportError
from simcore.dicom.common import Instance, code, dimensions, functional_groups, item, items
from simcore.dicom.objects.segmentation import describe
from simcore.dicom.pixels import MadeFrames
from simcore.dicom.resampling import sample
from simcore.dicom.study import ATTENUATION, Study, frame_anatomy, plane_groups, source_volume

IMAGE_TYPE = ["DERIVED", "PRIMARY", "VOLUME", "NONE"]


def files(study: Study) -> Iterator[tuple[str, Callable[[], Instance]]]:
    yield "attenuation.dcm", partial(attenuation_map, study)


def attenuation_map(study: Study) -> Instance:
    """float32, 1/mm, at the photon energy of the simulation; one frame a slice of the volume.

    raises: ExportError where the case does not tell the coefficients.
    """
    table = np.asarray(study.case.attenuation_per_mm, np.float32)
    if not len(table):
        raise ExportError("the case tells no attenuation coefficients: leave 'attenuation' out of export.extra_objects")
    dataset = study.dataset(ATTENUATION, ParametricMapStorage, "OT")
    grid = study.volume.grid
    slices, rows, columns = grid.shape
    describe(dataset, study, "ATTENUATION", "true attenuation coefficients")
    dataset.ImageType = IMAGE_TYPE
    dataset.RecognizableVisualFeatures = "NO"
    dataset.PresentationLUTShape = "IDENTITY"
    dataset.AcquisitionContextSequence = []
    dataset.NumberOfFrames = slices
    dataset.DimensionOrganizationType = "3D"
    dimensions(dataset, study.ids.uid("dimensions", ATTENUATION), (0x00200032, 0x00209113, "Image Position (Patient)"))
    dataset.SharedFunctionalGroupsSequence = items(_shared_groups(study, float(table.max())))
    dataset.PerFrameFunctionalGroupsSequence = Sequence([_frame_groups(study, k) for k in range(slices)])
    study.add_private(dataset, "attenuation", grid=grid.to_dict(), value_unit="1/mm")

    dataset.SamplesPerPixel = 1
    dataset.PhotometricInterpretation = "MONOCHROME2"
    dataset.Rows, dataset.Columns = rows, columns
    dataset.BitsAllocated = 32

    def frame(k: int) -> NDArray[np.float32]:
        labels = sample(study.phantom, study.lookup, slices=slice(k, k + 1))[0]
        return np.asarray(table[labels])

    return Instance(dataset, MadeFrames(slices, frame))


def _shared_groups(study: Study, largest: float) -> Dataset:
    quantity = item(
        ValueType="CODE",
        ConceptNameCodeSequence=items(code("246205007", "SCT", "Quantity")),
        ConceptCodeSequence=items(code("110851", "DCM", "X-Ray Attenuation Coefficient")),
    )
    values = item(
        DoubleFloatRealWorldValueFirstValueMapped=0.0,
        DoubleFloatRealWorldValueLastValueMapped=largest,
        RealWorldValueIntercept=0.0,
        RealWorldValueSlope=1.0,
        LUTExplanation="linear attenuation coefficient",
        LUTLabel="MU",
        MeasurementUnitsCodeSequence=items(code("/mm", "UCUM", "/millimeter")),
        QuantityDefinitionSequence=items(quantity),
    )
    return functional_groups(
        **plane_groups(study, study.volume.grid),
        FrameAnatomy=frame_anatomy(study),
        PixelValueTransformation=item(RescaleIntercept="0", RescaleSlope="1", RescaleType="US"),
        # The coefficients of soft tissue; calcifications lie far above.
        FrameVOILUT=item(WindowCenter="0.05", WindowWidth="0.1", VOILUTFunction="LINEAR_EXACT"),
        ParametricMapFrameType=item(FrameType=IMAGE_TYPE),
        RealWorldValueMapping=values,
    )


def _frame_groups(study: Study, k: int) -> Dataset:
    derived = item(
        DerivationCodeSequence=items(code("TRUTH", "99TOMOSIM", "Sampled from the simulated object")),
        SourceImageSequence=items(source_volume(study, k + 1)),
    )
    return functional_groups(
        FrameContent=item(DimensionIndexValues=[k + 1]),
        PlanePosition=item(ImagePositionPatient=study.frames.image_position(study.volume.grid, k)),
        DerivationImage=derived,
    )
