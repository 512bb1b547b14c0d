"""A third party: reads DICOM files and reconstructs, from attributes alone. Knows pydicom, numpy and PS3.3.

Filtered back-projection with the ramp, for a tube that turns about the isocenter over a detector at rest. Everything
is computed with vectors in the gantry system (PS3.3 C.8.31.6.1), origin on the isocenter.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pydicom
from numpy.typing import NDArray
from pydicom.dataset import Dataset

Array = NDArray[np.float64]


@dataclass
class View:
    """signal: pixel values; the position of pixel [j, i] is first + j * down + i * across."""

    signal: Array
    source: Array
    first: Array
    across: Array
    down: Array
    angle: float


def rotation(primary: float, secondary: float) -> Array:
    """From +Z towards +X by primary, after +Z towards +Y by secondary, degrees."""
    a, b = np.deg2rad([primary, secondary])
    about_y = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(b), np.sin(b)], [0, -np.sin(b), np.cos(b)]])
    return about_y @ about_x


def make_view(signal: Array, iso: Dataset, distance: float, spacing: list[float]) -> View:
    primary, secondary = iso.XRaySourceIsocenterPrimaryAngle, iso.XRaySourceIsocenterSecondaryAngle
    detector = rotation(iso.DetectorIsocenterPrimaryAngle, iso.DetectorIsocenterSecondaryAngle)
    centre = np.array(
        [iso.DetectorXPositionToIsocenter, iso.DetectorYPositionToIsocenter, iso.DetectorZPositionToIsocenter]
    )
    cosines = np.array(iso.DetectorActiveAreaOrientation, float)
    return View(
        signal.astype(float),
        rotation(primary, secondary) @ [0, 0, distance],
        centre + detector @ np.array(iso.DetectorActiveAreaTLHCPosition, float),
        detector @ cosines[:3] * spacing[1],
        detector @ cosines[3:] * spacing[0],
        primary,
    )


def read_multi_frame(file: Path) -> list[View]:
    d = pydicom.dcmread(file)
    spacing = [
        float(s) for s in d.SharedFunctionalGroupsSequence[0].FramePixelDataPropertiesSequence[0].ImagerPixelSpacing
    ]
    return [
        make_view(
            pixels,
            frame.IsocenterReferenceSystemSequence[0],
            frame.XRayGeometrySequence[0].DistanceSourceToIsocenter,
            spacing,
        )
        for pixels, frame in zip(d.pixel_array, d.PerFrameFunctionalGroupsSequence, strict=True)
    ]


def read_single_files(folder: Path) -> list[View]:
    images = sorted((pydicom.dcmread(f) for f in folder.glob("*.dcm")), key=lambda d: int(d.InstanceNumber))
    return [
        make_view(
            d.pixel_array,
            d.IsocenterReferenceSystemSequence[0],
            d.DistanceSourceToIsocenter,
            [float(s) for s in d.ImagerPixelSpacing],
        )
        for d in images
    ]


def read_open_field(file: Path) -> float:
    """The signal without breast: the one thing that no standard attribute carries."""
    block = pydicom.dcmread(file, stop_before_pixels=True).private_block(0x0099, "TOMOSIM 1")
    return float(json.loads(block[0x01].value)["open_field"])


@dataclass
class Slices:
    """attenuation: of the written volume, 1/mm. The centre of voxel [k, j, i] is first[k] + j * down + i * across."""

    attenuation: Array
    step: float
    first: Array
    across: Array
    down: Array


def read_volume(file: Path) -> Slices:
    d = pydicom.dcmread(file)
    shared = d.SharedFunctionalGroupsSequence[0]
    cosines = np.array(shared.PlaneOrientationSequence[0].ImageOrientationPatient, float)
    dy, dx = (float(s) for s in shared.PixelMeasuresSequence[0].PixelSpacing)
    positions = np.array(
        [f.PlanePositionSequence[0].ImagePositionPatient for f in d.PerFrameFunctionalGroupsSequence], float
    )
    values = shared.RealWorldValueMappingSequence[0]
    to_gantry = np.array(d.ImageToEquipmentMappingMatrix, float).reshape(4, 4)
    return Slices(
        d.pixel_array * values.RealWorldValueSlope + values.RealWorldValueIntercept,
        values.RealWorldValueSlope,
        positions @ to_gantry[:3, :3].T + to_gantry[:3, 3],
        to_gantry[:3, :3] @ cosines[:3] * dx,
        to_gantry[:3, :3] @ cosines[3:] * dy,
    )


def reconstruct(views: list[View], open_field: float, slices: Slices) -> Array:
    """Attenuation, 1/mm, at the voxels of ``slices`` (whose own values are not looked at)."""
    steps = np.abs(np.gradient(np.deg2rad(np.unwrap([v.angle for v in views], period=360.0))))
    _, ny, nx = slices.attenuation.shape
    j, i = np.mgrid[:ny, :nx]
    total = np.zeros(slices.attenuation.shape)
    for view, step in zip(views, steps, strict=True):
        filtered = step * filter_view(view, open_field)
        normal = np.cross(view.across, view.down)
        normal /= np.linalg.norm(normal)
        height = (view.source - view.first) @ normal
        for k, first in enumerate(slices.first):
            voxels = first + j[..., None] * slices.down + i[..., None] * slices.across
            magnification = height / ((view.source - voxels) @ normal)
            met = view.source + (voxels - view.source) * magnification[..., None] - view.first
            row = met @ view.down / (view.down @ view.down)
            column = met @ view.across / (view.across @ view.across)
            total[k] += magnification**2 * bilinear(filtered, row, column)
    return total


def filter_view(view: View, open_field: float) -> Array:
    """Line integrals, weighted, convolved with the band-limited ramp down every column."""
    rows, columns = view.signal.shape
    j, i = np.mgrid[:rows, :columns]
    rays = view.source - (view.first + j[..., None] * view.down + i[..., None] * view.across)
    normal = np.cross(view.across, view.down)
    height = abs(rays[0, 0] @ normal) / np.linalg.norm(normal)
    weights = np.abs(rays @ view.source) / (height * np.linalg.norm(rays, axis=-1))
    weighted = np.log(open_field / view.signal) * weights
    pitch = np.linalg.norm(view.down)
    lag = np.arange(rows)[:, None] - np.arange(rows)
    odd = lag % 2 == 1
    kernel = np.where(lag == 0, 1 / (4 * pitch**2), np.where(odd, -1 / (np.pi * pitch * np.where(odd, lag, 1)) ** 2, 0))
    return np.asarray(pitch * kernel @ weighted)


def bilinear(image: Array, row: Array, column: Array) -> Array:
    """Zero beyond the outermost pixel centres and one more."""
    padded = np.pad(image, 1)
    row, column = (np.clip(c + 1, 0, n - 1.001) for c, n in zip((row, column), padded.shape, strict=True))
    j, i = row.astype(int), column.astype(int)
    v, u = row - j, column - i
    below = (1 - u) * padded[j, i] + u * padded[j, i + 1]
    above = (1 - u) * padded[j + 1, i] + u * padded[j + 1, i + 1]
    return np.asarray((1 - v) * below + v * above)
