"""Specifications: strict, frozen, every number with a unit; bad ones are refused with what is allowed."""

import json
import math
import re
from typing import Annotated, Literal, get_args

import pytest
from pydantic import BaseModel, Field, ValidationError

from simcore import estimate, presets
from simcore.core.errors import ResourceLimitError, SpecError
from simcore.core.spec_base import Spec
from simcore.mesh.spec import LatticeMesh
from simcore.spec import SimulationSpec, spec_error


@pytest.mark.parametrize("name", presets.names())
def test_presets_are_valid_survive_json_and_can_be_simulated(name: str):
    spec = presets.get(name)
    assert SimulationSpec.parse(spec.model_dump_json()) == spec
    assert presets.describe(name)
    needs = estimate.check(spec, memory_limit_bytes=24 << 30)
    assert needs.memory_bytes > 0


def test_the_papers_presets_are_all_there():
    names = presets.names()
    assert {f"paper-cup-{c}-{p}" for c in ("a", "b", "c", "d", "dd") for p in (20, 50)} <= set(names)
    assert {f"paper-cup-c-20-{r}x{v}" for r in (20, 30, 40) for v in (7, 11, 13, 15)} <= set(names)
    assert "paper-cup-c-20-40x30" in names
    case = presets.get("paper-cup-c-20")
    assert (case.phantom.volume_ml, case.compression.percent, case.phantom.voxel_mm) == (700, 20, 0.2)
    assert (case.acquisition.views, case.acquisition.angular_range_degrees) == (15, 40)
    assert (case.acquisition.detector.pixels_y, case.acquisition.detector.pixels_x) == (2304, 1920)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"seed": "1"}, r"seed = '1': .*integer"),
        ({"seed": 1.5}, r"seed = 1\.5"),
        ({"phantom": {"voxel_mm": 0.01}}, r"phantom\.voxel_mm = 0\.01: .*0\.05"),
        ({"acquisition": {"views": 1000}}, r"acquisition\.views = 1000: .*101"),
        ({"phantom": {"voxel": 0.2}}, r"phantom\.voxel = 0\.2: unknown field; valid here: .*voxel_mm"),
        ({"compression": {"percent": True}}, r"compression\.percent = True"),
        ({"physics": {"sampling": "joseph"}}, r"physics\.sampling = 'joseph': .*'exact' or 'trilinear'"),
        (
            {"compression": {"material": {"kind": "neo_hookean", "poissons_ratio": 0.5}}},
            r"poissons_ratio = 0\.5: .*0\.499",
        ),
        ({"phantoms": {}}, "phantoms: unknown field; valid here: acquisition"),
    ],
)
def test_bad_values_are_refused_with_field_value_and_what_is_allowed(change, said):
    with pytest.raises(SpecError, match=said) as caught:
        SimulationSpec.from_dict(change)
    assert caught.value.kind == "user"
    assert len(caught.value.problems) == 1


class Round(Spec):
    kind: Literal["round"] = "round"
    radius: float = Field(1.0, gt=0)


class Square(Spec):
    kind: Literal["square"] = "square"
    edge: float = Field(1.0, gt=0)


class Drawing(Spec):
    shape: Annotated[Round | Square, Field(discriminator="kind")] = Round()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"shape": {"kind": "square", "edge": -1}}', r"shape\.edge = -1: "),
        ('{"shape": {"kind": "round", "edge": 1}}', r"shape\.edge = 1: unknown field; valid here: kind, radius"),
        ('{"shape": {"edge": 1}}', "shape: the field 'kind' is missing; valid kinds: round, square"),
        ('{"shape": {"kind": "oval"}}', r"shape: .*'oval'.*'round', 'square'"),
    ],
)
def test_problems_inside_a_union_have_the_path_the_client_wrote(text: str, said: str):
    with pytest.raises(ValidationError) as caught:
        Drawing.model_validate_json(text)
    assert re.search(said, str(spec_error(Drawing, caught.value)))


def test_problems_inside_a_list_have_the_path_the_client_wrote():
    with pytest.raises(SpecError) as caught:
        SimulationSpec.from_dict(
            {"phantom": {"lesions": [{"kind": "mass"}, {"kind": "mass", "size_mm": [1, "2", 3], "colour": 1}]}}
        )
    fields = {p["field"]: p["message"] for p in caught.value.problems}
    assert set(fields) == {"phantom.lesions.1.size_mm.1", "phantom.lesions.1.colour"}
    assert "lobulation" in fields["phantom.lesions.1.colour"]


def test_a_reproducible_case_has_a_reproducible_mesh():
    assert SimulationSpec.from_dict({}).mesh.kind == "tetwild"
    assert SimulationSpec.from_dict({"reproducible": True}).mesh.kind == "lattice"
    assert SimulationSpec(reproducible=True).mesh.kind == "lattice"
    assert presets.get("paper-cup-c-20").with_(mesh=LatticeMesh()).with_(reproducible=True).mesh.kind == "lattice"
    with pytest.raises(SpecError, match=r"mesh\.kind = 'tetwild' is not reproducible"):
        SimulationSpec.from_dict({"reproducible": True, "mesh": {"kind": "tetwild"}})


def test_all_problems_are_told_at_once():
    with pytest.raises(SpecError, match="3 fields") as caught:
        SimulationSpec.from_dict({"seed": -1, "phantom": {"voxel_mm": "a"}, "x": 1})
    assert len(caught.value.problems) == 3


@pytest.mark.parametrize("text", ["", "{", "[]", "nonsense", '{"seed": NaN}'])
def test_what_is_no_specification_is_refused(text: str):
    with pytest.raises(SpecError, match="not valid"):
        SimulationSpec.parse(text)


def models(annotation) -> list[type[BaseModel]]:
    """The models in an annotation: itself, the members of a union, what a list holds."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in models(part)]


def numbers(model: type[BaseModel], path: str = ""):
    for name, field in model.model_fields.items():
        here = f"{path}.{name}".lstrip(".")
        inner = models(field.annotation)
        for member in inner:
            yield from numbers(member, here)
        if not inner:
            yield here, field


def test_every_field_is_described_and_every_number_has_unit_and_bounds():
    seen = 0
    for path, field in numbers(SimulationSpec):
        if path.endswith("kind"):
            continue
        assert field.description, path
        if field.annotation in (int, float):
            seen += 1
            assert field.description.rstrip().endswith("]"), f"{path} has no unit"
            bounds = {type(m).__name__ for m in field.metadata}
            assert bounds & {"Ge", "Gt"}, f"{path} has no lower bound"
            assert bounds & {"Le", "Lt"}, f"{path} has no upper bound"
    assert seen > 30


def test_json_schema_is_exported():
    schema = SimulationSpec.model_json_schema()
    assert schema["additionalProperties"] is False
    json.dumps(schema)
    voxel = schema["$defs"]["AnthropomorphicPhantom"]["properties"]["voxel_mm"]
    assert (voxel["unit"], voxel["minimum"]) == ("mm", 0.05)


def test_a_specification_is_frozen_and_changed_by_validated_copies():
    spec = SimulationSpec()
    with pytest.raises(ValueError):
        spec.seed = 2
    assert spec.with_(seed=2).seed == 2
    with pytest.raises(ValueError):
        spec.with_(seed=-2)


def changed(path: str, value) -> SimulationSpec:
    data = presets.get("paper-cup-c-20").model_dump()
    *parents, last = path.split(".")
    inner = data
    for p in parents:
        inner = inner[p]
    inner[last] = value
    return SimulationSpec.from_dict(data)


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("acquisition.detector.pixels_y", 1000, r"pixels_y = 1000: .* at least \d+ pixels"),
        ("acquisition.detector.pixels_x", 500, r"pixels_x = 500: .* at least \d+ pixels"),
        ("acquisition.views", 1, r"views = 1: a volume needs at least 2"),
        ("acquisition.angular_range_degrees", 0.0, r"angular_range_degrees = 0: .* more than 0"),
        ("acquisition.air_gap_mm", 300.0, r"pixels_x = 1920: .* at least \d+ pixels"),
    ],
)
def test_impossible_geometries_are_refused_with_needed_and_allowed(path, value, said):
    with pytest.raises(SpecError, match=said):
        estimate.check(changed(path, value))


def test_the_source_must_stay_above_the_breast_and_the_isocenter_below_the_source():
    spec = presets.get("paper-cup-dd-20")
    near = spec.with_(acquisition=spec.acquisition.with_(source_to_detector_mm=200.0))
    with pytest.raises(SpecError, match=r"source_to_detector_mm = 200: the focal spot comes down to 190 mm .* 144 mm"):
        estimate.check(near)
    high = spec.with_(acquisition=spec.acquisition.with_(source_to_detector_mm=300.0, isocenter_height_mm=300.0))
    with pytest.raises(SpecError, match=r"isocenter_height_mm = 300: .* less than source_to_detector_mm = 300"):
        estimate.check(high)


def test_the_predicted_extent_follows_the_target_of_the_compression():
    by_percent = estimate.compressed_extent(changed("compression.percent", 40.0))
    _, _, upper, lower = SimulationSpec().phantom.semi_axes()
    target = {"percent": 75.0, "thickness_mm": 0.6 * (upper + lower)}
    spec = presets.get("paper-cup-c-20")
    to_thickness = estimate.compressed_extent(spec.with_(compression=spec.compression.with_(**target)))
    assert to_thickness == pytest.approx(by_percent)
    to_force = estimate.compressed_extent(spec.with_(compression=spec.compression.with_(percent=40.0, force_N=80.0)))
    assert to_force == pytest.approx((*by_percent[:2], upper + lower))
    tilted = spec.compression.with_(percent=40.0, paddle_angle_degrees=10.0)
    opening = by_percent[0] * math.tan(math.radians(10))
    extent = estimate.compressed_extent(spec.with_(compression=tilted))
    assert extent == pytest.approx((*by_percent[:2], by_percent[2] + opening))


def test_truncation_can_be_allowed():
    spec = changed("acquisition.detector.pixels_y", 1000)
    estimate.check(spec.with_(acquisition=spec.acquisition.with_(truncation="allow")))


def test_too_much_memory_is_refused_with_needed_and_allowed():
    with pytest.raises(ResourceLimitError, match=r"needs \d+\.\d GB of memory; 4\.3 GB are allowed") as caught:
        estimate.check(changed("phantom.voxel_mm", 0.05), memory_limit_bytes=4 << 30)
    assert caught.value.code == "resource-limit"
