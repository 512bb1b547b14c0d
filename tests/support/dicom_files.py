"""Small DICOM files that archives take."""

import numpy as np
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import (
    BreastTomosynthesisImageStorage,
    DigitalMammographyXRayImageStorageForProcessing,
    ExplicitVRLittleEndian,
)

MG = str(DigitalMammographyXRayImageStorageForProcessing)
TOMO = str(BreastTomosynthesisImageStorage)


def write_dicom(path, number=1, sop_class=MG, rows=8, columns=16, frames=1, study="2.25.7", compress=None, seed=0):
    """A small object that archives take. Returns its pixels."""
    pixels = np.random.default_rng(1000 * seed + number).integers(0, 4096, (frames, rows, columns), dtype=np.uint16)
    dataset = Dataset()
    dataset.SOPClassUID = sop_class
    dataset.SOPInstanceUID = f"2.25.{10**20 + 1000 * seed + number}"
    dataset.StudyInstanceUID = study
    dataset.SeriesInstanceUID = f"{study}.{1 if sop_class == MG else 2}"
    dataset.PatientID = "SIM-TEST"
    dataset.PatientName = "SYNTHETIC^TEST"
    dataset.StudyDate, dataset.StudyTime = "20260101", "120000"
    dataset.AccessionNumber = dataset.StudyID = dataset.ReferringPhysicianName = ""
    dataset.PatientBirthDate, dataset.PatientSex = "19760101", "F"
    dataset.Modality = "MG"
    dataset.SeriesNumber, dataset.InstanceNumber = 1, number
    dataset.SamplesPerPixel, dataset.PhotometricInterpretation = 1, "MONOCHROME2"
    dataset.Rows, dataset.Columns = rows, columns
    dataset.BitsAllocated, dataset.BitsStored, dataset.HighBit, dataset.PixelRepresentation = 16, 12, 11, 0
    if frames > 1:
        dataset.NumberOfFrames = frames
    dataset.PixelData = pixels.tobytes()
    dataset["PixelData"].VR = "OW"
    dataset.file_meta = FileMetaDataset()
    dataset.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    if compress:
        dataset.compress(compress, generate_instance_uid=False)
    dataset.save_as(path, enforce_file_format=True)
    return pixels
