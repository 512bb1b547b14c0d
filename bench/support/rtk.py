"""The Reconstruction Toolkit (RTK, on ITK) on scenes of this project.

RTK's fixed frame is ours (x, y, z) in another order: RTK turns about its Y, the tube about our x. So

    X = -y,  Y = x,  Z = z,   detector u = X, v = Y,

and volumes are handed over as arrays (z, x, -y). Every view is given by its source and detector, which RTK turns into
its own nine parameters; that they were understood is checked by values in the benches.
"""

from __future__ import annotations

from typing import Any

import itk
import numpy as np
from itk import RTK as rtk
from numpy.typing import NDArray

from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid

FloatArray = NDArray[np.float32]
IMAGE = itk.Image[itk.F, 3]


def set_threads(count: int) -> None:
    """For every filter made from now on."""
    itk.MultiThreaderBase.SetGlobalMaximumNumberOfThreads(count)
    itk.MultiThreaderBase.SetGlobalDefaultNumberOfThreads(count)


def geometry_of(geometry: AcquisitionGeometry) -> Any:
    """ThreeDCircularProjectionGeometry of a detector at rest in z = 0."""
    if not geometry.stationary:
        raise ValueError("the detector turns")
    circle = rtk.ThreeDCircularProjectionGeometry.New()
    for x, y, z in geometry.sources:
        understood = circle.AddProjection(_point(-y, x, z), _point(0, 0, 0), _vector(1, 0, 0), _vector(0, 1, 0))
        if not understood:
            raise ValueError(f"RTK refuses the source at {(x, y, z)}")
    return circle


def volume_of(data: FloatArray, grid: Grid) -> Any:
    """An image of float32 (nz, ny, nx)."""
    image = itk.image_from_array(np.ascontiguousarray(data[:, ::-1].transpose(0, 2, 1), np.float32))
    sx, sy, sz = grid.spacing
    image.SetSpacing([sy, sx, sz])
    image.SetOrigin([-float(grid.centres("y")[-1]), float(grid.centres("x")[0]), float(grid.centres("z")[0])])
    return image


def array_of_volume(image: Any) -> FloatArray:
    """float32 (nz, ny, nx) of an image in RTK's frame."""
    return np.ascontiguousarray(itk.array_from_image(image).transpose(0, 2, 1)[:, ::-1])


def projections_of(data: FloatArray, geometry: AcquisitionGeometry) -> Any:
    """An image of float32 (views, ny, nx)."""
    image = itk.image_from_array(np.ascontiguousarray(data[:, ::-1].transpose(0, 2, 1), np.float32))
    detector = geometry.detector
    image.SetSpacing([detector.pixel, detector.pixel, 1.0])
    image.SetOrigin([-float(detector.y_centres()[-1]), float(detector.x_centres()[0]), 0.0])
    return image


array_of_projections = array_of_volume


def joseph(projections: Any, volume: Any, geometry: Any) -> Any:
    """The filter of Joseph's forward projection, not yet run; ``projections`` are what it adds to."""
    itk_filter = rtk.JosephForwardProjectionImageFilter[IMAGE, IMAGE].New()
    itk_filter.SetInput(0, projections)
    itk_filter.SetInput(1, volume)
    itk_filter.SetGeometry(geometry)
    return itk_filter


def backprojection(kind: str, volume: Any, projections: Any, geometry: Any) -> Any:
    """A filter that adds a back-projection to ``volume``: "voxel" (bilinear on the detector), "fdk" (the same with
    FDK's weight), "joseph" (the transpose of Joseph's projection)."""
    names = {
        "voxel": rtk.BackProjectionImageFilter,
        "fdk": rtk.FDKBackProjectionImageFilter,
        "joseph": rtk.JosephBackProjectionImageFilter,
    }
    itk_filter = names[kind][IMAGE, IMAGE].New()
    itk_filter.SetInput(0, volume)
    itk_filter.SetInput(1, projections)
    itk_filter.SetGeometry(geometry)
    return itk_filter


def _point(*values: float) -> Any:
    return itk.Point[itk.D, 3]([float(v) for v in values])


def _vector(*values: float) -> Any:
    vector = itk.Vector[itk.D, 3]()
    for i, value in enumerate(values):
        vector[i] = float(value)
    return vector


def fdk(volume: Any, projections: Any, geometry: Any) -> Any:
    """The filter of Feldkamp's reconstruction (weights, ramp, back-projection), which adds to ``volume``."""
    itk_filter = rtk.FDKConeBeamReconstructionFilter[IMAGE].New()
    itk_filter.SetInput(0, volume)
    itk_filter.SetInput(1, projections)
    itk_filter.SetGeometry(geometry)
    return itk_filter


def sart(volume: Any, projections: Any, geometry: Any, relaxation: float) -> Any:
    """The filter of one iteration of SART from ``volume``: Joseph's projection, voxel back-projection, every view by
    itself, no negative values."""
    itk_filter = rtk.SARTConeBeamReconstructionFilter[IMAGE, IMAGE].New()
    itk_filter.SetInput(0, volume)
    itk_filter.SetInput(1, projections)
    itk_filter.SetGeometry(geometry)
    itk_filter.SetForwardProjectionFilter(itk_filter.ForwardProjectionType_FP_JOSEPH)
    itk_filter.SetBackProjectionFilter(itk_filter.BackProjectionType_BP_VOXELBASED)
    itk_filter.SetNumberOfIterations(1)
    itk_filter.SetNumberOfProjectionsPerSubset(1)
    itk_filter.SetLambda(relaxation)
    itk_filter.SetEnforcePositivity(True)
    itk_filter.SetDisableDisplacedDetectorFilter(True)
    return itk_filter
