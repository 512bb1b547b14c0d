"""From projections to a volume of attenuation coefficients: filtered and plain back-projection, iterative methods."""

from __future__ import annotations

from typing import TYPE_CHECKING

from simcore.core.progress import Progress, silent
from simcore.reconstruction.body import Body
from simcore.reconstruction.spec import FilteredBackprojection, ReconstructionSpec

if TYPE_CHECKING:  # whoever reads a specification needs no numerics
    from simcore.core.artifacts import ProjectionStack, Volume

__all__ = ["FilteredBackprojection", "ReconstructionSpec", "reconstruct"]


def reconstruct(
    stack: ProjectionStack,
    spec: ReconstructionSpec,
    thickness_mm: float,
    progress: Progress = silent,
    beyond_mm: tuple[float, float] = (0.0, 0.0),
) -> Volume:
    """Attenuation coefficients between the breast support and the compression paddle, and where there is tissue beyond.

    stack: detector signal of every view, uint16 (views, ny, nx).
    spec: which reconstruction, its slices and filters, and how the values are stored.
    thickness_mm: height of the compressed breast, mm: slices fill [support_height, support_height + thickness_mm].
    beyond_mm: how far tissue reaches below the support and above the paddle, mm: there are slices for it, too.
    progress: called with a fraction in [0, 1] and a message.
    returns: Volume in the detector frame, uint16 (nz, ny, nx); attenuation [1/mm] = slope * data + intercept.
    raises: GeometryError where the views do not span an angle, the slices reach the source, or a region holds no voxel.
    """
    # Here and not above: the specification is read where nothing may load compiled code.
    from simcore.reconstruction.methods import method_of

    return method_of(spec)(stack, spec, Body(thickness_mm, *beyond_mm), progress)
