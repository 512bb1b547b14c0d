"""Units of length in headers."""

from __future__ import annotations

from simcore.phantom.upload.formats.header import refuse

_NAMES = {
    1.0: ("mm", "millimeter", "millimeters", "millimetre", "millimetres", "", "?", "unknown"),
    10.0: ("cm", "centimeter", "centimeters", "centimetre", "centimetres"),
    1000.0: ("m", "meter", "meters", "metre", "metres"),
    1e-3: ("um", "µm", "μm", "micron", "microns", "micrometer", "micrometers", "micrometre", "micrometres"),
    1e-6: ("nm", "nanometer", "nanometers", "nanometre", "nanometres"),
    25.4: ("in", "inch", "inches"),
}
_MM = {name: mm for mm, names in _NAMES.items() for name in names}
KNOWN = "mm, cm, m, um, nm, in"


def mm_per(unit: str, name: str) -> float:
    """Length of a unit, mm; that of mm where the file leaves it open. raises: SpecError naming the field"""
    length = _MM.get(unit.strip().strip('"').strip().lower())
    if length is None:
        raise refuse(f"{name} = {unit[:40]!r} is no unit of length that is known ({KNOWN}): give spacing_mm")
    return length
