"""Transport of photons: scatter on the detector and dose in the breast, by Monte Carlo in the compressed labels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from simcore.core.progress import Progress, silent
from simcore.transport.spec import BodySpec, TransportSpec

if TYPE_CHECKING:  # whoever reads a specification needs no numerics
    from simcore.core.artifacts import Phantom, TransportResult
    from simcore.core.geometry import AcquisitionGeometry
    from simcore.core.tissues import Tissue
    from simcore.physics.materials import Material
    from simcore.physics.spectrum import Emission
    from simcore.transport.response import DetectorResponse, GridTransmission
    from simcore.transport.scene import Plate

__all__ = ["BodySpec", "TransportSpec", "transport"]


def transport(
    phantom: Phantom,
    geometry: AcquisitionGeometry,
    spec: TransportSpec,
    *,
    spectrum: Emission,
    tissues: Mapping[Tissue, Material],
    plates: Sequence[Plate] = (),
    response: DetectorResponse | None = None,
    grid: GridTransmission | None = None,
    seed: int = 0,
    progress: Progress = silent,
) -> TransportResult:
    """Scatter and dose of every view, per photon and steradian that the source emits.

    phantom:  in the support frame (z = 0 on the top of the breast support, x = 0 the chest wall); lifted by
        geometry.support_height. The beam is collimated to the detector.
    spectrum: behind all filters and the air: what stands between source and the uppermost plate is vacuum here.
    tissues:  composition of every label. plates: paddle, support, detector cover, at heights above the detector.
    response: what the detector absorbs of a photon; all of it where not given. grid: antiscatter grid.
    seed:     of the random numbers; the same bytes come of the same seed on any number of threads.
    raises: GeometryError where the source is not above the breast or tissue lies behind the chest wall; SpecError for a
        tissue without composition; SimulationError where energies do not balance.
    """
    # Here and not above: the specification is read where nothing may load compiled code.
    from simcore.transport.response import IDEAL
    from simcore.transport.stage import transport_views

    return transport_views(
        phantom,
        geometry,
        spec,
        spectrum,
        tissues,
        plates,
        IDEAL if response is None else response,
        grid,
        seed,
        progress,
    )
