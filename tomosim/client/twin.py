"""``python -m tomosim.client.twin``: writes ``sync_client.py`` from ``async_client.py``, so that they never differ."""

from __future__ import annotations

import re
from pathlib import Path

SOURCE = Path(__file__).with_name("async_client.py")
TARGET = Path(__file__).with_name("sync_client.py")

HEAD = '''"""The client for programs that wait.

Made from ``async_client.py`` by ``python -m tomosim.client.twin``: change that one.
"""
'''

REPLACEMENTS = (
    (r'\A""".*?"""\n', HEAD.replace("\\", r"\\")),
    (r"import anyio\n", ""),
    (
        r"from collections\.abc import AsyncIterator, Callable, Mapping, Sequence",
        "from collections.abc import Callable, Iterator, Mapping, Sequence",
    ),
    (r"from __future__ import annotations\n\n", "from __future__ import annotations\n\nimport time\n"),
    (r"await anyio\.sleep", "time.sleep"),
    (r"await run_in_thread\(([\w.]+), ", r"\1("),
    (r", run_in_thread\b", ""),
    (r"\(await (self\.\w+\([^\n]*\))\)\.", r"\1."),
    (r"\bawait ", ""),
    (r"\basync (def|with|for)\b", r"\1"),
    (r"\basynccontextmanager\b", "contextmanager"),
    (r"\bAsync(Client|Iterator|BaseTransport)\b", r"\1"),
    (r"\bAsyncBaseTransport\b", "BaseTransport"),
    (r"\b__a(enter|exit)__\b", r"__\1__"),
    (r"\baclose\(", "close("),
    (r"\ba(iter_lines|iter_bytes|read)\b", r"\1"),
    (r"for item in found\.items:\n +yield item", "yield from found.items"),
    (r"\basync_chunks_of\b", "chunks_of"),
)


def twin(text: str) -> str:
    """The source of the client that waits."""
    for pattern, replacement in REPLACEMENTS:
        text = re.sub(pattern, replacement, text, flags=re.DOTALL if pattern.startswith(r"\A") else 0)
    return text


if __name__ == "__main__":
    TARGET.write_text(twin(SOURCE.read_text()))
