"""Where the axes of an array lead, from the directions that a file gives them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.phantom.upload.formats.header import refuse
from simcore.phantom.upload.spec import OWN_AXES, Axes

MAX_TILT_DEGREES = 2.5
"""Angle between an axis and that of the patient which is told and otherwise ignored."""
MAX_SHEAR_DEGREES = 1.0
"""The same for the angle between two axes against a right one."""
TOLD_DEGREES = 0.1
_OURS = {"A": "+x", "P": "-x", "L": "+y", "R": "-y", "S": "+z", "I": "-z"}
_REMEDY = "resample it along them, or say where its axes lead, slowest first: axes (--axes +z,+y,+x)"


def axes_of(directions: NDArray[np.float64], frame: str) -> tuple[Axes, tuple[str, ...]]:
    """The array axes from their directions in a frame of the patient.

    directions: (3, 3), one row an axis, fastest first. frame: what its coordinates grow towards, of "LPS", "RAS",
        "LAS": +x of tomosim is anterior, +y left, +z superior, as a breast in the cranio-caudal view.
    returns: the axes, slowest first, and what to tell of them.
    raises: SpecError for a volume that is tilted by more than MAX_TILT_DEGREES or sheared.
    """
    units = _units(directions)
    _check_right_angles(units)
    axes = nearest_axes(units, frame)
    if len({axis[1] for axis in axes}) != 3:
        raise refuse(f"two of its axes lead the same way ({_listed(directions)}): {_REMEDY}")
    along = np.argmax(np.abs(units), axis=1)
    # The angle between the two lines, exact where it is small.
    aside = np.sqrt(np.maximum(1.0 - units[np.arange(3), along] ** 2, 0.0))
    tilt = float(np.degrees(np.arcsin(aside.max())))
    if round(tilt, 2) > MAX_TILT_DEGREES:
        raise refuse(
            f"its axes are not parallel to those of the patient but tilted by {tilt:.1f} degrees, of which "
            f"{MAX_TILT_DEGREES:g} are taken: {_REMEDY}"
        )
    remarks = (f"its axes are tilted by {tilt:.1f} degrees against those of the patient: read as if they were not",)
    return axes, remarks if tilt > TOLD_DEGREES else ()


def nearest_axes(directions: NDArray[np.float64], frame: str) -> Axes:
    """The axes that each direction is nearest to, however tilted; slowest first."""
    along = np.argmax(np.abs(directions), axis=1)
    x, y, z = (_signed(_OURS[frame[k]], row[k] > 0) for row, k in zip(directions, along, strict=True))
    return (z, y, x)  # type: ignore[return-value]


def axes_or_own(directions: NDArray[np.float64], frame: str) -> tuple[Axes, tuple[str, ...]]:
    """As ``axes_of``; but a unit matrix is what programs write that know no orientation: then the axes are ours."""
    if np.allclose(_units(directions), np.eye(3), atol=1e-6):
        return OWN_AXES, ()
    return axes_of(directions, frame)


def axes_without_patient(directions: NDArray[np.float64], frame: str) -> tuple[Axes, tuple[str, ...]]:
    """Our axes, for directions in a frame that says nothing of the patient. raises: SpecError for a sheared volume"""
    units = _units(directions)
    _check_right_angles(units)
    named = ",".join(OWN_AXES)
    remark = f"its directions are those of {frame!r}, which says nothing of the patient: its axes are taken for {named}"
    return OWN_AXES, () if np.allclose(units, np.eye(3), atol=1e-6) else (remark,)


def _units(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Directions of length 1. raises: SpecError where one has no length"""
    lengths = np.linalg.norm(directions, axis=1, keepdims=True)
    if not (np.isfinite(lengths).all() and (lengths > 0).all()):
        raise refuse(f"an axis has no direction ({_listed(directions)}): {_REMEDY}")
    units: NDArray[np.float64] = directions / lengths
    return units


def _check_right_angles(units: NDArray[np.float64]) -> None:
    """raises: SpecError for axes that are sheared"""
    cosines = [abs(float(units[i] @ units[j])) for i, j in ((0, 1), (0, 2), (1, 2))]
    shear = float(np.degrees(np.arcsin(min(max(cosines), 1.0))))
    if shear > MAX_SHEAR_DEGREES:
        raise refuse(
            f"its axes are sheared: {90 - shear:.1f} degrees between two of them, not 90 ({_listed(units)}): {_REMEDY}"
        )


def _listed(directions: NDArray[np.float64]) -> str:
    return ", ".join("(" + " ".join(f"{n:.4g}" for n in row) + ")" for row in directions)


def _signed(axis: str, same: bool) -> str:
    return axis if same else {"+": "-", "-": "+"}[axis[0]] + axis[1]
