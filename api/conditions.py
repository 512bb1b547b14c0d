"""Conditional requests: entity tags (RFC 9110, sections 8.8.3 and 13)."""

from __future__ import annotations

import re

_TAG = re.compile(r'(?:W/)?"([^"]*)"')


def none_match(header: str | None, tag: str) -> bool:
    """Whether If-None-Match names the current entity tag (weak comparison): the answer is then 304.

    tag: the opaque part, without quotes.
    """
    if header is None:
        return False
    return header.strip() == "*" or tag in _TAG.findall(header)
