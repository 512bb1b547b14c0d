"""Numbers as DICOM writes them."""

from __future__ import annotations


def decimal(value: float) -> str:
    """A number as decimal string (DS) of at most 16 characters; noise below 1e-12 and the sign of zero dropped."""
    # Here and not above: 0.2 s, of every process that reads a specification.
    from pydicom.valuerep import format_number_as_ds

    return str(format_number_as_ds(round(float(value), 12) + 0.0))
