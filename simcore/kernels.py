"""The compiler of the kernels, and the files in which it keeps what it compiled.

numba compares a compiled kernel with the file that it stands in. A kernel is also made of what that file imports:
functions that it calls, constants, laws. Here it is compared with all of them, so that an edit compiles anew what it
changes and nothing else. Kernels import ``njit`` and ``prange`` from here (tests/contracts/test_kernels.py).
"""

from __future__ import annotations

import functools
import hashlib
import re
from pathlib import Path
from typing import Any, Self

from numba import njit, prange
from numba.core import caching

__all__ = ["is_compiled", "njit", "prange", "sources_of"]

_ROOT = Path(__file__).resolve().parent
_IMPORT = re.compile(r"^[ \t]*(?:from[ \t]+([\w.]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n#]*)|import[ \t]+([^\n#]*))", re.M)
_COMMENT = re.compile(r"#[^\n]*")


def sources_of(path: Path) -> frozenset[Path]:
    """The files of this package that names in ``path`` can come from, directly or not, and the file itself.

    A package's ``__init__`` counts where a name is taken from it, not where a module below it is.
    """
    sources: set[Path] = set()
    waiting = {path}
    while waiting:
        source = waiting.pop()
        sources.add(source)
        waiting |= _imported(source) - sources
    return frozenset(sources)


@functools.cache
def _imported(path: Path) -> frozenset[Path]:
    files: set[Path | None] = set()
    for module, names, modules in _IMPORT.findall(path.read_text(encoding="utf-8")):
        for name in _names(modules):
            files.add(_file_of(name))
        for name in _names(names):
            files.add(_file_of(f"{module}.{name}") or _file_of(module))
    return frozenset(file for file in files if file is not None)


def _names(listed: str) -> list[str]:
    """Of "a as b, c"."""
    parts = _COMMENT.sub("", listed).strip("()\n\t ").split(",")
    return [part.split()[0] for part in parts if part.strip()]


@functools.cache
def _file_of(module: str) -> Path | None:
    package, *below = module.split(".")
    if package != _ROOT.name:
        return None
    place = _ROOT.joinpath(*below)
    return next((file for file in (place.with_suffix(".py"), place / "__init__.py") if file.is_file()), None)


@functools.cache
def _stamp(path: Path) -> str:
    """Of all that a kernel in this file may be made of."""
    digest = hashlib.sha256()
    for source in sorted(sources_of(path)):
        digest.update(f"{source.relative_to(_ROOT)}\0".encode() + _digest(source))
    return digest.hexdigest()


@functools.cache
def _digest(path: Path) -> bytes:
    return hashlib.sha256(path.read_bytes()).digest()


class _Locator(caching._CacheLocator):  # type: ignore[misc]
    """Where numba would keep it: NUMBA_CACHE_DIR, beside the sources, or the user's cache folder."""

    def __init__(self, own: Any, path: Path) -> None:
        self._own = own
        self._path = path
        self._py_file = str(path)  # numba's warnings name it

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> Self | None:
        path = Path(py_file).resolve()
        if not path.is_relative_to(_ROOT):
            return None
        for numbas in caching.CacheImpl._locator_classes:
            own = None if numbas is cls else numbas.from_function(py_func, py_file)
            if own is not None:
                return cls(own, path)
        return None

    def get_cache_path(self) -> Any:
        return self._own.get_cache_path()

    def get_source_stamp(self) -> str:
        return _stamp(self._path)

    def get_disambiguator(self) -> Any:
        return self._own.get_disambiguator()


caching.CacheImpl._locator_classes.insert(0, _Locator)


def is_compiled(kernel: Any) -> bool:
    """Whether numba keeps code of this kernel that is made of the sources as they are."""
    return bool(kernel._cache._cache_file._load_index())
