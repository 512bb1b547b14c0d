"""AAPM TG-195 case 3, short form of bench.physics_transport."""

import pytest

from bench.physics_transport.tg195 import CASES, run_case

RAYS = 250_000
ERRORS = 3.0


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.beam} {case.angle}")
def test_energy_in_breast_and_volumes_is_that_of_the_report(case):
    outcome = run_case(case, RAYS)
    assert outcome.tissue_error < 1e-3 * case.tissue
    low, high = case.codes
    assert low - ERRORS * outcome.tissue_error <= outcome.tissue <= high + ERRORS * outcome.tissue_error
    off = abs(outcome.volumes / case.volumes - 1)
    assert (off < 0.025 + ERRORS * outcome.volume_errors / case.volumes).all(), off
    assert abs(outcome.imbalance) < 4 * outcome.imbalance_error + 1e-4
