"""How the artifacts of stages are stored."""

from __future__ import annotations

from simcore.core import files
from simcore.core.artifacts import Compression, Phantom, ProjectionStack, TetMesh, Volume
from simcore.pipeline.graph import Codec
from simcore.spec import SimulationSpec


def phantom(spec: SimulationSpec) -> Codec[Phantom]:
    return Codec(files.save_phantom, files.load_phantom)


def mesh(spec: SimulationSpec) -> Codec[TetMesh]:
    return Codec(files.save_mesh, files.load_mesh)


def compression(spec: SimulationSpec) -> Codec[Compression]:
    return Codec(files.save_compression, files.load_compression)


def projections(spec: SimulationSpec) -> Codec[ProjectionStack]:
    return Codec(files.save_stack, files.load_stack)


def volume(spec: SimulationSpec) -> Codec[Volume]:
    """Without the voxels where they are made again sooner than read (docs/decisions/0002-what-is-stored.md)."""
    if spec.reconstruction.is_kept:
        return Codec(files.save_volume, files.load_volume)
    return Codec(files.save_volume_facts, None)
