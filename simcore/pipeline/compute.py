"""What each stage computes or writes, from the artifacts of others."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from simcore import __version__, dicom, fem, mesh, phantom, projection, reconstruction, warp
from simcore.core.artifacts import Compression, Phantom, Primary, ProjectionStack, Report, TetMesh, Volume
from simcore.core.canonical import digest
from simcore.core.progress import Progress
from simcore.dicom.spec import ExportSpec
from simcore.pipeline import xray
from simcore.pipeline.graph import Case, Work


def phantom_of(case: Case, progress: Progress) -> Phantom:
    return phantom.with_outline(phantom.build(case.spec.phantom, case.spec.seed, case.store, progress))


def mesh_of(case: Case, progress: Progress) -> TetMesh:
    return mesh.build(case.artifact("phantom"), case.spec.mesh, progress)


def compression_parameters(case: Case) -> Any:
    return case.spec.phantom.plates() or case.spec.compression.model_dump()


def compression_of(case: Case, progress: Progress) -> Compression:
    spec = case.spec.phantom
    if spec.kind == "uploaded" and spec.compressed:
        return phantom.plates(spec, case.artifact("phantom"))
    return fem.compress(case.artifact("mesh"), case.artifact("phantom"), case.spec.compression, progress)


def compressed_phantom_of(case: Case, progress: Progress) -> Phantom:
    grown, compression = case.artifact("phantom"), case.artifact("fem")
    return warp.deform(grown, case.artifact("mesh"), compression, case.spec.warp, progress)


def projection_parameters(case: Case) -> Any:
    physics = case.spec.physics
    own = physics.projection_parameters() if physics.kind == "xray" else physics.parameters()
    return {"acquisition": case.spec.acquisition.parameters(), "physics": own}


def projections_of(case: Case, progress: Progress) -> ProjectionStack | Primary:
    physics = case.spec.physics
    if physics.kind == "xray":
        return xray.primary_of(case, progress)
    return projection.project(case.artifact("warp"), case.spec.acquisition, physics, progress)


def transport_parameters(case: Case) -> Any:
    acquisition = case.spec.acquisition.parameters()
    return {"acquisition": acquisition, "physics": xray.xray(case).transport_parameters(), "seed": case.spec.seed}


def detection_parameters(case: Case) -> Any:
    return {"physics": xray.xray(case).detection_parameters(), "seed": case.spec.seed}


def volume_of(case: Case, progress: Progress) -> Volume:
    thickness = case.artifact("fem").thickness
    below, above = case.report("warp").get("beyond_plates_mm", (0.0, 0.0))
    stack = case.artifact("detection")
    return reconstruction.reconstruct(stack, case.spec.reconstruction, thickness, progress, (below, above))


def export_parameters(case: Case) -> Any:
    return {"export": _export_spec(case).model_dump(), "case": asdict(_description(case))}


def write_study(case: Case, work: Work) -> Report:
    exported = dicom.export(
        work.folder,
        _export_spec(case),
        _description(case),
        case.artifact("detection"),
        case.artifact("reconstruction"),
        case.artifact("warp"),
        case.artifact("fem"),
        work.progress,
        open_file=work.hashing.open,
    )
    return {"files": len(exported.names), **exported.report()}


def _export_spec(case: Case) -> ExportSpec:
    """A patient without a name is named after the phantom: all studies of one breast are of one patient."""
    export = case.spec.export
    return export if export.patient_id else export.with_(patient_id=case.results["phantom"].key[:12])


def _description(case: Case) -> dicom.CaseDescription:
    spec = case.spec
    return dicom.CaseDescription(
        identity=digest({"version": __version__, "inputs": [r.key for r in case.records]}),
        seed=spec.seed,
        software_version=__version__,
        energy_keV=xray.energy_keV(case) if spec.physics.kind == "xray" else spec.physics.energy_keV,
        detector_bits=16 if spec.physics.kind == "xray" else spec.acquisition.detector.bits,
        reconstruction_kind=spec.reconstruction.dicom_algorithm,
        reconstruction=spec.reconstruction.title,
        attenuation_per_mm=(
            xray.attenuation_per_mm(case)
            if spec.physics.kind == "xray"
            else projection.attenuation_per_mm(spec.physics)
        ),
        exposure=xray.exposure_of(case) if spec.physics.kind == "xray" else None,
    )


def write_mechanics(case: Case, work: Work) -> Report:
    path, material = work.folder / "compression.vtu", case.spec.compression.material
    fem.write_vtu(path, case.artifact("mesh"), case.artifact("fem"), case.artifact("phantom"), material)
    return {}


def write_previews(case: Case, work: Work) -> Report:
    from simcore import preview  # here and not above: it loads compiled code

    preview.write_previews(
        work.folder,
        phantom=case.artifact("phantom"),
        compressed=case.artifact("warp"),
        stack=case.artifact("detection"),
        volume=case.artifact("reconstruction"),
    )
    return {}
