"""One case from specification to DICOM: the stages in order, each computed once and kept in the store.

    phantom -> mesh -> fem -> warp -> projection -> reconstruction -> dicom -> mechanics -> preview

A second run of the same specification computes nothing; a run after a kill continues after the last whole stage;
a sweep over acquisitions grows and compresses its phantom once.
"""

from __future__ import annotations

import hashlib
import json
import platform
import sys
import time
from dataclasses import asdict, dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from simcore import __version__, dicom, fem, mesh, phantom, preview, projection, reconstruction, unused, warp
from simcore.cautions import cautions
from simcore.core import files
from simcore.core.artifacts import Compression, Phantom, ProjectionStack, Report, TetMesh, Volume
from simcore.core.progress import Progress
from simcore.core.progress import silent as no_progress
from simcore.core.store import Commits, FileRef, Hashing, Store, canonical, digest
from simcore.dicom.spec import ExportSpec
from simcore.fem.laws import MaterialSpec
from simcore.phantom.upload import registry
from simcore.phantom.upload.spec import UploadedPhantom
from simcore.spec import SimulationSpec
from simcore.stages import Beside, CaseProgress, Run, StageResult, silent

STAGES = ("phantom", "mesh", "fem", "warp", "projection", "reconstruction", "dicom", "mechanics", "preview")

# Raised whenever a stage gives other bytes for the same specification: old results then no longer match.
VERSIONS = {
    **dict.fromkeys(STAGES, 1),
    "phantom": 3,
    "fem": 3,
    "warp": 3,
    "projection": 3,
    "reconstruction": 2,
    "dicom": 5,
    "preview": 2,
}

# Outputs that a client gets; the others (label volume, mesh, displacement, ...) stay in the store.
PUBLIC_STAGES = ("dicom", "mechanics", "preview")
PUBLIC_FILES = ("geometry.json",)


@dataclass
class CaseResult:
    """A finished case: its manifest and where each public file lies in the store."""

    manifest: dict[str, Any]
    files: dict[str, FileRef]
    store: Store

    def write(self, out: Path) -> None:
        """Copies every file of the case and manifest.json below ``out``."""
        for name, ref in self.files.items():
            self.store.materialise(ref, out / name)
        out.mkdir(parents=True, exist_ok=True)
        (out / "manifest.json").write_text(json.dumps(self.manifest, indent=1) + "\n")


def run(spec: SimulationSpec, store: Store, progress: CaseProgress = silent) -> CaseResult:
    """Simulates one case.

    raises: SimulationError (its message says what to change); whatever was computed before stays in the store.
    """
    unused.refuse(spec)
    start = time.perf_counter()
    with Commits() as later:
        case = Run(store, VERSIONS, progress, later)
        _stages(case, spec)
    return _result(spec, store, case.records, time.perf_counter() - start)


def _stages(case: Run, spec: SimulationSpec) -> None:
    grown = _phantom(case, spec)
    if isinstance(spec.phantom, UploadedPhantom) and spec.phantom.compressed:
        meshed, warped = None, grown
        compressed = _uploaded_compression(case, spec.phantom, grown)
    else:
        meshed, compressed, warped = _compress(case, spec, grown)
    stack = case.stage(
        "projection",
        {"acquisition": spec.acquisition.parameters(), "physics": spec.physics.parameters()},
        {"phantom": warped},
        lambda p: projection.project(warped.artifact, spec.acquisition, spec.physics, p),
        files.save_stack,
        files.load_stack,
    )
    # Projections and volume go by the keys of their stages: what follows need not wait for their digests.
    with Beside(case) as beside:

        def mechanics(case: Run) -> None:
            if meshed is None:
                case.leave_out("mechanics")
                return
            case.file_stage(
                "mechanics",
                spec.compression.material.model_dump(),
                {"phantom": grown, "mesh": meshed, "compression": compressed},
                lambda folder, *_: _mechanics(folder, spec.compression.material, grown, meshed, compressed),
            )

        def made(progress: Progress = no_progress) -> Volume:
            thickness = compressed.artifact.thickness
            below, above = warped.record.report.get("beyond_plates_mm", (0.0, 0.0))
            return reconstruction.reconstruct(stack.artifact, spec.reconstruction, thickness, progress, (below, above))

        def reconstructed(progress: Progress) -> Volume:
            fresh = made(progress)
            beside.start(mechanics)  # from here on there is a core to spare
            return fresh

        def stored(locate: files.Locate) -> Volume:
            return files.load_volume(locate) if "volume.npy" in volume.record.outputs else made()

        volume = case.stage(
            "reconstruction",
            spec.reconstruction.model_dump(),
            {"projections": stack.key, "compression": compressed},
            reconstructed,
            files.save_volume if spec.reconstruction.is_kept else files.save_volume_facts,
            stored,
        )
        beside.start(mechanics)
        if not volume.cached:
            beside.start(lambda case: _show(case, grown, warped, stack, volume))
        _export(case, spec, grown, stack, volume, warped, compressed)
    if volume.cached:  # may have to be made again, which no thread beside may do
        _show(case, grown, warped, stack, volume)


def _show(
    case: Run,
    grown: StageResult[Phantom],
    warped: StageResult[Phantom],
    stack: StageResult[ProjectionStack],
    volume: StageResult[Volume],
) -> None:
    """Pictures of what was made."""
    case.file_stage(
        "preview",
        {},
        {"phantom": grown, "compressed": warped, "projections": stack.key, "volume": volume.key},
        lambda folder, *_: _previews(folder, grown, warped, stack, volume),
    )


def _export(
    case: Run,
    spec: SimulationSpec,
    grown: StageResult[Phantom],
    stack: StageResult[ProjectionStack],
    volume: StageResult[Volume],
    warped: StageResult[Phantom],
    compressed: StageResult[Compression],
) -> None:
    """The study in DICOM."""
    export = _named(spec.export, grown.key)
    description = dicom.CaseDescription(
        identity=digest({"version": __version__, "inputs": [r.key for r in case.records]}),
        seed=spec.seed,
        software_version=__version__,
        energy_keV=spec.physics.energy_keV,
        detector_bits=spec.acquisition.detector.bits,
        reconstruction_kind=spec.reconstruction.dicom_algorithm,
        reconstruction=spec.reconstruction.title,
        attenuation_per_mm=projection.attenuation_per_mm(spec.physics),
    )

    def write(folder: Path, key: str, hashing: Hashing, progress: Progress) -> Report:
        exported = dicom.export(
            folder,
            export,
            description,
            stack.artifact,
            volume.artifact,
            warped.artifact,
            compressed.artifact,
            progress,
            open_file=hashing.open,
        )
        return {"files": len(exported.names), **exported.report()}

    case.file_stage(
        "dicom",
        {"export": export.model_dump(), "case": asdict(description)},
        {"projections": stack.key, "volume": volume.key, "phantom": warped, "compression": compressed},
        write,
    )


def _phantom(case: Run, spec: SimulationSpec) -> StageResult[Phantom]:
    """Grown, or read from the store."""
    asked = spec.phantom
    if isinstance(asked, UploadedPhantom):
        uploaded = asked
        registry.require(case.store, uploaded)

        def read(progress: Progress) -> Phantom:
            with registry.open_file(case.store, uploaded) as file:
                return _with_outline(phantom.load(uploaded, file, progress))

        labels = uploaded.model_dump(exclude={"force_N", "extent_mm"})  # what changes no voxel
        return case.stage("phantom", {"spec": labels}, {}, read, files.save_phantom, files.load_phantom)
    grown = asked
    return case.stage(
        "phantom",
        {"spec": grown.model_dump(), "seed": spec.seed},
        {},
        lambda p: _with_outline(phantom.generate(grown, spec.seed, p)),
        files.save_phantom,
        files.load_phantom,
    )


def _with_outline(grown: Phantom) -> Phantom:
    """With the digest of what is breast and what is air in its report: all that most meshes depend on."""
    outline = hashlib.sha256(canonical(grown.grid.to_dict()))
    for layer in grown.labels:
        outline.update(np.packbits(layer).tobytes())  # air is 0
    return replace(grown, report={**grown.report, "outline_sha256": outline.hexdigest()})


def _compress(
    case: Run, spec: SimulationSpec, grown: StageResult[Phantom]
) -> tuple[StageResult[TetMesh], StageResult[Compression], StageResult[Phantom]]:
    """Mesh, compression and compressed phantom."""
    # Breasts of one outline (with and without lesions, of another seed) share their mesh, and where the law is the
    # same all over the breast, their compression.
    meshed = case.stage(
        "mesh",
        spec.mesh.parameters(),
        {"phantom": grown if mesh.reads_tissues(spec.mesh) else grown.record.report["outline_sha256"]},
        lambda p: mesh.build(grown.artifact, spec.mesh, p),
        files.save_mesh,
        files.load_mesh,
    )
    compressed = case.stage(
        "fem",
        spec.compression.model_dump(),
        {"phantom": grown, "mesh": meshed} if fem.reads_tissues(spec.compression) else {"mesh": meshed},
        lambda p: fem.compress(meshed.artifact, grown.artifact, spec.compression, p),
        files.save_compression,
        files.load_compression,
    )
    warped = case.stage(
        "warp",
        spec.warp.model_dump(),
        {"phantom": grown, "mesh": meshed, "compression": compressed},
        lambda p: warp.deform(grown.artifact, meshed.artifact, compressed.artifact, spec.warp, p),
        files.save_phantom,
        files.load_phantom,
    )
    return meshed, compressed, warped


def _uploaded_compression(case: Run, spec: UploadedPhantom, grown: StageResult[Phantom]) -> StageResult[Compression]:
    """The plates around a phantom that was compressed elsewhere."""
    case.leave_out("mesh")
    compressed = case.stage(
        "fem",
        {"thickness_mm": spec.thickness_mm, "force_N": spec.force_N},
        {"phantom": grown},
        lambda p: phantom.plates(spec, grown.artifact),
        files.save_compression,
        files.load_compression,
    )
    case.leave_out("warp")
    return compressed


def _named(spec: ExportSpec, phantom_key: str) -> ExportSpec:
    """A patient without a name is named after the phantom: all studies of one breast are of one patient."""
    return spec if spec.patient_id else spec.with_(patient_id=phantom_key[:12])


def _mechanics(
    folder: Path,
    material: MaterialSpec,
    grown: StageResult[Phantom],
    meshed: StageResult[TetMesh],
    compressed: StageResult[Compression],
) -> Report:
    fem.write_vtu(folder / "compression.vtu", meshed.artifact, compressed.artifact, grown.artifact, material)
    return {}


def _previews(
    folder: Path,
    grown: StageResult[Phantom],
    warped: StageResult[Phantom],
    stack: StageResult[ProjectionStack],
    volume: StageResult[Volume],
) -> Report:
    preview.write_previews(
        folder,
        phantom=grown.artifact,
        compressed=warped.artifact,
        stack=stack.artifact,
        volume=volume.artifact,
    )
    return {}


def _result(spec: SimulationSpec, store: Store, records: list[StageResult[Any]], seconds: float) -> CaseResult:
    public = {
        name: ref
        for r in records
        for name, ref in r.record.outputs.items()
        if r.record.stage in PUBLIC_STAGES or name in PUBLIC_FILES
    }
    reports = {r.record.stage: r.record.report for r in records}
    manifest = {
        "schema": "tomosim-manifest/1",
        "software": {"name": "tomosim", "version": __version__, "libraries": _libraries()},
        "host": {
            "machine": platform.machine(),
            "system": platform.system(),
            "python": sys.version.split()[0],
        },
        "specification": spec.model_dump(mode="json"),
        "seed": spec.seed,
        "seconds": round(seconds, 3),
        "computed_stages": sum(not r.cached for r in records),
        "stages": [
            {
                "name": r.record.stage,
                "version": r.record.version,
                "key": r.record.key,
                "cached": r.cached,
                "seconds": r.record.seconds,
                "peak_memory_bytes": r.record.peak_memory_bytes,
                "outputs": {name: asdict(ref) for name, ref in r.record.outputs.items()},
                "report": r.record.report,
            }
            for r in records
        ],
        "results": {**_results(reports), "cautions": cautions(spec, reports)},
        "files": {name: asdict(ref) for name, ref in public.items()},
    }
    return CaseResult(manifest, public, store)


def _results(reports: dict[str, Report]) -> Report:
    """The numbers people ask for first, gathered from the reports of the stages."""
    wanted = {
        "phantom": ("volume_ml", "glandularity", "compartments", "tissue_ml"),
        "mesh": ("tets", "nodes"),
        "fem": ("force_N", "thickness_mm", "uncompressed_thickness_mm", "min_det_F", "volume_change"),
        "warp": (
            "volume_after_ml",
            "tissue_before_ml",
            "tissue_after_ml",
            "lesion_objects",
            "beyond_plates_mm",
        ),
        "projection": ("truncated",),
        "dicom": ("left_out", "notes"),
    }
    return {
        name: reports[stage][name]
        for stage, names in wanted.items()
        for name in names
        if name in reports.get(stage, {})
    }


def _libraries() -> dict[str, str]:
    names = ("numpy", "scipy", "numba", "pydicom", "pytetwild", "scikit-image", "zstandard")
    return {name: metadata.version(name) for name in names}
