"""The index of DICOM objects that searches ask, and how it is filled."""
