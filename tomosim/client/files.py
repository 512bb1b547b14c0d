"""Files on this side: what is there already, where a download goes on, whether it arrived whole."""

from __future__ import annotations

import hashlib
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

import httpx

from tomosim.client.common import run_in_thread
from tomosim.client.errors import DigestError, ServiceError

CHUNK_BYTES = 1 << 20


@dataclass(frozen=True)
class Downloaded:
    """A file of a case on this side. size: [byte]. kept: whether it was there before, with the same content."""

    name: str
    path: Path
    size: int
    kept: bool = False


def target_of(folder: Path, name: str) -> Path:
    """Where the file ``name`` of a case goes below ``folder``. raises: ServiceError where that is outside of it"""
    target = folder / name
    if not target.resolve().is_relative_to(folder.resolve()) or target.resolve() == folder.resolve():
        raise ServiceError(f"the service names a file {name!r}, which would lie outside of {folder}", code="bad-name")
    return target


def is_there(target: Path, size: int, sha256: str) -> bool:
    """Whether a file is there with this content."""
    return target.is_file() and target.stat().st_size == size and _digest(target) == sha256


def _digest(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class Partial:
    """A file that arrives: ``<name>.partial`` until it is whole. A context manager.

    What an earlier download left is gone on with (``headers``), unless the service sends all of it anyway.
    """

    def __init__(self, target: Path, sha256: str) -> None:
        self.target = target
        self.sha256 = sha256
        self.path = target.with_name(target.name + ".partial")
        self._hash = hashlib.sha256()
        self._received = 0
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._file = open(self.path, "a+b")  # noqa: SIM115 - closed by __exit__
        self._file.seek(0)
        while chunk := self._file.read(CHUNK_BYTES):
            self._hash.update(chunk)
            self._received += len(chunk)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._file.close()

    def headers(self) -> dict[str, str]:
        """Asks for what is still missing, or for everything where the content is another one by now."""
        if not self._received:
            return {}
        return {"Range": f"bytes={self._received}-", "If-Range": f'"{self.sha256}"'}

    def begin(self, response: httpx.Response) -> None:
        """Looks at the answer: does it go on, or begin anew?"""
        goes_on = response.status_code == 206 and response.headers.get("content-range", "").startswith(
            f"bytes {self._received}-"
        )
        if not goes_on:
            self.restart()

    def restart(self) -> None:
        """Forgets what was received."""
        self._file.truncate(0)
        self._hash = hashlib.sha256()
        self._received = 0

    def write(self, chunk: bytes) -> None:
        self._file.write(chunk)
        self._hash.update(chunk)
        self._received += len(chunk)

    def finish(self) -> int:
        """Gives the file its name; its size in bytes. raises: DigestError where it is not what was announced"""
        self._file.flush()
        if self._hash.hexdigest() != self.sha256:
            self.path.unlink()
            raise DigestError(f"{self.target.name} arrived with another content than announced; download it again")
        self.path.replace(self.target)
        return self._received


def chunks_of(content: Path | IO[bytes]) -> Iterator[bytes]:
    """The content of a file, piece by piece; an open one from where it stands."""
    if isinstance(content, Path):
        with open(content, "rb") as file:
            yield from chunks_of(file)
        return
    while chunk := content.read(CHUNK_BYTES):
        yield chunk


async def async_chunks_of(content: Path | IO[bytes]) -> AsyncIterator[bytes]:
    """As ``chunks_of``, reading in a thread of its own."""
    chunks = chunks_of(content)
    while chunk := await run_in_thread(next, chunks, b""):
        yield chunk


def size_of(content: Path | IO[bytes]) -> int | None:
    """Bytes that ``chunks_of`` will give; None where that is not known."""
    if isinstance(content, Path):
        return content.stat().st_size
    return None


def name_of(content: Path | IO[bytes]) -> str:
    """What a file is called; empty where it has no name."""
    if isinstance(content, Path):
        return content.name
    name: Any = getattr(content, "name", "")
    return Path(name).name if isinstance(name, str) else ""
