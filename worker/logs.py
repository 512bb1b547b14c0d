"""Structured logs: one JSON object a line on standard error.

``context`` adds fields to every line that is written inside of it, in this thread or task and those it starts:
request, simulation, attempt, stage.
"""

from __future__ import annotations

import json
import logging
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

_STANDARD = set(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName", "color_message"}

_fields: ContextVar[Mapping[str, Any]] = ContextVar("tomosim_log_fields", default={})  # noqa: B039 - never changed


@contextmanager
def context(**fields: Any) -> Iterator[None]:
    """Adds fields to the lines that are written meanwhile; None leaves one out."""
    token = _fields.set({**_fields.get(), **fields})
    try:
        yield
    finally:
        _fields.reset(token)


def add(**fields: Any) -> None:
    """Adds fields to the lines that are written from now on, until the ``context`` around this ends."""
    _fields.set({**_fields.get(), **fields})


def field(name: str) -> Any:
    """A field of the context; None where it has none."""
    return _fields.get().get(name)


class JsonFormatter(logging.Formatter):
    """time, level, logger, message, the fields of the context, and whatever was given as ``extra``."""

    def format(self, record: logging.LogRecord) -> str:
        stamp = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created))
        content = {
            "time": f"{stamp}.{int(record.msecs):03d}Z",
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
            **{key: value for key, value in _fields.get().items() if value is not None},
            **{key: value for key, value in vars(record).items() if key not in _STANDARD},
        }
        if record.exc_info:
            content["exception"] = self.formatException(record.exc_info)
        return json.dumps(content, default=str)


def configure(level: str) -> None:
    """Sends all logs of this process to standard error."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonFormatter())
    logging.basicConfig(level=level, handlers=[handler], force=True)
    logging.getLogger("numba").setLevel(logging.WARNING)  # it tells every step of its compiler
