"""The transport stage: a compressed breast, a geometry, a spectrum in; scatter and dose out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import Phantom, TransportResult
from simcore.core.errors import GeometryError, SimulationError, SpecError
from simcore.core.geometry import AcquisitionGeometry
from simcore.core.progress import Progress, part
from simcore.core.tissues import Tissue
from simcore.physics.materials import Material, material
from simcore.physics.spectrum import Emission
from simcore.transport.cells import LABELS, Cells, cells_of
from simcore.transport.denoising import denoised
from simcore.transport.dose import (
    MGY_PER_KEV_PER_G,
    Figure,
    air_kerma,
    entrance_dose,
    equivalent,
    glandular_dose,
    masses,
)
from simcore.transport.monte_carlo import Sums, error, imbalance, mean, simulate
from simcore.transport.response import IDEAL, DetectorResponse, GridTransmission, Response, tabulated
from simcore.transport.scene import Body, Plate, Setting, setting_of
from simcore.transport.spec import TransportSpec
from simcore.transport.views import cell_sides

FloatArray = NDArray[np.float64]
PLATE_MARGIN_MM = 10.0
CAPPED = (int(Tissue.CALCIFICATION),)
ERRORS_ALLOWED = 6.0
IMBALANCE_ALLOWED = 2e-3
DOSE_MODEL = (
    "Monte Carlo in the labels of the compressed breast; photo-absorption and Compton recoil are absorbed on the spot"
)
EQUIVALENT_MODEL = (
    "Monte Carlo in a breast of the same shape and skin, filled with a homogeneous mixture of adipose and glandular "
    "tissue of the same glandularity by mass"
)


def transport_views(
    phantom: Phantom, geometry: AcquisitionGeometry, spec: TransportSpec, spectrum: Emission,
    tissues: Mapping[Tissue, Material], plates: Sequence[Plate], response: DetectorResponse,
    grid: GridTransmission | None, seed: int, progress: Progress,
) -> TransportResult:  # fmt: skip
    """See simcore.transport.transport."""
    _check_place(phantom, geometry)
    substances = by_label(phantom, tissues)
    cells = cells_of_phantom(phantom, geometry, np.eye(LABELS), spec.cell_mm)
    setting = setting_in(cells, substances, plates, spec, geometry)
    table = tabulated(response, grid, float(spectrum.energies_keV[-1]))
    sums = _simulated(
        setting, geometry, spectrum, table, spec, spec.rays_per_view, seed, "breast", part(progress, 0, 0.75)
    )
    becomes, glandularity = equivalent(cells.volumes(), substances)
    uniform_cells = cells_of_phantom(phantom, geometry, becomes, spec.cell_mm)
    uniform_setting = setting_in(uniform_cells, substances, plates, spec, geometry)
    uniform = _simulated(
        uniform_setting, geometry, spectrum, tabulated(IDEAL, None, float(spectrum.energies_keV[-1])), spec,
        spec.equivalent_breast_rays_per_view, seed, "equivalent", part(progress, 0.75, 0.95),
    )  # fmt: skip
    scatter, variance, errors = _scatter(sums, geometry, spec)
    report = {
        **_energies(setting, sums),
        "dose": _doses(setting, sums, uniform_setting, uniform, glandularity, geometry, spectrum),
        "scatter": errors,
    }
    progress(1.0, "transported")
    return TransportResult(scatter, variance, report)


def _check_place(phantom: Phantom, geometry: AcquisitionGeometry) -> None:
    corner = phantom.grid.corner
    behind = int(np.ceil(-corner[0] / phantom.grid.spacing[0] - 1e-6))
    if behind > 0 and phantom.labels[..., :behind].any():
        raise GeometryError(
            f"the phantom has tissue behind the chest wall, down to x = {corner[0]:g} mm; the transport has a body of "
            "one material there: cut the phantom off at x = 0"
        )
    top = phantom.grid.upper[2] + geometry.support_height
    for view, source in enumerate(geometry.sources):
        if source[2] <= top:
            raise GeometryError(
                f"view {view}: the source stands {source[2]:g} mm above the detector, not above the breast, which "
                f"reaches to {top:g} mm; raise source_to_detector_mm"
            )


def by_label(phantom: Phantom, tissues: Mapping[Tissue, Material]) -> list[Material | None]:
    """The material of every label, LABELS of them; None where the phantom does not have it, so that it counts neither
    for the tables nor for the majorant. Adipose tissue and gland are there for the equivalent breast.

    raises: SpecError for a tissue of the phantom without one.
    """
    substances: list[Material | None] = [None] * LABELS
    for label in np.flatnonzero(np.bincount(phantom.labels.ravel(), minlength=LABELS)).tolist():
        if label == Tissue.AIR:
            continue
        name = Tissue(label).name.lower() if label in set(Tissue) else f"label {label}"
        substances[label] = tissues.get(Tissue(label)) if label in set(Tissue) else None
        if substances[label] is None:
            raise SpecError(
                f"{name} is in the breast, but there is no composition of it; give one", code="no-composition"
            )
    for tissue in (Tissue.ADIPOSE, Tissue.GLAND):
        substances[tissue] = tissues.get(tissue)
    return substances


def cells_of_phantom(phantom: Phantom, geometry: AcquisitionGeometry, becomes: FloatArray, edge_mm: float) -> Cells:
    """Cells of a phantom in the detector frame; becomes: see cells_of."""
    return cells_of(phantom.labels, phantom.grid.moved(z=geometry.support_height), becomes, edge_mm)


def setting_in(
    cells: Cells, tissues: list[Material | None], plates: Sequence[Plate], spec: TransportSpec,
    geometry: AcquisitionGeometry,
) -> Setting:  # fmt: skip
    """The scene: plates reach beyond the detector and the breast, so that their edges do not matter."""
    detector = geometry.detector
    reach = (
        max(detector.nx * detector.pixel, cells.upper[0]) + PLATE_MARGIN_MM,
        max(detector.ny * detector.pixel / 2, cells.upper[1], -cells.corner[1]) + PLATE_MARGIN_MM,
    )
    body = None if spec.body is None else Body(material(spec.body.material), spec.body.depth_mm)
    return setting_of(cells, tissues, plates, body, reach)


def _simulated(
    setting: Setting, geometry: AcquisitionGeometry, spectrum: Emission, response: Response, spec: TransportSpec,
    rays: int, seed: int, purpose: str, progress: Progress,
) -> Sums:  # fmt: skip
    """The sums of all views; raises where their energies do not balance."""
    sums = simulate(
        setting, geometry, spectrum, response,
        rays=rays, grid_mm=spec.grid_mm, capped=CAPPED, seed=seed, purpose=purpose, progress=progress,
    )  # fmt: skip
    missing, deviation = imbalance(sums)
    off = np.abs(missing) > ERRORS_ALLOWED * deviation + IMBALANCE_ALLOWED
    if off.any():
        view = int(np.flatnonzero(off)[0])
        raise SimulationError(
            f"view {view}: {missing[view]:.2%} of the energy that was sent out is neither absorbed nor gone, with a "
            f"standard error of {deviation[view]:.2%}; this is a fault of the transport, please report it",
            code="energy-balance",
        )
    return sums


def _scatter(
    sums: Sums, geometry: AcquisitionGeometry, spec: TransportSpec
) -> tuple[NDArray[np.float32], NDArray[np.float32], dict[str, Any]]:
    """Scatter, its variance, and what is said of them."""
    raw = mean(sums.signal)
    sides = cell_sides(geometry, (raw.shape[-2], raw.shape[-1]))
    if spec.scatter == "none":
        nothing = np.zeros((len(raw), *raw.shape[2:]), np.float32)
        return nothing, nothing.copy(), {"kind": "none", "cell_mm": list(sides)}
    along = _along(geometry)
    smooth = denoised(raw[:, 0], sums.primary, sides, along)
    halves = [denoised(sums.signal[:, first::2, 0].mean(axis=1), sums.primary, sides, along) for first in range(2)]
    shadow = sums.primary.shadow
    total = sums.signal[:, :, 0].sum(axis=(-2, -1))
    energy = raw[:, 1].sum(axis=(-2, -1)) / raw[:, 0].sum(axis=(-2, -1))
    energy_along = np.stack([np.full(shadow.shape[1:], value) for value in energy])
    primary = sums.primary.signal
    report = {
        "kind": "monte-carlo",
        "cell_mm": list(sides),
        "mean_energy_keV": energy.tolist(),
        "to_primary_in_shadow": [
            float(s[m].sum() / p[m].sum()) if m.any() else None for s, p, m in zip(smooth, primary, shadow, strict=True)
        ],
        "standard_error_of_totals": (error(total) / mean(total)).tolist(),
        "standard_error_of_cells": _half_difference(halves, shadow),
    }
    return smooth.astype(np.float32), (smooth * energy_along).astype(np.float32), report


def _half_difference(halves: list[FloatArray], shadow: NDArray[np.bool_]) -> float | None:
    """Relative standard error of the smooth maps in the shadow, from two of half the photons each."""
    if not shadow.any():
        return None
    first, second = (half[shadow] for half in halves)
    return float(np.sqrt(np.mean(((first - second) / (first + second)) ** 2)))


def _along(geometry: AcquisitionGeometry) -> FloatArray | None:
    """Position of the sources on their arc; None where they are not on an arc in the plane of the chest wall."""
    on_arc = geometry.detector_poses is None and np.ptp(geometry.sources[:, 0]) < 1.0
    return geometry.angles if on_arc else None


def _energies(setting: Setting, sums: Sums) -> dict[str, Any]:
    """Where the energy that was sent towards the detector went, of all views."""
    started = mean(sums.started).sum()
    deposit = mean(sums.deposit).sum(axis=0) / started
    missing, deviation = imbalance(sums)
    plates = float(deposit[list(setting.plates)].sum())
    return {
        "energy_shares": {
            **{tissue.name.lower(): float(deposit[tissue]) for tissue in Tissue if deposit[tissue] > 0},
            "plates": plates,
            "body": 0.0 if setting.body is None else float(deposit[setting.body]),
            "left": float(mean(sums.left).sum() / started),
        },
        "energy_imbalance": missing.tolist(),
        "energy_imbalance_standard_error": deviation.tolist(),
    }


def _doses(
    setting: Setting, sums: Sums, uniform_setting: Setting, uniform: Sums, glandularity: float,
    geometry: AcquisitionGeometry, spectrum: Emission,
) -> dict[str, Any]:  # fmt: skip
    """Doses, mGy per mGy of incident air kerma of the central view at the same number of photons in every view."""
    kerma = air_kerma(setting, geometry, spectrum)
    central = float(kerma[int(np.argmin(np.abs(geometry.angles)))])
    mass = masses(setting)
    deposit = sums.deposit[..., :LABELS] * MGY_PER_KEV_PER_G
    tissues = {
        tissue.name.lower(): Figure(
            mean(deposit[..., tissue]) / mass[tissue], error(deposit[..., tissue]) / mass[tissue]
        )
        for tissue in Tissue
        if mass[tissue] > 0
    }
    figures = {
        "glandular": glandular_dose(setting, sums),
        "equivalent_breast_glandular": glandular_dose(uniform_setting, uniform),
        "entrance": entrance_dose(setting, sums),
        **{f"tissue_{name}": figure for name, figure in tissues.items()},
    }
    return {
        "model": DOSE_MODEL,
        "equivalent_breast_model": EQUIVALENT_MODEL,
        "equivalent_breast_glandularity": glandularity,
        "air_kerma_mGy_per_photon_per_sr": kerma.tolist(),
        "unit": "mGy per mGy incident air kerma of the central view",
        **{name: None if figure is None else figure.per(central) for name, figure in figures.items()},
    }
