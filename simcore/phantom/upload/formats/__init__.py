"""The files that labels come in: headers, units, orientation and voxels of NRRD, MetaImage, NIfTI and raw data."""
