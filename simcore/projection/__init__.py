"""Tomosynthesis projections of a label volume: geometry, line integrals, detector signal.

projection.integrals.line_integrals gives the line integrals of one view themselves.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from simcore.core.progress import Progress, silent
from simcore.projection.spec import AcquisitionSpec, PhysicsSpec

if TYPE_CHECKING:  # whoever reads a specification needs no numerics
    import numpy as np
    from numpy.typing import NDArray

    from simcore.core.artifacts import Phantom, Primary, ProjectionStack
    from simcore.core.geometry import AcquisitionGeometry
    from simcore.projection.spectral import Beam

__all__ = ["AcquisitionSpec", "PhysicsSpec", "attenuation_per_mm", "geometry_of", "project", "project_spectrum"]


def geometry_of(acquisition: AcquisitionSpec) -> AcquisitionGeometry:
    """The poses of every view in the detector frame; see simcore.projection.acquisition.

    raises: GeometryError where the isocenter does not lie below the source.
    """
    from simcore.projection.acquisition import geometry_of as poses_of

    return poses_of(acquisition)


def project(
    phantom: Phantom, acquisition: AcquisitionSpec, physics: PhysicsSpec, progress: Progress = silent
) -> ProjectionStack:
    """Monoenergetic primary projections: pixel = round(open_field_value exp(-sum mu dr)).

    phantom: in the support frame (z = 0 on the top of the breast support); lifted by acquisition.air_gap_mm.
    returns: uint16 (views, pixels_y, pixels_x), one view per angle. report: rays, max_line_integral,
        min_pixel_value, attenuation (name of the table), mu_per_mm {tissue: value}, sampling, truncated, shadow_mm.
    raises: GeometryError where source, phantom and detector are not in this order along z, where the open field does
        not fit into the bits stored, or where the shadow leaves the detector and truncation is refused.
    """
    # Here and not above: the specification is read where nothing may load compiled code.
    from simcore.projection.stage import project_views

    return project_views(phantom, acquisition, physics, progress)


def project_spectrum(
    phantom: Phantom,
    acquisition: AcquisitionSpec,
    basis: NDArray[np.float64],
    beam: Beam,
    progress: Progress = silent,
) -> Primary:
    """Polyenergetic primary projections, without noise.

    phantom: in the support frame, as for ``project``. basis: (maps, MAX_TISSUES), what each map gives each label, 1 to
        4 maps; beam: their curves, spectrum and detector at a few energies.
    returns: absorbed energy of every pixel for one photon a steradian. report: energies_keV, least_transmission (signal
        over that of the open field), truncated, shadow_mm.
    raises: GeometryError as ``project``.
    """
    from simcore.projection.primary import project_primary

    return project_primary(phantom, acquisition, basis, beam, progress)


def attenuation_per_mm(physics: PhysicsSpec) -> tuple[float, ...]:
    """Linear attenuation coefficient of every label (core.tissues) that ``project`` uses, 1/mm."""
    from simcore.projection.materials import attenuation_table

    return tuple(float(mu) for mu in attenuation_table(physics.attenuation))
