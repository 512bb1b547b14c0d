"""Settings that a case has no use for are refused or told, and advice that is followed suffices."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from simcore import estimate, pipeline, presets, unused
from simcore.core.errors import SpecError
from simcore.fem.spec import CompressionSpec
from simcore.mesh.spec import LatticeMesh
from simcore.phantom.upload import registry
from simcore.phantom.upload.reading import Reading
from simcore.phantom.upload.spec import UploadedPhantom
from simcore.spec import SimulationSpec
from simcore.store.store import Store
from tests.support import plates

UPLOADED = UploadedPhantom(
    sha256=64 * "0", shape=(50, 60, 50), spacing_mm=(1.0, 1.0, 1.0), compressed=True, extent_mm=(50.0, 60.0, 50.0)
)


def changed(spec: SimulationSpec, path: str, value: Any) -> SimulationSpec:
    """With one field set, as JSON has it."""
    data = spec.model_dump(mode="json")
    *parents, last = path.split(".")
    place = data
    for name in parents:
        place = place[name]
    place[last] = value
    return SimulationSpec.from_dict(data)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("percent", 30.0), ("thickness_mm", 40.0), ("force_N", 80.0), ("force_limit_N", 80.0), ("gravity", {}),
        ("friction", 0.3), ("chest_wall", "fixed"), ("load_steps", 3), ("elastic_plates", {"thickness_mm": 3.0}),
        ("material", {"kind": "neo_hookean", "youngs_modulus_kPa": 20.0}), ("tolerance", 1e-6),
    ],
)  # fmt: skip
def test_any_compression_of_a_compressed_phantom_is_refused(field: str, value: Any, tmp_path: Path) -> None:
    spec = changed(SimulationSpec(phantom=UPLOADED), f"compression.{field}", value)
    for run in (estimate.check, lambda s: pipeline.run(s, Store(tmp_path, min_free_bytes=0))):
        with pytest.raises(SpecError, match=rf"compression\.{field}.*compressed already.*leave compression out") as no:
            run(spec)
        assert no.value.code == "setting-not-used"
        assert [p["field"] for p in no.value.problems] == [f"compression.{field}"]
    estimate.check(SimulationSpec(phantom=UPLOADED))


def test_a_force_beyond_its_limit_is_refused() -> None:
    spec = changed(changed(presets.get("tiny"), "compression.force_N", 90.0), "compression.force_limit_N", 80.0)
    with pytest.raises(SpecError, match=r"force_limit_N = 80.0: the force to be reached is 90 N"):
        estimate.check(spec)


TINY = presets.get("tiny")
SOFT = {"kind": "neo_hookean", "youngs_modulus_kPa": 10.0}
SETTINGS = [
    (TINY, "compression.plate_edge_mm", 30.0, [("compression.chest_wall", "fixed")]),
    (TINY, "physics.step_voxels", 0.3, [("physics.sampling", "trilinear")]),
    (TINY, "export.oblique_angle_degrees", 60.0, [("export.view", "MLO")]),
    (TINY, "phantom.texture.octaves", 2, [("phantom.texture.amplitude_mm", 1.0)]),
    (
        changed(TINY, "reconstruction.filter", "ramp"), "reconstruction.hann_cutoff", 0.5,
        [("reconstruction.filter", "hann")],
    ),
    (
        changed(TINY, "reconstruction.slice_thickness_filter", False), "reconstruction.slice_cutoff", 0.5,
        [("reconstruction.slice_thickness_filter", True)],
    ),
    (
        changed(TINY, "reconstruction", {"kind": "sirt"}), "reconstruction.total_variation_steps", 5,
        [("reconstruction.total_variation", 1e-4)],
    ),
    (
        changed(TINY, "phantom.lesions", [{"kind": "mass"}]), "phantom.lesions", [{"kind": "mass", "lobes": 3}],
        [("phantom.lesions", [{"kind": "mass", "lobes": 3, "lobulation": 0.2}])],
    ),
    (
        changed(TINY, "compression.material", {"kind": "by_tissue", "adipose": SOFT, "gland": SOFT}),
        "compression.material.mass", SOFT, [("phantom.lesions", [{"kind": "mass"}])],
    ),
    (SimulationSpec(phantom=UPLOADED), "seed", 5, []),
    (SimulationSpec(phantom=UPLOADED), "mesh", {"kind": "lattice"}, []),
    (SimulationSpec(phantom=UPLOADED), "warp.skirt_mm", 2.0, []),
]  # fmt: skip


@pytest.mark.parametrize(("spec", "field", "value", "uses"), SETTINGS, ids=[s[1] for s in SETTINGS])
def test_what_changes_nothing_is_told(spec: SimulationSpec, field: str, value: Any, uses: list) -> None:
    assert unused.remarks(spec) == []
    without_use = changed(spec, field, value)
    (remark,) = estimate.estimate(without_use).remarks
    assert remark.startswith(field.split(".")[0])
    assert " is not used: " in remark
    for path, other in uses:
        without_use = changed(without_use, path, other)
        assert unused.remarks(without_use) == []


@pytest.mark.parametrize("name", presets.names())
def test_presets_set_nothing_that_is_not_used(name: str) -> None:
    assert unused.remarks(presets.get(name)) == []


def test_a_thickness_that_cannot_be_is_refused_at_once() -> None:
    body = UPLOADED.with_(compressed=False)
    spec = SimulationSpec(phantom=body, mesh=LatticeMesh())
    for thickness, words in ((51.0, "50.0 mm thick before it is compressed"), (20.0, "allows no less than 25.0 mm")):
        with pytest.raises(SpecError, match=rf"compression\.thickness_mm = {thickness:g}: .*{words}"):
            estimate.check(spec.with_(compression=CompressionSpec(thickness_mm=thickness)))
    estimate.check(spec.with_(compression=CompressionSpec(thickness_mm=30.0)))
    with pytest.raises(SpecError, match=r"phantom\.thickness_mm = 40: the tissue is 50 mm high"):
        estimate.check(SimulationSpec(phantom=UPLOADED.with_(thickness_mm=40.0)))
    needs = [
        estimate.compressed_extent(SimulationSpec(phantom=UPLOADED.with_(thickness_mm=t)))[2] for t in (None, 55.0)
    ]
    assert needs == [50.0, 55.0]


def test_muscle_that_no_value_is_cannot_hold_the_breast() -> None:
    body = UPLOADED.with_(compressed=False, tissues="openvct")
    fixed = CompressionSpec(chest_wall="fixed_muscle", percent=20.0)
    with pytest.raises(SpecError, match=r"chest_wall = fixed_muscle: no value of phantom\.tissues is muscle"):
        estimate.check(SimulationSpec(phantom=body, compression=fixed))
    estimate.check(SimulationSpec(phantom=body.with_(tissues="victre"), compression=fixed))


def test_plates_that_bend_are_as_large_as_the_breast() -> None:
    small = changed(TINY, "compression.elastic_plates", {"thickness_mm": 3.0, "depth_mm": 20.0, "width_mm": 30.0})
    for name in ("depth_mm", "width_mm"):
        with pytest.raises(SpecError, match=rf"elastic_plates\.{name} = .*beyond the plates: at least \d+") as refused:
            estimate.check(small)
        least = float(str(refused.value).rpartition(" ")[2])
        small = changed(small, f"compression.elastic_plates.{name}", least)
    estimate.check(small)


def followed(spec: SimulationSpec) -> SimulationSpec:
    """With every detector that is advised."""
    for name in ("pixels_x", "pixels_y"):
        spec = changed(spec, f"acquisition.detector.{name}", 16)
    for _ in range(3):
        try:
            estimate.check(spec)
        except SpecError as error:
            field = error.problems[0]["field"]
            (pixels,) = re.findall(r"take at least (\d+) pixels", str(error))
            spec = changed(spec, field, int(pixels))
    estimate.check(spec)
    return spec


@pytest.mark.parametrize("case", ["grown", "compressed", "fixed", "stiff", "turned"])
def test_a_detector_that_is_advised_suffices(case: str, tmp_path: Path) -> None:
    store = Store(tmp_path / "store", min_free_bytes=0)
    spec = changed(TINY, "mesh", {"kind": "lattice", "edge_length_mm": 16.0})
    spec = changed(spec, "acquisition.detector.pixel_mm", 2.0)
    if case == "compressed":  # a block of muscle that is as wide at the plates as in the middle
        path = tmp_path / "block.nrrd"
        path.write_bytes(plates.nrrd(plates.compressed()))
        upload = registry.add_file(store, path, Reading(compressed=True))
        spec = spec.with_(phantom=upload.spec, compression=CompressionSpec(), mesh=SimulationSpec().mesh)
    elif case == "fixed":
        spec = changed(changed(spec, "compression.chest_wall", "fixed"), "compression.percent", 20.0)
    elif case == "stiff":
        spec = changed(spec, "compression.material.poissons_ratio", 0.49)
        spec = changed(spec, "compression.percent", 60.0)
    elif case == "turned":
        spec = changed(spec, "acquisition.angular_range_degrees", 60.0)
    result = pipeline.run(followed(spec), store)
    assert result.manifest["results"]["truncated"] is False
