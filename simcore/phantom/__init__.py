"""The breast as labels: ``generate(spec, seed)`` grows the phantom that a specification asks for, ``load(spec, file)``
reads one that was uploaded."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from importlib import import_module
from typing import IO, TYPE_CHECKING

from simcore.core.progress import Progress, silent
from simcore.phantom.spec import AnthropomorphicPhantom, PhantomSpec
from simcore.phantom.upload.spec import UploadedPhantom

if TYPE_CHECKING:  # whoever reads a specification needs no numerics
    from simcore.core.artifacts import Compression, Phantom
    from simcore.store.store import Store

__all__ = ["build", "generate", "load", "plates", "require", "with_outline"]


def build(spec: PhantomSpec, seed: int, store: Store, progress: Progress = silent) -> Phantom:
    """The phantom that a specification asks for: grown, or read from the store.

    raises: as ``generate`` and ``load``, and where the file was never added to the store.
    """
    if spec.kind == "uploaded":
        from simcore.phantom.upload import registry

        with registry.open_file(store, spec) as file:
            return load(spec, file, progress)
    return generate(spec, seed, progress)


def require(spec: PhantomSpec, store: Store) -> None:
    """raises: SpecError where a file that ``spec`` needs is not in the store, or is another one than it says"""
    if spec.kind == "uploaded":
        from simcore.phantom.upload import registry

        registry.require(store, spec)


def with_outline(phantom: Phantom) -> Phantom:
    """With the digest of what is breast and what is air in its report: all that most meshes depend on."""
    import numpy as np

    from simcore.core.canonical import canonical

    outline = hashlib.sha256(canonical(phantom.grid.to_dict()))
    for layer in phantom.labels:
        outline.update(np.packbits(layer).tobytes())  # air is 0
    return replace(phantom, report={**phantom.report, "outline_sha256": outline.hexdigest()})


def generate(spec: AnthropomorphicPhantom, seed: int, progress: Progress = silent) -> Phantom:
    """Labels (nz, ny, nx) in the breast frame, mm, with a report of what they hold.

    seed: of all random streams, any non-negative integer; the same specification and seed give the same bytes.
    raises: PhantomError where the specification cannot be met; its message says what to change.

    The model of kind ``k`` is the module ``simcore.phantom.k``, loaded when first asked for: whoever only reads
    specifications imports no compiler.
    """
    phantom: Phantom = import_module(f"simcore.phantom.{spec.kind}").generate(spec, seed, progress)
    return phantom


def load(spec: UploadedPhantom, file: IO[bytes], progress: Progress = silent) -> Phantom:
    """The uploaded phantom in an open file: cut to its tissue, in the breast frame, or where it is already compressed
    in the support frame.

    raises: SpecError where the file is not what ``spec`` says, or holds no breast.
    """
    from simcore.phantom.upload.loading import load as read

    return read(spec, file, progress)


def plates(spec: UploadedPhantom, phantom: Phantom) -> Compression:
    """The compression of a phantom that was uploaded compressed: its plates and, where it is known, the force; no
    displacement."""
    from simcore.phantom.upload.loading import plates as around

    return around(spec, phantom)
