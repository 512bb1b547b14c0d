"""Studies: expansion of axes, draws, pairs, and what is refused."""

import json

import numpy as np
import pytest

from simcore.core.errors import SpecError
from simcore.spec import SimulationSpec
from simcore.study import StudySpec
from simcore.study.distributions import Normal
from simcore.study.expansion import columns, expand


def study(*axes, **rest):
    return StudySpec.parse(json.dumps({"axes": axes, **rest}))


def grid(field, *values, **rest):
    return {"kind": "grid", "field": field, "values": values, **rest}


def seeds(count, seed=0, **more):
    return {"kind": "random", "count": count, "seed": seed, "draws": {"seed": {"kind": "integer"}, **more}}


def coordinates(spec):
    return [case.coordinates for case in expand(spec)]


def test_every_combination_the_last_axis_fastest():
    spec = study(grid("compression.percent", 20.0, 50.0), grid("/acquisition/views", 7, 15), name="angles")
    cases = list(expand(spec))
    assert spec.size == len(cases) == 4
    assert columns(spec) == ["compression.percent", "acquisition.views"]
    assert [tuple(case.coordinates.values()) for case in cases] == [(20.0, 7), (20.0, 15), (50.0, 7), (50.0, 15)]
    assert [case.number for case in cases] == [1, 2, 3, 4]
    assert [case.name for case in cases] == ["angles 0001", "angles 0002", "angles 0003", "angles 0004"]
    last = SimulationSpec.from_dict(cases[3].specification)
    assert (last.compression.percent, last.acquisition.views) == (50.0, 15)


def test_the_base_is_what_all_cases_share():
    base = {"seed": 9, "name": "mine", "acquisition": {"views": 5}}
    (case,) = expand(study(grid("acquisition.air_gap_mm", 25.0), base=base))
    assert case.specification["seed"] == 9
    assert case.specification["acquisition"] == {"views": 5, "air_gap_mm": 25.0}
    assert case.name == "mine 0001"
    assert base == {"seed": 9, "name": "mine", "acquisition": {"views": 5}}


def test_fields_of_a_list_change_together():
    points = [
        {"acquisition.views": 7, "acquisition.angular_range_degrees": 20.0},
        {"/acquisition/angular_range_degrees": 40.0, "acquisition.views": 15},
    ]
    spec = study({"kind": "list", "name": "system", "labels": ["narrow", "wide"], "points": points})
    assert coordinates(spec) == [
        {"system": "narrow", "acquisition.views": 7, "acquisition.angular_range_degrees": 20.0},
        {"system": "wide", "acquisition.angular_range_degrees": 40.0, "acquisition.views": 15},
    ]
    wide = SimulationSpec.from_dict(list(expand(spec))[1].specification).acquisition
    assert (wide.views, wide.angular_range_degrees) == (15, 40.0)


def test_a_list_or_object_stands_under_its_label():
    spec = study(grid("phantom.lesions", [], [{"kind": "mass"}], name="lesion", labels=["none", "mass"]))
    assert coordinates(spec) == [{"lesion": "none"}, {"lesion": "mass"}]
    assert coordinates(study(grid("phantom.lesions", []))) == [{"phantom.lesions": []}]


def test_a_missing_object_gets_the_kind_that_is_its_default():
    axes = study(grid("mesh.edge_length_mm", 8.0), grid("phantom.compartments.count", 100))
    (case,) = expand(axes)
    assert case.specification["mesh"] == {"kind": "tetwild", "edge_length_mm": 8.0}
    spec = SimulationSpec.from_dict(case.specification)
    assert (spec.mesh.edge_length_mm, spec.phantom.compartments.count) == (8.0, 100)
    (case,) = expand(study(grid("mesh.edge_length_mm", 8.0), base={"reproducible": True}))
    assert SimulationSpec.from_dict(case.specification).mesh.kind == "lattice"


def test_an_entry_of_a_list_in_the_base():
    base = {"phantom": {"lesions": [{"kind": "mass"}, {"kind": "mass"}]}}
    (case,) = expand(study(grid("phantom.lesions.1.lobes", 5), base=base))
    assert [lesion.lobes for lesion in SimulationSpec.from_dict(case.specification).phantom.lesions] == [8, 5]


class TestDraws:
    def test_the_same_seed_gives_the_same_cases(self):
        assert coordinates(study(seeds(5))) == coordinates(study(seeds(5)))
        assert coordinates(study(seeds(5))) != coordinates(study(seeds(5, seed=1)))

    def test_more_cases_and_other_fields_leave_draws_as_they_are(self):
        few = [c["seed"] for c in coordinates(study(seeds(3)))]
        more = coordinates(study(seeds(6, **{"phantom.glandularity": {"kind": "uniform", "low": 0.1, "high": 0.4}})))
        assert [c["seed"] for c in more][:3] == few
        assert len({c["seed"] for c in more}) == 6

    @pytest.mark.parametrize(
        "distribution",
        [
            {"kind": "uniform", "low": 0.1, "high": 0.4},
            {"kind": "log_uniform", "low": 0.1, "high": 0.4},
            {"kind": "normal", "low": 0.1, "high": 0.4, "mean": 0.2, "standard_deviation": 0.3},
            {"kind": "choice", "values": [0.1, 0.25, 0.4]},
        ],
        ids=lambda d: d["kind"],
    )
    def test_values_lie_where_they_should(self, distribution):
        spec = study({"kind": "random", "count": 400, "draws": {"phantom.glandularity": distribution}})
        values = [c["phantom.glandularity"] for c in coordinates(spec)]
        assert all(0.1 <= v <= 0.4 for v in values)
        assert min(values) < 0.15
        assert max(values) > 0.35
        # Of the distributions themselves: 0.25, 0.3 / ln 4 = 0.216, a cut normal 0.246, 0.25; standard error 0.005.
        assert sum(values) / 400 == pytest.approx(0.216 if distribution["kind"] == "log_uniform" else 0.25, abs=0.02)

    def test_whole_numbers_reach_both_bounds(self):
        draws = {"seed": {"kind": "integer", "low": 3, "high": 5}}
        values = [c["seed"] for c in coordinates(study({"kind": "random", "count": 100, "draws": draws}))]
        assert set(values) == {3, 4, 5}


def test_a_pair_differs_in_its_lesions_alone():
    spec = study(seeds(2), {"kind": "lesion_pair", "lesions": [{"kind": "mass"}]})
    absent, present, *others = (SimulationSpec.from_dict(case.specification) for case in expand(spec))
    assert coordinates(spec)[0]["lesions"] == "absent"
    assert coordinates(spec)[1]["lesions"] == "present"
    assert [lesion.kind for lesion in present.phantom.lesions] == ["mass"]
    assert present.with_(name="", phantom=present.phantom.with_(lesions=())) == absent.with_(name="")
    assert others[0].seed != absent.seed


def test_where_a_value_came_from():
    points = [{"/acquisition/views": 7}]
    spec = study(
        grid("seed", 1, 2),
        {"kind": "list", "points": points},
        seeds(1) | {"draws": {"physics.step_voxels": {"kind": "uniform", "low": 0.1, "high": 0.4}}},
    )
    assert list(expand(spec))[1].sources == {
        "seed": "/axes/0/values/1",
        "acquisition.views": "/axes/1/points/0/~1acquisition~1views",
        "physics.step_voxels": "/axes/2/draws/physics.step_voxels",
    }


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        ([], "at least one"),
        ([grid("seed")], r"axes\.0\.values"),
        ([grid("a b", 1)], r"axes\.0\.field = 'a b'"),
        ([grid("seed", 1), grid("/seed", 2)], r"axes\.1 sets seed, and axes\.0 sets seed"),
        ([grid("phantom.lesions", []), grid("phantom.lesions.0.lobes", 5)], r"axes\.0 sets phantom\.lesions:"),
        ([{"kind": "list", "points": [{"seed": 1}, {"mesh.kind": "lattice"}]}], "points.1 must set the same fields"),
        ([{"kind": "list", "points": [{}]}], "at least one field"),
        ([grid("seed", 1, 2, name="n", labels=["a"])], "1 labels for 2 steps"),
        ([grid("seed", 1, 2, name="n", labels=["a", "a"])], "must differ"),
        ([grid("seed", 1, labels=["a"])], "name and labels go together"),
        ([grid("seed", 1, name="seed", labels=["a"])], "from fields: seed"),
        ([grid("seed", float("nan"))], "NaN"),
        ([seeds("2")], r"axes\.0\.count = '2'"),
        ([seeds(1, **{"phantom.volume_ml": {"kind": "uniform", "low": 2, "high": 1}})], "low = 2 must lie below"),
        ([seeds(1, **{"phantom.volume_ml": {"kind": "log_uniform", "low": 0, "high": 1}})], "must be above 0"),
        ([{"kind": "lesion_pair", "lesions": []}], r"axes\.0\.lesions"),
        ([{"kind": "cube"}], "'grid', 'list', 'random', 'lesion_pair'"),
    ],
)
def test_what_is_no_study(axes, message):
    with pytest.raises(SpecError, match=message) as refused:
        study(*axes)
    assert "Traceback" not in str(refused.value)


@pytest.mark.parametrize(
    ("field", "base", "message"),
    [
        ("seed.low", {"seed": 3}, r"seed\.low cannot be set: what holds it is 3"),
        ("phantom.lesions.3.lobes", {"phantom": {"lesions": [{}]}}, "has 1 entries"),
        ("phantom.lesions.first", {"phantom": {"lesions": [{}]}}, "has 1 entries"),
    ],
)
def test_a_field_that_leads_nowhere(field, base, message):
    with pytest.raises(SpecError, match=message) as refused:
        list(expand(study(grid(field, 1), base=base)))
    assert refused.value.problems[0]["pointer"] == "/axes/0/values/0"


def test_a_normal_distribution_cut_to_a_sliver_is_not_its_mean() -> None:
    """A thousand draws miss an interval of a millionth of the deviation; the mean stood in for all of them."""
    sliver = Normal(low=0.0, high=1e-6, mean=0.0, standard_deviation=1.0)
    random = np.random.default_rng(5)
    drawn = [sliver.draw(random) for _ in range(50)]
    assert len(set(drawn)) == 50
    assert 0.0 <= min(drawn) < max(drawn) <= 1e-6
    assert np.mean(drawn) == pytest.approx(5e-7, abs=1.5e-7)
