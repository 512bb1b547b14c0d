"""Advice: what is in force is left out, and something is always left."""

import pytest

from simcore.core.advice import one_of, where


def test_remedies_are_joined() -> None:
    assert one_of("a") == "a"
    assert one_of("a", where(True, "b")) == "a or b"
    assert one_of(None, "a", where(False, "x"), "b", "a", "c") == "a, b or c"


def test_an_error_without_a_remedy_is_a_mistake() -> None:
    with pytest.raises(ValueError, match="without a remedy"):
        one_of(where(False, "a"))
