"""What a specification asks for and no library here can do: refused before anything is computed.

Two libraries are not to be had everywhere (docs/install.md): pyjpegls has no wheel for Python 3.14, pytetwild none for
macOS 14 and before.
"""

from __future__ import annotations

import importlib.util
from typing import Any

from simcore.core.errors import SpecError
from simcore.spec import SimulationSpec


def refuse(spec: SimulationSpec) -> None:
    """raises: SpecError (code "library-missing") naming each field that wants a library which is not installed"""
    problems: list[dict[str, Any]] = []
    if spec.export.encoding == "jpeg-ls" and not _is_there("jpeg_ls"):
        problems.append(
            {
                "field": "export.encoding",
                "value": "jpeg-ls",
                "message": "the library pyjpegls is not installed here (there is none for Python 3.14): take 'rle' or "
                "'none', or run it with Python 3.11 to 3.13",
            }
        )
    if spec.mesh.kind == "tetwild" and not spec.phantom.compressed and not _is_there("pytetwild"):
        problems.append(
            {
                "field": "mesh.kind",
                "value": "tetwild",
                "message": "the library pytetwild is not installed here (there is none for macOS 14 and before): take "
                '\'lattice\' ("mesh": {"kind": "lattice"})',
            }
        )
    if problems:
        text = "; ".join(f"{p['field']} = {p['value']!r}: {p['message']}" for p in problems)
        raise SpecError(text, code="library-missing", problems=problems)


def _is_there(module: str) -> bool:
    return importlib.util.find_spec(module) is not None
