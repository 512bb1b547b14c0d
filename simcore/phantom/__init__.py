"""The breast as labels: ``generate(spec, seed)`` grows the phantom that a specification asks for, ``load(spec, file)``
reads one that was uploaded."""

from __future__ import annotations

from importlib import import_module
from typing import IO

from simcore.core.artifacts import Compression, Phantom
from simcore.core.progress import Progress, silent
from simcore.phantom.spec import AnthropomorphicPhantom
from simcore.phantom.upload.spec import UploadedPhantom

__all__ = ["generate", "load", "plates"]


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
