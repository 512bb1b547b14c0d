"""Limits that a case reached are told with its results."""

from __future__ import annotations

from typing import Any

import pytest

from simcore import presets
from simcore.cautions import cautions
from simcore.fem.spec import ElasticPlates

SPEC = presets.get("tiny")


@pytest.mark.parametrize(
    ("stage", "report", "words"),
    [
        ("phantom", {"dropped_pieces": 2}, "2 pieces of the file"),
        ("phantom", {"left_out_ml": {"muscle": 12.345}}, "12.3 ml of muscle"),
        ("warp", {"lesion_objects": {"calcification": {"merged": 3, "lost": 0}}}, "3 objects of calcification touch"),
        ("warp", {"lesion_objects": {"mass": {"merged": 0, "lost": 1}}}, "1 objects of mass lay beside the breast"),
        ("warp", {"holes": 5}, "5 voxels of the compressed breast are air"),
        ("projection", {"truncated": True}, "beyond the detector"),
        ("projection", {"min_pixel_value": 25}, "smallest pixel value is 25, whose rounding is 2 % of the signal"),
        ("projection", {"min_pixel_value": 0}, "rounding is all of it"),
        ("reconstruction", {"clipped_high_voxels": 7}, "7 voxels of the volume are above 0.455 1/mm"),
        ("reconstruction", {"clipped_low_voxels": 4}, "4 voxels of the volume are below -0.2 1/mm"),
    ],
)
def test_a_limit_that_was_reached_is_told(stage: str, report: dict[str, Any], words: str) -> None:
    (sentence,) = cautions(SPEC, {stage: report})
    assert words in sentence


def test_plates_that_the_breast_reaches_beyond_are_told_their_least_size() -> None:
    plates = ElasticPlates(thickness_mm=10.0, depth_mm=60.0, width_mm=300.0)
    spec = SPEC.with_(compression=SPEC.compression.with_(elastic_plates=plates))
    (sentence,) = cautions(spec, {"fem": {"least_plates_mm": [99, 130]}})
    assert sentence.endswith("take compression.elastic_plates.depth_mm = 99 and width_mm = 300")
    assert cautions(spec, {"fem": {}}) == []


def test_a_case_without_limits_has_no_cautions() -> None:
    reports = {
        "warp": {"holes": 0, "lesion_objects": {"mass": {"merged": 0, "lost": 0}}},
        "projection": {"truncated": False, "min_pixel_value": 100},
        "reconstruction": {"clipped_high_voxels": 0, "clipped_low_voxels": 0},
    }
    assert cautions(SPEC, reports) == []


@pytest.mark.parametrize(("value", "least", "helps"), [(65535.0, 99, False), (30000.0, 60, True), (30000.0, 3, False)])
def test_a_larger_open_field_is_advised_only_where_it_suffices(value: float, least: int, helps: bool) -> None:
    detector = SPEC.acquisition.detector.with_(open_field_value=value)
    spec = SPEC.with_(acquisition=SPEC.acquisition.with_(detector=detector))
    (sentence,) = cautions(spec, {"projection": {"min_pixel_value": least}})
    assert ("open_field_value" in sentence) is helps
    assert sentence.endswith("a larger physics.energy_keV")
