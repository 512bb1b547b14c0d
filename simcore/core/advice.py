"""Advice in error messages: only what is not in force already, joined to a phrase."""

from __future__ import annotations


def one_of(*remedies: str | None) -> str:
    """ "a, b or c"; what does not apply is None and left out.

    raises: ValueError where nothing is left: an error must say what to change.
    """
    left = list(dict.fromkeys(r for r in remedies if r is not None))
    if not left:
        raise ValueError("an error without a remedy")
    return left[0] if len(left) == 1 else f"{', '.join(left[:-1])} or {left[-1]}"


def where(helps: bool, remedy: str) -> str | None:
    """The remedy, None where it would not help or is in force."""
    return remedy if helps else None
