"""/dicomweb: QIDO-RS and WADO-RS (DICOM PS3.18) over the objects of all cases, read only."""
