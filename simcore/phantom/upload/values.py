"""Stored numbers as labels: whole ones, of whatever type they are."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.core.errors import SpecError
from simcore.phantom.upload import tissue_maps
from simcore.phantom.upload.formats.header import Header, refuse

WHOLE_WITHIN = 1e-6
_NIFTI_REMEDY = (
    "image = nibabel.load(FILE); "
    "nibabel.save(nibabel.Nifti1Image(numpy.rint(image.get_fdata()).astype('uint16'), image.affine), 'labels.nii.gz')"
)
"""uint16 holds every label that a tissue map can name."""


def labels_of(voxels: NDArray[Any], header: Header) -> NDArray[np.integer]:
    """The labels of stored values, uint8 or uint16, which index a table of tissues.

    raises: SpecError for a number that is not whole, or that no tissue map can name.
    """
    if voxels.dtype.kind == "f" or (header.slope, header.intercept) != (1.0, 0.0):
        voxels = _whole(voxels, header)
    elif voxels.dtype.itemsize == 1 and voxels.dtype.kind == "u":
        return voxels
    low, high = voxels.min(initial=0), voxels.max(initial=0)
    if low < 0 or high > tissue_maps.LARGEST_VALUE:
        tissue_maps.refuse_beyond(float(low if low < 0 else high), header.dtype.name)
    return voxels.astype(np.uint16 if high > 255 else np.uint8)


def _whole(voxels: NDArray[Any], header: Header) -> NDArray[np.float64]:
    """The labels as float64. raises: SpecError where one is not whole within WHOLE_WITHIN"""
    with np.errstate(invalid="ignore", over="ignore"):
        exact = voxels.astype(np.float64) * header.slope + header.intercept
        whole = np.rint(exact)
        broken = ~(np.abs(exact - whole) <= WHOLE_WITHIN)
    if broken.any():
        where = np.unravel_index(int(np.argmax(broken)), broken.shape)
        raise _not_whole(voxels[where], float(exact[where]), header)
    return whole


def _not_whole(stored: Any, value: float, header: Header) -> SpecError:
    if (header.slope, header.intercept) != (1.0, 0.0):
        return refuse(
            f"scl_slope = {header.slope:.9g} and scl_inter = {header.intercept:.9g} turn the stored {stored} into "
            f"{value:.9g}, which is no whole number within {WHOLE_WITHIN:g}: save the labels as whole numbers and "
            f"without a slope, in Python {_NIFTI_REMEDY}"
        )
    kind = header.dtype.name
    return refuse(
        f"its voxels are of type {kind}, and one is {value:.9g}, which is no whole number within {WHOLE_WITHIN:g}: "
        "save labels, not densities or probabilities, as whole numbers (uint8), and resample them by nearest "
        "neighbours"
    )
