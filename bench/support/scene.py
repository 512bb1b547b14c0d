"""The scene that the benches of kernels share: the paper's cup C between the plates, and its acquisition."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore import fem, mesh, phantom, projection, warp
from simcore.core.artifacts import Phantom
from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid
from simcore.mesh.spec import LatticeMesh
from simcore.presets import paper_case
from simcore.projection.materials import attenuation_table
from simcore.spec import SimulationSpec


@dataclass(frozen=True)
class Scene:
    """A compressed breast and views of it."""

    spec: SimulationSpec
    breast: Phantom
    geometry: AcquisitionGeometry
    thickness_mm: float

    @property
    def grid(self) -> Grid:
        """Of the labels, in the detector frame."""
        return self.breast.grid.moved(z=self.geometry.support_height)

    def mu(self) -> NDArray[np.float64]:
        """Attenuation coefficient of every label, 1/mm."""
        return attenuation_table(self.spec.physics.attenuation)


def cup_c(scale: float = 1.0, percent: float = 20.0, views: int = 15) -> Scene:
    """The paper's cup C: 0.2 mm voxels and 2304 x 1920 pixels of 0.1 mm; edges longer by ``scale``, fewer pixels."""
    spec = paper_case("c", percent, views=views)
    detector = spec.acquisition.detector
    spec = spec.with_(
        phantom=spec.phantom.with_(voxel_mm=spec.phantom.voxel_mm * scale),
        mesh=LatticeMesh(),
        acquisition=spec.acquisition.with_(
            detector=detector.with_(
                pixels_y=math.ceil(detector.pixels_y / scale),
                pixels_x=math.ceil(detector.pixels_x / scale),
                pixel_mm=detector.pixel_mm * scale,
            )
        ),
    )
    grown = phantom.generate(spec.phantom, spec.seed)
    tetrahedra = mesh.build(grown, spec.mesh)
    compression = fem.compress(tetrahedra, grown, spec.compression)
    breast = warp.deform(grown, tetrahedra, compression, spec.warp)
    return Scene(spec, breast, projection.geometry_of(spec.acquisition), compression.thickness)


def chosen_views(geometry: AcquisitionGeometry, count: int) -> AcquisitionGeometry:
    """Some of the views, spread evenly over all of them; the outermost are always there."""
    kept = np.unique(np.linspace(0, geometry.views - 1, count).round().astype(int))
    return AcquisitionGeometry(
        **{
            **vars(geometry),
            "angles": geometry.angles[kept],
            "sources": geometry.sources[kept],
            "detector_angles": geometry.detector_angles[kept],
        }
    )
