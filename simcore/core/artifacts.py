"""What the stages hand to one another: frozen dataclasses with read-only arrays.

Frames: the uncompressed phantom stands in the *breast frame* (x = 0 chest wall, y = 0 middle, z = 0 the plane that
parts the upper and lower ellipsoids); the compressed one in the *support frame*, the same axes with z = 0 on the
top of the breast support. Projections and volumes stand in the detector frame (core.geometry), whose z is that of
the support frame plus ``support_height``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid

Report = dict[str, Any]
"""JSON-ready facts about a stage: numbers with their unit as a suffix of the name (volume_ml, force_N)."""


def frozen(array: NDArray[Any]) -> NDArray[Any]:
    """The array, made read-only."""
    array.flags.writeable = False
    return array


def _freeze(artifact: object) -> None:
    for value in vars(artifact).values():
        if isinstance(value, np.ndarray):
            frozen(value)


@dataclass(frozen=True, eq=False)
class Phantom:
    """A label volume.

    labels: uint8 (nz, ny, nx), values of core.tissues.Tissue.
    grid:   where the voxels lie.
    truth:  known objects (lesions), one dict each, JSON-ready; empty where there are none.
    report: volume_ml, glandularity, tissue_ml {name: ml}, compartments, ...
    """

    labels: NDArray[np.uint8]
    grid: Grid
    truth: tuple[dict[str, Any], ...] = ()
    report: Report = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.labels.shape != self.grid.shape:
            raise ValueError(f"labels {self.labels.shape} and grid {self.grid.shape} differ")
        _freeze(self)


@dataclass(frozen=True, eq=False)
class TetMesh:
    """Linear tetrahedra in the breast frame.

    nodes: float64 (n, 3) (x, y, z), mm.
    tets:  int64 (m, 4), positive orientation (volume > 0).
    wall:  int64 (w,), nodes on the chest wall, x = 0 exactly.
    skin:  int64 (f, 3), boundary triangles not on the wall, outward normal.
    """

    nodes: NDArray[np.float64]
    tets: NDArray[np.int64]
    wall: NDArray[np.int64]
    skin: NDArray[np.int64]
    report: Report = field(default_factory=dict)

    def __post_init__(self) -> None:
        _freeze(self)


@dataclass(frozen=True, eq=False)
class Compression:
    """The equilibrium between the plates.

    displacement: float64 (n, 3) of the mesh nodes, mm.
    plate_z:      (lower, upper) z of the plates after compression, mm, breast frame.
    force_N:      force on a plate (mean of the two), N; None where it is not known (compressed elsewhere).
    outcome:      "converged" (anything else is raised as SolverError).
    report:       thickness_mm, min_det_F, volume_change, force balance, iterations, force curve, ...
    """

    displacement: NDArray[np.float64]
    plate_z: tuple[float, float]
    force_N: float | None
    outcome: str
    report: Report = field(default_factory=dict)

    def __post_init__(self) -> None:
        _freeze(self)

    @property
    def thickness(self) -> float:
        """Distance of the plates, mm."""
        return self.plate_z[1] - self.plate_z[0]


@dataclass(frozen=True, eq=False)
class ProjectionStack:
    """Detector signal of every view.

    data: uint16 (views, ny, nx), proportional to intensity: I / I0 = data / open_field, rounded.
    open_field: pixel value where nothing is in the beam.
    slab_integral: line integral along z of the plates that stand in the beam beside the breast (support, paddle);
        along a ray it is so much more as the ray is longer than its height.
    """

    data: NDArray[np.uint16]
    open_field: float
    geometry: AcquisitionGeometry
    report: Report = field(default_factory=dict)
    slab_integral: float = 0.0

    @property
    def background(self) -> float:
        """Pixel value beside the breast where the ray is perpendicular: the open field behind the plates."""
        return self.open_field * math.exp(-self.slab_integral)

    def __post_init__(self) -> None:
        _freeze(self)


@dataclass(frozen=True, eq=False)
class Primary:
    """What the detector absorbs of the primary beam in every view, without noise, for one photon that the source sends
    into a steradian.

    signal:   float32 (views, ny, nx), mean absorbed energy of a pixel, keV.
    variance: float16, the same shape: variance over signal, keV; with what the detector adds to it.
    open_signal, open_variance: float32 (views, rows, columns), as ``signal`` and variance (keV2) without breast, means
        over the cells of a coarse grid that covers the detector.
    """

    signal: NDArray[np.float32]
    variance: NDArray[np.float16]
    open_signal: NDArray[np.float32]
    open_variance: NDArray[np.float32]
    geometry: AcquisitionGeometry
    report: Report = field(default_factory=dict)

    def __post_init__(self) -> None:
        _freeze(self)


@dataclass(frozen=True, eq=False)
class Volume:
    """A reconstructed volume in the detector frame.

    data: uint16 (nz, ny, nx); attenuation coefficient [1/mm] = slope * data + intercept.
    Quantised where it is made, so the largest array of a case is held and written once, with 2 bytes a voxel.
    """

    data: NDArray[np.uint16]
    grid: Grid
    slope: float
    intercept: float
    report: Report = field(default_factory=dict)

    def __post_init__(self) -> None:
        _freeze(self)


@dataclass(frozen=True, eq=False)
class TransportResult:
    """Scatter and dose of every view, per photon and steradian that the source emits.

    scatter:          float32 (views, rows, columns), energy of scattered photons that the detector absorbs,
        keV / mm^2: means over the cells of a coarse grid that covers the detector; its rows and columns go with those
        of the pixels (physics.upsampling.spread_over_pixels).
    scatter_variance: float32, the same shape: sum of the squares of these energies, keV^2 / mm^2. N photons a steradian
        give a signal of N scatter with a variance of N scatter_variance / area (without what the detector adds).
    report: dose and energies with their statistical errors, see docs/xray_transport.md.
    """

    scatter: NDArray[np.float32]
    scatter_variance: NDArray[np.float32]
    report: Report = field(default_factory=dict)

    def __post_init__(self) -> None:
        _freeze(self)
