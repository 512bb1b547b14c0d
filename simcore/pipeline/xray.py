"""The stages of ``physics.kind = "xray"``: what tube, materials, detector and exposure mean to projection, transport
and detection."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from simcore import detection, projection, transport
from simcore.core.artifacts import Primary, ProjectionStack, Report, TransportResult
from simcore.core.errors import SpecError
from simcore.core.progress import Progress
from simcore.pipeline.graph import Case
from simcore.projection.spec import AcquisitionSpec, SlabSpec
from simcore.xray import XraySpec

if TYPE_CHECKING:
    from simcore.dicom.exposure import Exposure
    from simcore.physics.spectrum import Emission
    from simcore.projection.spectral import Beam
    from simcore.transport.scene import Plate

ANODES = {"W": "TUNGSTEN", "Mo": "MOLYBDENUM", "Rh": "RHODIUM"}
COSINES = (0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.925, 0.95, 0.975, 1.0)
ALUMINIUM_MM = 0.2
"""Contrast of this much aluminium is that of exposures by contrast to noise."""
REGION_MM = 10.0
"""The densest part of the breast is the square of this edge with the least signal, as exposure controls look for it."""
BREAST_BELOW = 0.8
"""Signal over that of the open field below which a square counts as breast."""


@dataclass(frozen=True)
class Optics:
    """Spectrum, plates and detector of a case. plates: (material, thickness), mm."""

    emission: Emission
    plates: tuple[tuple[str, float], ...]
    spec: XraySpec


def optics_of(acquisition: AcquisitionSpec, spec: XraySpec) -> Optics:
    """raises: SpecError for a plate whose material has no composition"""
    from simcore.physics.spectrum import emission

    air_mm = acquisition.source_to_detector_mm - acquisition.air_gap_mm
    plates = tuple((_plate_material(slab, name), slab.thickness_mm) for name, slab in _slabs(acquisition))
    return Optics(emission(spec.tube, air_mm), plates, spec)


def _slabs(acquisition: AcquisitionSpec) -> list[tuple[str, SlabSpec]]:
    pairs = (("support", acquisition.support), ("paddle", acquisition.paddle))
    return [(name, slab) for name, slab in pairs if slab is not None]


def _plate_material(slab: SlabSpec, name: str) -> str:
    if slab.material == "other":
        message = "has no composition, which physics.kind = 'xray' needs: take pmma, polycarbonate or carbon-fibre"
        raise SpecError(
            f"acquisition.{name}.material = 'other': {message}",
            code="no-composition",
            problems=[{"field": f"acquisition.{name}.material", "value": "other", "message": message}],
        )
    return slab.material


def primary_of(case: Case, progress: Progress) -> Primary:
    """The primary projections."""
    spec = xray(case)
    basis, beam, worst = _beam(optics_of(case.spec.acquisition, spec))
    primary = projection.project_spectrum(case.artifact("warp"), case.spec.acquisition, basis, beam, progress)
    primary.report.update(spectrum_error=worst, **_spectrum_facts(case))
    return primary


def _beam(optics: Optics) -> tuple[Any, Beam, float]:
    """(basis, beam, largest error of eight energies in place of all)."""
    from simcore.detection.response import response
    from simcore.physics.attenuation import attenuation
    from simcore.physics.basis import basis_of, nodes_of
    from simcore.physics.materials import material
    from simcore.physics.spectrum import tissue_materials
    from simcore.projection.spectral import Beam

    energies, photons = optics.emission.energies_keV, optics.emission.photons / optics.emission.photons.sum()
    tissues = tissue_materials(optics.spec.materials)
    plates = sum((attenuation(material(name), energies) * mm for name, mm in optics.plates), np.zeros(len(energies)))
    straight = response(optics.spec.detector.converter, energies)
    weights = np.array([photons * straight.signal, photons * straight.variance])
    basis = basis_of(tissues, energies, weights[0])
    nodes = nodes_of(tissues, basis, energies, weights, plates)
    at_nodes = np.interp(nodes.energies_keV, energies, plates)
    # What slant photons leave, relative to perpendicular ones, behind 40 mm of gland.
    behind = photons * np.exp(-plates - 40.0 * basis.coefficients[:, 2] @ basis.curves)
    slant = response(optics.spec.detector.converter, energies[:, None], np.array(COSINES)).signal
    absorption = behind @ slant / (behind @ straight.signal)
    beam = Beam(nodes.energies_keV, nodes.curves, at_nodes, nodes.weights, np.array(COSINES), absorption)
    return basis.coefficients, beam, nodes.worst


def _spectrum_facts(case: Case) -> Report:
    """What people ask of a beam: behind the paddle, in front of the breast."""
    from simcore.physics.attenuation import attenuation
    from simcore.physics.materials import material
    from simcore.physics.spectrum import air_kerma, value_layer

    optics = optics_of(case.spec.acquisition, xray(case))
    energies, photons = optics.emission.energies_keV, optics.emission.photons
    paddle = case.spec.acquisition.paddle
    if paddle is not None:
        photons = photons * np.exp(-attenuation(material(paddle.material), energies) * paddle.thickness_mm)
    absolute = optics.emission.absolute
    return {
        "half_value_layer_mm": value_layer(energies, photons),
        "mean_energy_keV": float(photons @ energies / photons.sum()),
        "air_kerma_mGy_per_mAs_at_1m": air_kerma(energies, photons, 1000.0) if absolute else None,
    }


def transport_of(case: Case, progress: Progress) -> TransportResult:
    """Scatter and dose."""
    from simcore.detection.response import response
    from simcore.physics.spectrum import tissue_materials
    from simcore.transport.response import DetectorResponse

    spec = xray(case)
    optics = optics_of(case.spec.acquisition, spec)
    energies = optics.emission.energies_keV
    table = np.arange(1.0, math.ceil(energies[-1]) + 1.0, 0.5)
    leaves = response(spec.detector.converter, table[:, None], np.array(COSINES))
    return transport.transport(
        case.artifact("warp"),
        projection.geometry_of(case.spec.acquisition),
        spec.transport,
        spectrum=optics.emission,
        tissues=tissue_materials(spec.materials),
        plates=_plates(case),
        response=DetectorResponse(
            table,
            np.array(COSINES),
            leaves.signal / table[:, None],
            np.minimum(leaves.variance / table[:, None] ** 2, 1.0),
        ),
        seed=case.spec.seed,
        progress=progress,
    )


def _plates(case: Case) -> list[Plate]:
    from simcore.physics.materials import material
    from simcore.transport.scene import Plate

    acquisition = case.spec.acquisition
    bottom, top = acquisition.air_gap_mm, acquisition.air_gap_mm + case.artifact("warp").grid.upper[2]
    plates = []
    for name, slab in _slabs(acquisition):
        low = top if name == "paddle" else bottom - slab.thickness_mm
        plates.append(Plate(material(_plate_material(slab, name)), low, low + slab.thickness_mm))
    return plates


def stack_of(case: Case, progress: Progress) -> ProjectionStack:
    """What the detector makes of primary and scatter at the exposure that is asked for."""
    from simcore.detection.stack import Expected
    from simcore.physics.exposure import solve
    from simcore.physics.upsampling import spread_over_pixels

    spec = xray(case)
    primary, scattered = case.artifact("projection"), case.artifact("transport")
    geometry = primary.geometry
    shares = spec.exposure.shares(geometry.views)
    photons_per_mGy = 1.0 / _central(scattered, geometry.angles)
    response = _response(case, primary, scattered, photons_per_mGy, shares)
    if spec.exposure.kind == "mean_glandular_dose" and not response.dose_mGy > 0:
        message = "the breast has no glandular tissue: take another kind of exposure, such as 'air_kerma'"
        raise SpecError(
            f"physics.exposure.kind = 'mean_glandular_dose': {message}",
            problems=[{"field": "physics.exposure.kind", "value": "mean_glandular_dose", "message": message}],
        )
    kerma = solve(spec.exposure, response)
    shape, area = primary.signal.shape[1:], geometry.detector.pixel**2
    signal, variance = np.empty((2, *primary.signal.shape), np.float32)
    flat = np.empty_like(signal)
    for view, share in enumerate(shares):
        photons = np.float32(kerma * share * photons_per_mGy)
        np.multiply(primary.signal[view], primary.variance[view], out=variance[view])
        variance[view] += spread_over_pixels(scattered.scatter_variance[view], shape) * np.float32(area)
        np.add(
            primary.signal[view],
            spread_over_pixels(scattered.scatter[view], shape) * np.float32(area),
            out=signal[view],
        )
        flat[view] = spread_over_pixels(primary.open_signal[view], shape)
        for array in (signal, variance, flat):
            array[view] *= photons
            np.maximum(array[view], 0.0, out=array[view])
    height = geometry.support_height + case.artifact("warp").grid.upper[2] / 2
    expected = Expected(signal, variance, flat, object_height_mm=height)
    detected = detection.detect(expected, spec.detector, geometry, case.spec.seed, progress)
    report = {**detected.report, **_exposure_facts(case, scattered, kerma, shares, response)}
    return ProjectionStack(detected.processed, detected.open_field_value, geometry, report)


def _central(scattered: TransportResult, angles: Any) -> float:
    """Incident air kerma of the central view, mGy for a photon a steradian."""
    kerma = scattered.report["dose"]["air_kerma_mGy_per_photon_per_sr"]
    return float(kerma[int(np.argmin(np.abs(angles)))])


def _response(case: Case, primary: Primary, scattered: TransportResult, photons_per_mGy: float, shares: Any) -> Any:
    """What 1 mGy of incident air kerma in all views gives."""
    from simcore.physics.attenuation import attenuation
    from simcore.physics.exposure import Response
    from simcore.physics.materials import material

    spec, geometry = xray(case), primary.geometry
    view = int(np.argmin(np.abs(geometry.angles)))
    pixels = max(1, round(REGION_MM / geometry.detector.pixel))
    photons = photons_per_mGy / geometry.views
    signal, ratio = _densest(primary, view, pixels)
    area = geometry.detector.pixel**2
    scatter, scatter_variance = (
        float(np.mean(cells[view])) * area for cells in (scattered.scatter, scattered.scatter_variance)
    )
    mu = float(attenuation(material("aluminium"), primary.report["mean_energy_keV"]))
    gain = spec.detector.gain_DN_per_keV or 1.0
    noise = spec.detector.electronic_noise
    sigma = noise.sigma / spec.detector.converter.electrons_per_keV * gain if noise.unit == "electrons" else noise.sigma
    glandular = scattered.report["dose"]["glandular"]
    dose = float("nan") if glandular is None else float(np.array(glandular["views"]) @ shares)
    output = primary.report["air_kerma_mGy_per_mAs_at_1m"]
    distance = geometry.source_to_detector - geometry.support_height - case.artifact("warp").grid.upper[2]
    load = float("nan") if output is None else 1.0 / (output * (1000.0 / distance) ** 2)
    return Response(
        dose_mGy=dose,
        load_mAs=load,
        signal=photons * (signal + scatter) * gain,
        variance=photons * (signal * ratio + scatter_variance) * gain**2,
        contrast=photons * signal * -math.expm1(-mu * ALUMINIUM_MM) * gain,
        electronic_variance=sigma**2,
    )


def _densest(primary: Primary, view: int, pixels: int) -> tuple[float, float]:
    """(signal, variance over signal) of the square of the central view with the least signal."""
    ny, nx = (n // pixels * pixels for n in primary.signal.shape[1:])
    blocks = primary.signal[view, :ny, :nx].reshape(ny // pixels, pixels, nx // pixels, pixels).mean(axis=(1, 3))
    j, i = np.unravel_index(int(np.argmin(blocks)), blocks.shape)
    part = np.s_[view, j * pixels : (j + 1) * pixels, i * pixels : (i + 1) * pixels]
    return float(blocks[j, i]), float(primary.variance[part].mean(dtype=np.float64))


def _exposure_facts(case: Case, scattered: TransportResult, kerma: float, shares: Any, response: Any) -> Report:
    dose = scattered.report["dose"]

    def total(name: str) -> float | None:
        figure = dose.get(name)
        return None if figure is None else kerma * float(np.array(figure["views"]) @ shares)

    return {
        "incident_air_kerma_mGy": kerma,
        "mean_glandular_dose_mGy": total("glandular"),
        "mean_glandular_dose_equivalent_breast_mGy": total("equivalent_breast_glandular"),
        "entrance_dose_mGy": total("entrance"),
        "dose_model": dose["model"],
        "load_mAs": None if math.isnan(response.load_mAs) else kerma * response.load_mAs,
        "view_shares": [float(share) for share in shares],
    }


def energy_keV(case: Case) -> float:
    """Mean energy of the photons in front of the breast: what the values of the volume hold for, without correction of
    beam hardening."""
    return float(case.report("projection")["mean_energy_keV"])


def attenuation_per_mm(case: Case) -> tuple[float, ...]:
    """Attenuation coefficient of every label at that energy, 1/mm."""
    from simcore.core.tissues import MAX_TISSUES, Tissue
    from simcore.physics.attenuation import attenuation
    from simcore.physics.spectrum import tissue_materials

    tissues = tissue_materials(xray(case).materials)
    energy = energy_keV(case)
    return tuple(
        float(attenuation(tissues[Tissue(label)], energy))
        if label and label in set(Tissue) and Tissue(label) in tissues
        else 0.0
        for label in range(MAX_TISSUES)
    )


def exposure_of(case: Case) -> Exposure:
    """What the files say of tube, load and dose."""
    from simcore.dicom.exposure import Exposure

    spec, facts = xray(case), case.report("detection")
    filter = spec.tube.filters[0] if spec.tube.filters and spec.tube.measured is None else None
    return Exposure(
        peak_kV=spec.tube.kVp,
        anode=ANODES[spec.tube.anode],
        filter_material="NONE" if filter is None else filter.material.upper(),
        filter_mm=0.0 if filter is None else filter.thickness_mm,
        half_value_layer_mm=case.report("projection")["half_value_layer_mm"],
        load_mAs=facts["load_mAs"] or 0.0,
        entrance_dose_mGy=facts["entrance_dose_mGy"] or 0.0,
        glandular_dose_mGy=facts["mean_glandular_dose_mGy"] or 0.0,
        remark="simulation; the time that the tube radiates is not modelled, stands as 0",
    )


def xray(case: Case) -> XraySpec:
    """The physics of the case, which is of this kind."""
    spec = case.spec.physics
    assert isinstance(spec, XraySpec)
    return spec
