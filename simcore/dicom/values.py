"""Numbers as DICOM writes them."""

from __future__ import annotations

from pydicom.valuerep import format_number_as_ds


def decimal(value: float) -> str:
    """A number as decimal string (DS) of at most 16 characters; noise below 1e-12 and the sign of zero dropped."""
    return str(format_number_as_ds(round(float(value), 12) + 0.0))
