"""What the bench of the two meshers must see."""

from __future__ import annotations

from bench.meshers import problems

GOOD = {"ratio": 300.0, "min_dihedral_deg": 18.2, "force_N": 231.5, "peer_force_N": 231.6}


def test_promises_kept_and_broken() -> None:
    assert problems(GOOD) == []
    assert ["49" in p for p in problems(GOOD | {"ratio": 49.0})] == [True]
    assert ["angle of 9.5" in p for p in problems(GOOD | {"min_dihedral_deg": 9.5})] == [True]
    assert ["235" in p for p in problems(GOOD | {"force_N": 235.0})] == [True]
