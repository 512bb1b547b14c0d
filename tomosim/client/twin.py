"""``python -m tomosim.client.twin``: writes what waits (``sync_...``) from what does not, so that they never differ."""

from __future__ import annotations

import re
from pathlib import Path

FOLDER = Path(__file__).parent
HEADS = {
    "client": "The client for programs that wait.",
    "transport": "How the client that waits asks: requests that are tried again, pages, events, files.",
}
"""What the head of each twin says."""

REPLACEMENTS = (
    (r"import anyio\n", ""),
    (r"from collections\.abc import AsyncIterator, Callable", "from collections.abc import Callable, Iterator"),
    (r"from __future__ import annotations\n\n", "from __future__ import annotations\n\nimport time\n"),
    (r"await anyio\.sleep", "time.sleep"),
    (r"await run_in_thread\(([\w.]+), ", r"\1("),
    (r", run_in_thread\b", ""),
    (r"\(await (self\.\w+\([^\n]*\))\)\.", r"\1."),
    (r"\bawait ", ""),
    (r"\basync (def|with|for)\b", r"\1"),
    (r"\basynccontextmanager\b", "contextmanager"),
    (r"\bAsync(Client|Iterator|BaseTransport|Transport)\b", r"\1"),
    (r"\basync_transport\b", "sync_transport"),
    (r"\b__a(enter|exit)__\b", r"__\1__"),
    (r"\baclose\(", "close("),
    (r"\ba(iter_lines|iter_bytes|read)\b", r"\1"),
    (r"for item in batch\.items:\n +yield item", "yield from batch.items"),
    (r"\basync_chunks_of\b", "chunks_of"),
)


def source(name: str) -> Path:
    return FOLDER / f"async_{name}.py"


def target(name: str) -> Path:
    return FOLDER / f"sync_{name}.py"


def twin(name: str) -> str:
    """The source of a module that waits, before ruff sorts its imports and formats it."""
    text = source(name).read_text().split('"""', 2)[2]
    for pattern, replacement in REPLACEMENTS:
        text = re.sub(pattern, replacement, text)
    command = "python -m tomosim.client.twin"
    return f'"""{HEADS[name]}\n\nMade from ``{source(name).name}`` by ``{command}``: change that one.\n"""{text}'


if __name__ == "__main__":
    for name in HEADS:
        target(name).write_text(twin(name))
