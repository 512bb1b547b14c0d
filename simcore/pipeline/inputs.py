"""What each stage takes of others; None where a case has no use for the stage."""

from __future__ import annotations

from simcore import fem, mesh
from simcore.pipeline.graph import Inputs, Source
from simcore.spec import SimulationSpec

GROWN, MESH, COMPRESSION, COMPRESSED = Source("phantom"), Source("mesh"), Source("fem"), Source("warp")
PROJECTIONS, VOLUME = Source("detection", "key"), Source("reconstruction", "key")
OUTLINE = Source("phantom", "outline_sha256")


def none(spec: SimulationSpec) -> Inputs | None:
    return {}


def of_mesh(spec: SimulationSpec) -> Inputs | None:
    """Breasts of one outline (with and without lesions, of another seed) share their mesh."""
    if spec.phantom.compressed:
        return None
    return {"phantom": GROWN if mesh.reads_tissues(spec.mesh) else OUTLINE}


def of_compression(spec: SimulationSpec) -> Inputs | None:
    """Breasts of one mesh share their compression where the law is the same all over the breast."""
    if spec.phantom.compressed:
        return {"phantom": GROWN}
    return {"phantom": GROWN, "mesh": MESH} if fem.reads_tissues(spec.compression) else {"mesh": MESH}


def of_warp(spec: SimulationSpec) -> Inputs | None:
    return None if spec.phantom.compressed else {"phantom": GROWN, "mesh": MESH, "compression": COMPRESSION}


def of_projection(spec: SimulationSpec) -> Inputs | None:
    return {"phantom": COMPRESSED}


def of_transport(spec: SimulationSpec) -> Inputs | None:
    return {"phantom": COMPRESSED} if spec.physics.kind == "xray" else None


def of_detection(spec: SimulationSpec) -> Inputs | None:
    """Another exposure or noise realisation projects and transports nothing again."""
    if spec.physics.kind != "xray":
        return None
    return {"phantom": COMPRESSED, "primary": Source("projection", "key"), "transport": Source("transport")}


def of_reconstruction(spec: SimulationSpec) -> Inputs | None:
    return {"projections": PROJECTIONS, "compression": COMPRESSION}


def of_export(spec: SimulationSpec) -> Inputs | None:
    return {"projections": PROJECTIONS, "volume": VOLUME, "phantom": COMPRESSED, "compression": COMPRESSION}


def of_mechanics(spec: SimulationSpec) -> Inputs | None:
    return None if spec.phantom.compressed else {"phantom": GROWN, "mesh": MESH, "compression": COMPRESSION}


def of_preview(spec: SimulationSpec) -> Inputs | None:
    return {"phantom": GROWN, "compressed": COMPRESSED, "projections": PROJECTIONS, "volume": VOLUME}
