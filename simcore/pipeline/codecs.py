"""How the artifacts of stages are stored."""

from __future__ import annotations

from typing import Any

from simcore.core.artifacts import Compression, Phantom, ProjectionStack, TetMesh, TransportResult, Volume
from simcore.pipeline.graph import Codec
from simcore.spec import SimulationSpec
from simcore.store import codecs


def phantom(spec: SimulationSpec) -> Codec[Phantom]:
    return Codec(codecs.save_phantom, codecs.load_phantom)


def mesh(spec: SimulationSpec) -> Codec[TetMesh]:
    return Codec(codecs.save_mesh, codecs.load_mesh)


def compression(spec: SimulationSpec) -> Codec[Compression]:
    return Codec(codecs.save_compression, codecs.load_compression)


def projections(spec: SimulationSpec) -> Codec[Any]:
    if spec.physics.kind == "xray":
        return Codec(codecs.save_primary, codecs.load_primary)
    return Codec(codecs.save_stack, codecs.load_stack)


def transport(spec: SimulationSpec) -> Codec[TransportResult]:
    return Codec(codecs.save_transport, codecs.load_transport)


def detected(spec: SimulationSpec) -> Codec[ProjectionStack]:
    return Codec(codecs.save_stack, codecs.load_stack)


def volume(spec: SimulationSpec) -> Codec[Volume]:
    """Without the voxels where they are made again sooner than read (docs/decisions/0002-what-is-stored.md)."""
    if spec.reconstruction.is_kept:
        return Codec(codecs.save_volume, codecs.load_volume)
    return Codec(codecs.save_volume_facts, None)
