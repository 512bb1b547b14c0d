"""The projection stage: a compressed phantom and an acquisition in, the detector's signal out."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simcore.core.advice import one_of, where
from simcore.core.artifacts import Phantom, ProjectionStack
from simcore.core.errors import GeometryError
from simcore.core.geometry import AcquisitionGeometry, Detector
from simcore.core.progress import Progress
from simcore.core.tissues import Tissue
from simcore.projection import coverage
from simcore.projection.acquisition import geometry_of
from simcore.projection.borders import Borders, borders_of
from simcore.projection.integrals import line_integrals
from simcore.projection.materials import attenuation_table
from simcore.projection.poses import check_poses
from simcore.projection.signal import pixel_values
from simcore.projection.slabs import add_slabs, upright_integral
from simcore.projection.spec import AcquisitionSpec, PhysicsSpec


def project_views(
    phantom: Phantom, acquisition: AcquisitionSpec, physics: PhysicsSpec, progress: Progress
) -> ProjectionStack:
    """See simcore.projection.project."""
    bits, open_field = acquisition.detector.bits, acquisition.detector.open_field_value
    if open_field > 2**bits - 1:
        raise GeometryError(
            f"open_field_value = {open_field:g} does not fit into {bits} bits; at most {2**bits - 1}",
            code="open-field-too-large",
        )
    mu = attenuation_table(physics.attenuation)
    geometry, borders, used, shadows, beyond = placed(phantom, acquisition, mu)
    detector = geometry.detector
    data = np.empty((geometry.views, detector.ny, detector.nx), np.uint16)
    by_rays = with_rays(geometry, physics.rays_per_pixel_edge)
    integrals = np.empty((by_rays.detector.ny, by_rays.detector.nx), np.float32)
    upright = upright_integral(acquisition.slabs)
    largest = 0.0
    for view in range(geometry.views):
        progress(view / geometry.views, f"view {view + 1} of {geometry.views}")
        line_integrals(
            phantom, by_rays, view, used,
            sampling=physics.sampling, step_voxels=physics.step_voxels, borders=borders, out=integrals,
        )  # fmt: skip
        if upright > 0.0:
            add_slabs(upright, by_rays, view, integrals)
        largest = max(largest, float(integrals.max()))
        pixel_values(integrals, open_field, bits, data[view])
    progress(1.0, "projected")
    return ProjectionStack(
        data=data,
        open_field=open_field,
        geometry=geometry,
        report={
            "rays": geometry.views * integrals.size,
            "max_line_integral": largest,
            "min_pixel_value": int(data.min()),
            "attenuation": physics.attenuation,
            "mu_per_mm": {tissue.name.lower(): float(mu[tissue]) for tissue in Tissue},
            "sampling": physics.sampling,
            "truncated": bool(beyond),
            "shadow_mm": bounds(shadows),
            **({"slab_integral": upright} if acquisition.slabs else {}),
        },
        slab_integral=upright,
    )


class Placed(NamedTuple):
    """A breast in the beam. used: the coefficients of the labels that it has. beyond: where its shadow reaches beyond
    the detector, in words; empty where it does not."""

    geometry: AcquisitionGeometry
    borders: Borders
    used: NDArray[np.float64]
    shadows: list[coverage.Shadow]
    beyond: str


def placed(phantom: Phantom, acquisition: AcquisitionSpec, mu: NDArray[np.float64]) -> Placed:
    """mu: (MAX_TISSUES,), above 0 for what casts a shadow.

    raises: GeometryError where source, breast and detector are not in this order, or where the shadow reaches beyond
        the detector and truncation is refused.
    """
    geometry = geometry_of(acquisition)
    grid = phantom.grid.moved(z=geometry.support_height)
    check_poses(geometry, grid.corner[2], grid.upper[2] + acquisition.paddle_mm)
    borders = borders_of(phantom.labels)
    used = borders.present(mu)
    shadows = coverage.shadows(borders.row_ends(used), grid, geometry)
    beyond = coverage.truncation(shadows, geometry)
    if beyond and acquisition.truncation == "refuse":
        raise GeometryError(
            f"the breast's shadow reaches beyond the detector: {beyond}; take "
            + one_of(
                "a larger detector",
                where(acquisition.turns and coverage.beyond_y(shadows, geometry), "a smaller angular_range_degrees"),
                'truncation = "allow"',
            ),
            code="truncated",
        )
    return Placed(geometry, borders, used, shadows, beyond)


def with_rays(geometry: AcquisitionGeometry, rays: int) -> AcquisitionGeometry:
    """The same geometry with ``rays`` x ``rays`` pixels in the place of each: their centres are where rays end."""
    if rays == 1:
        return geometry
    detector = geometry.detector
    return replace(geometry, detector=Detector(detector.ny * rays, detector.nx * rays, detector.pixel / rays))


def bounds(shadows: list[coverage.Shadow]) -> dict[str, float] | None:
    """Bounds of all shadows in detector coordinates; None without any tissue."""
    if not shadows:
        return None
    return {
        "y_min": round(min(s.y_min for s in shadows), 3),
        "y_max": round(max(s.y_max for s in shadows), 3),
        "x_max": round(max(s.x_max for s in shadows), 3),
    }
