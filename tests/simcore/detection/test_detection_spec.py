"""The specification of a detector: data that are refused where they make no sense, and those of the systems."""

import subprocess
import sys
from importlib import resources

import pydantic
import pytest

from simcore.core.errors import SpecError
from simcore.detection import DetectionSpec, detector_of, systems
from simcore.detection.systems import _rows


def test_there_is_a_detector_of_every_system_with_its_sources():
    assert {"ge-senographe-ds", "ge-pristina", "hologic-dimensions", "siemens-inspiration"} <= set(systems())
    sources = resources.files("simcore.detection.data").joinpath("SOURCES.md").read_text()
    for row in _rows():
        assert f"| {row['source']} |" in sources
        assert row["trust"] in ("2", "1", "c", "m")
    for system in systems():
        spec = detector_of(system)
        assert DetectionSpec.model_validate_json(spec.model_dump_json()) == spec


def test_units_in_the_table_are_those_of_the_specification():
    def unit_of(schema, path):
        for name in path:
            places = [schema, *schema.get("anyOf", []), *schema.get("oneOf", []), *schema.get("allOf", [])]
            places = [defs[p["$ref"].rsplit("/", 1)[1]] if "$ref" in p else p for p in places]
            places += [
                defs[q["$ref"].rsplit("/", 1)[1]]
                for p in places
                for q in p.get("oneOf", []) + p.get("anyOf", [])
                if "$ref" in q
            ]
            schema = next(p["properties"][name] for p in places if name in p.get("properties", {}))
        return schema.get("unit")

    whole = DetectionSpec.model_json_schema()
    defs = whole["$defs"]
    for row in _rows():
        unit = unit_of(whole, row["field"].split("."))
        if unit is not None and not row["field"].startswith("electronic_noise"):
            assert row["unit"] == unit, row


def test_an_unknown_system_is_refused_with_those_there_are():
    with pytest.raises(SpecError, match="no detector of 'philips'; there are those of ge-senographe-ds"):
        detector_of("philips")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"transfer": {"kind": "table", "frequencies_per_mm": [0.0, 1.0], "values": [1.0]}}, "give one for each"),
        ({"transfer": {"kind": "table", "frequencies_per_mm": [1.0, 2.0], "values": [1.0, 0.5]}}, "must begin at 0"),
        ({"transfer": {"kind": "table", "frequencies_per_mm": [0.0, 0.0], "values": [1.0, 0.5]}}, "does not exceed"),
        ({"transfer": {"kind": "table", "frequencies_per_mm": [0.0, 5.0], "values": [0.9, 0.5]}}, "divide all by it"),
        ({"transfer": {"kind": "table", "frequencies_per_mm": [0.0, 5.0], "values": [1.0, 1.1]}}, "does not exceed 1"),
        ({"transfer": {"kind": "table", "frequencies_per_mm": [0.0, 5.0], "values": [1.0, -0.1]}}, "below 0"),
        ({"converter": {"kind": "film"}}, "'csi', 'a-se', 'ideal'"),
        ({"offset_DN": 9000.0}, "leaves less than half"),
        ({"bits": 7}, "greater than or equal to 8"),
        ({"noise": {"kind": "gaussian-correlated", "realisation": -1}}, "greater than or equal to 0"),
    ],
)
def test_what_makes_no_sense_is_refused(data, message):
    with pytest.raises(pydantic.ValidationError, match=message):
        DetectionSpec.model_validate(data)


def test_specifications_and_response_load_nothing_that_is_heavy():
    heavy = ("numba", "scipy", "skimage")
    code = f"import sys, simcore.detection; print(*(m for m in {heavy!r} if m in sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert loaded == []


def test_every_number_has_a_unit_or_says_it_has_none():
    schema = DetectionSpec.model_json_schema()
    for model in [schema, *schema["$defs"].values()]:
        for name, part in model.get("properties", {}).items():
            kinds = [part, *part.get("anyOf", [])]
            if any(k.get("type") in ("number", "integer") for k in kinds):
                assert "[" in part.get("description", ""), name
