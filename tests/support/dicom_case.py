"""A small case made by hand: no other stage takes part."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simcore import dicom
from simcore.core.artifacts import Compression, Phantom, ProjectionStack, Volume
from simcore.core.geometry import AcquisitionGeometry, Detector
from simcore.core.grid import Grid
from simcore.dicom import CaseDescription
from simcore.dicom.spec import ExportSpec


@dataclass(frozen=True)
class SmallCase:
    """All arguments of an export."""

    spec: ExportSpec
    case: CaseDescription
    stack: ProjectionStack
    volume: Volume
    phantom: Phantom
    compression: Compression

    def export(self, folder: Path) -> list[str]:
        return self.exported(folder).names

    def exported(self, folder: Path) -> dicom.ExportedStudy:
        return dicom.export(folder, self.spec, self.case, self.stack, self.volume, self.phantom, self.compression)


def make_geometry(*, turning: float = 0.0, views: int = 5) -> AcquisitionGeometry:
    """Tube on a circle of 620 mm about a pivot 40 mm above the detector; turning: detector over tube angle."""
    angles = np.linspace(-20.0, 20.0, views)
    t = np.deg2rad(angles)
    sources = np.stack([0 * t, 620.0 * np.sin(t), 40.0 + 620.0 * np.cos(t)], axis=1)
    return AcquisitionGeometry(angles, sources, Detector(64, 48, 0.85), turning * angles, 40.0, 660.0, 22.0)


def make_phantom() -> Phantom:
    """A half ellipsoid of all tissues in the support frame, so that every code is used; no truth about its lesions."""
    grid = Grid((20, 27, 19), (2.0, 2.0, 2.0), (0.0, -27.0, 0.0))
    z, y, x = np.meshgrid(grid.centres("z"), grid.centres("y"), grid.centres("x"), indexing="ij")
    breast = (x / 36) ** 2 + (y / 25) ** 2 + ((z - 20) / 18) ** 2 < 1
    labels = np.where(breast, 1 + np.random.default_rng(3).integers(0, 9, breast.shape), 0)
    return Phantom(labels.astype(np.uint8), grid)


def make_phantom_with_lesions() -> Phantom:
    """Fat with two masses and a cluster of two calcifications of one voxel each."""
    grid = make_phantom().grid
    labels = np.where(make_phantom().labels > 0, 1, 0).astype(np.uint8)
    labels[8:12, 12:16, 4:8] = 5
    labels[8:10, 18:20, 10:12] = 5
    labels[13, 9, 5] = labels[15, 11, 6] = 6
    known = [
        ("mass-1", "mass", None, (12.0, 1.0, 20.0)),
        ("mass-2", "mass", None, (22.0, 11.0, 18.0)),
        ("calcifications-1/1", "calcification", "calcifications-1", (11.0, -8.0, 27.0)),
        ("calcifications-1/2", "calcification", "calcifications-1", (13.0, -4.0, 31.0)),
    ]
    cluster = {"id": "calcifications-1", "tissue": "calcification", "parts": 2, "centre_mm": [12.0, -6.0, 29.0]}
    truth = [cluster]
    for name, tissue, part_of, centre in known:
        entry = {"id": name, "tissue": tissue, "centre_mm": list(centre)}
        truth.append(entry if part_of is None else {**entry, "part_of": part_of})
    return Phantom(labels, grid, truth=tuple(truth))


ALL_EXTRAS = ["presentation", "synthetic-2d", "ct", "attenuation", "report"]


def make_case(
    *,
    laterality: str = "L",
    view: str = "CC",
    turning: float = 0.0,
    views: int = 5,
    seed: int = 1,
    lesions: bool = False,
    extras: tuple[str, ...] | list[str] = (),
    encoding: str = "none",
) -> SmallCase:
    random = np.random.default_rng(seed)
    geometry = make_geometry(turning=turning, views=views)
    frames = random.integers(500, 60001, (views, 64, 48), dtype=np.uint16)
    grid = Grid((9, 61, 50), (0.85, 0.9, 5.0), (0.0, -27.0, 20.0))
    values = random.integers(20000, 24000, grid.shape, dtype=np.uint16)
    compression = Compression(np.zeros((4, 3)), (-20.0, 20.0), 97.25, "converged")
    return SmallCase(
        spec=ExportSpec.model_validate(
            {"laterality": laterality, "view": view, "extra_objects": list(extras), "encoding": encoding}
        ),
        case=CaseDescription(
            "0123456789abcdef" * 4, seed, "0.1.0", 20.0, attenuation_per_mm=tuple(0.01 * k for k in range(16))
        ),
        stack=ProjectionStack(frames, 60000.0, geometry),
        volume=Volume(values, grid, 1e-5, -0.2),
        phantom=make_phantom_with_lesions() if lesions else make_phantom(),
        compression=compression,
    )
