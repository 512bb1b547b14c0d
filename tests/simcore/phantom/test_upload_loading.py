"""Uploaded phantoms: tissues, axes, frames, the registry in the store, and the whole way to DICOM."""

from __future__ import annotations

import gzip
import io
import itertools
import json
import os
from pathlib import Path

import numpy as np
import pytest

from simcore import estimate, phantom, pipeline
from simcore.core.artifacts import Phantom
from simcore.core.errors import ResourceLimitError, SpecError
from simcore.core.tissues import Tissue
from simcore.fem.spec import CompressionSpec
from simcore.mesh.spec import LatticeMesh
from simcore.phantom.upload import registry, tissue_maps
from simcore.phantom.upload.reading import RawHeader, Reading
from simcore.phantom.upload.spec import UploadedPhantom
from simcore.phantom.upload.wall import Ends
from simcore.presets import get
from simcore.spec import SimulationSpec
from simcore.store.hashing import file_digest
from simcore.store.store import Store
from tests.support import upload_files as files

VOXELS = files.half_breast()
SPACING = (1.0, 0.9, 0.8)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "store", min_free_bytes=0)


def spec(labels: np.ndarray = VOXELS, **fields: object) -> UploadedPhantom:
    return UploadedPhantom(sha256=64 * "0", shape=labels.shape, spacing_mm=SPACING, **fields)


def load(labels: np.ndarray = VOXELS, **fields: object) -> Phantom:
    return phantom.load(spec(labels, **fields), io.BytesIO(files.as_nrrd(labels)))


def test_victre_labels_become_tissues() -> None:
    loaded = load()
    k, j, i = np.nonzero(np.isin(VOXELS, (1, 2, 29, 200)))
    box = VOXELS[k.min() : k.max() + 1, j.min() : j.max() + 1, i.min() : i.max() + 1]
    inner = loaded.labels[1:-1, 1:-1, :-1]
    for value, tissue in ((0, Tissue.AIR), (1, Tissue.ADIPOSE), (2, Tissue.SKIN), (29, Tissue.GLAND)):
        np.testing.assert_array_equal(inner == tissue, box == value)
    np.testing.assert_array_equal(inner == Tissue.MASS, box == 200)
    # One voxel of air on every side but the chest wall.
    shell = loaded.labels.copy()
    shell[1:-1, 1:-1, :-1] = 0
    assert not shell.any()
    assert loaded.labels[:, :, 0].any()
    assert set(tissue_maps.VICTRE) == {0, 1, 2, 29, 33, 40, 50, 88, 95, 125, 150, 200, 225, 250}


def test_an_uncompressed_phantom_stands_in_the_breast_frame() -> None:
    grid = load().grid
    assert grid.spacing == (0.8, 0.9, 1.0)
    assert grid.corner[0] == 0.0
    assert grid.corner[1] == -grid.upper[1]
    assert grid.corner[2] == -grid.upper[2]
    assert grid.size == load().labels.size


def test_a_compressed_phantom_stands_on_the_support() -> None:
    loaded = load(compressed=True)
    assert loaded.grid.corner[0] == loaded.grid.corner[2] == 0.0
    assert loaded.grid.corner[1] == pytest.approx(-loaded.grid.upper[1])
    for side in (loaded.labels[0], loaded.labels[-1], loaded.labels[:, 0], loaded.labels[:, -1]):
        assert side.any()
    plates = phantom.plates(spec(compressed=True, force_N=110.0), loaded)
    assert plates.thickness == loaded.grid.upper[2]
    assert plates.force_N == 110.0
    thick = spec(compressed=True, thickness_mm=loaded.grid.upper[2] + 5.0)
    assert phantom.plates(thick, loaded).thickness == loaded.grid.upper[2] + 5.0
    assert phantom.plates(thick, loaded).force_N is None
    with pytest.raises(SpecError, match=r"phantom\.thickness_mm = 3\.0: the tissue is \d+ mm high"):
        load(compressed=True, thickness_mm=3.0)


ORDERS = [(order, signs) for order in itertools.permutations("zyx") for signs in ("+++", "-+-", "--+")]


@pytest.mark.parametrize(("order", "signs"), ORDERS)
def test_any_order_and_direction_of_the_axes_gives_the_same_phantom(order: tuple[str, ...], signs: str) -> None:
    expected = phantom.load(spec(), io.BytesIO(files.as_nrrd(VOXELS)))
    turned = VOXELS.transpose(["zyx".index(name) for name in order])
    turned = np.ascontiguousarray(turned[tuple(slice(None, None, 1 if s == "+" else -1) for s in signs)])
    upload = UploadedPhantom(
        sha256=64 * "0",
        shape=turned.shape,
        spacing_mm=tuple(SPACING["zyx".index(name)] for name in order),
        axes=tuple(s + name for s, name in zip(signs, order, strict=True)),
    )
    loaded = phantom.load(upload, io.BytesIO(files.as_nrrd(turned)))
    np.testing.assert_array_equal(loaded.labels, expected.labels)
    assert loaded.grid == expected.grid
    assert loaded.labels.flags.c_contiguous


@pytest.mark.parametrize(
    ("axes", "remedy"),
    [
        (
            ("+z", "+y", "-x"),
            "turn x, and y with it so that the breast is not mirrored: axes = +z,-y,+x",
        ),  # the nipple first
        (("+x", "+y", "+z"), "permute the axes, none mirrored: axes = +z,-y,+x"),  # the thin lower side
        (("-z", "+x", "-y"), "permute the axes, none mirrored: axes = -z,+y,+x"),
    ],
)
def test_a_breast_the_wrong_way_round_is_refused_with_axes_that_do(axes: tuple[str, str, str], remedy: str) -> None:
    with pytest.raises(SpecError, match=r"phantom\.axes = .*first must be a flat chest wall") as refused:
        load(axes=axes)
    assert remedy in str(refused.value)
    load(axes=tuple(remedy.rpartition(" ")[2].split(",")))


@pytest.mark.parametrize(
    ("areas", "forward", "backward"),
    [
        ((20, 100, 5), True, False),
        ((19, 100, 5), False, False),
        ((30, 100, 40), False, True),
        ((50, 50, 50), True, True),
    ],
)
def test_a_wall_is_a_fifth_of_the_largest_plane_and_no_less_than_the_other_end(
    areas: tuple[int, int, int], forward: bool, backward: bool
) -> None:
    ends = Ends(*areas)
    assert (ends.is_wall("+"), ends.is_wall("-")) == (forward, backward)


def test_a_tissue_map_of_ones_own_and_unknown_values_by_name() -> None:
    labels = VOXELS.astype("<u2")
    labels[VOXELS == 29], labels[VOXELS == 200] = 7000, 3
    own = {"0": "air", "50": "air", "1": "adipose", "2": "skin", "7000": "gland", "3": "muscle"}
    loaded = load(labels, tissues=own)
    assert np.count_nonzero(loaded.labels == Tissue.GLAND) == np.count_nonzero(labels == 7000)
    assert np.count_nonzero(loaded.labels == Tissue.MUSCLE) == np.count_nonzero(labels == 3)
    with pytest.raises(SpecError, match=r"names no tissue for 3, 7000; .*adipose.*victre, tomosim"):
        load(labels)
    negative = VOXELS.astype("i2")
    negative[0, 0, 0] = -1
    with pytest.raises(
        SpecError, match="names no tissue for -1, and none can: labels are whole numbers from 0 to 65535"
    ):
        load(negative)
    own_labels = load().labels
    again = load(np.ascontiguousarray(own_labels), tissues="tomosim")
    np.testing.assert_array_equal(again.labels, own_labels)


def test_shape_and_content_must_be_those_of_the_specification() -> None:
    with pytest.raises(SpecError, match=r"phantom\.shape = \[1, 2, 3\]: the file has \["):
        phantom.load(spec().with_(shape=(1, 2, 3)), io.BytesIO(files.as_nrrd(VOXELS)))
    with pytest.raises(SpecError, match="nothing but air"):
        load(np.zeros((4, 5, 6), "u1"))


def test_the_report_counts_what_is_there() -> None:
    report = load().report
    voxel_ml = 0.8 * 0.9 * 1e-3
    assert report["tissue_ml"]["gland"] == pytest.approx(np.count_nonzero(VOXELS == 29) * voxel_ml)
    inner = np.count_nonzero(np.isin(VOXELS, (1, 29, 200)))
    assert report["glandularity"] == pytest.approx(np.count_nonzero(VOXELS == 29) / inner)
    assert report["volume_ml"] == pytest.approx(np.count_nonzero(np.isin(VOXELS, (1, 2, 29, 200))) * voxel_ml)


def added(store: Store, tmp_path: Path, name: str = "breast.nrrd", data: bytes | None = None,
          reading: Reading | None = None) -> registry.Upload:  # fmt: skip
    path = tmp_path / name
    path.write_bytes(data or files.as_nrrd(VOXELS, spacing=SPACING))
    return registry.add_file(store, path, (reading or Reading()).with_(confirm_size=True))  # 10 ml


def test_an_added_file_is_an_object_with_a_note_and_a_specification(store: Store, tmp_path: Path) -> None:
    upload = added(store, tmp_path)
    assert upload.sha256 == file_digest(tmp_path / "breast.nrrd")
    assert store.path(upload.ref).read_bytes() == (tmp_path / "breast.nrrd").read_bytes()
    assert registry.get(store, upload.sha256) == upload
    assert registry.uploads(store) == [upload]
    assert upload.values == {str(v): int(n) for v, n in zip(*np.unique(VOXELS, return_counts=True), strict=True)}
    part = upload.spec
    assert (part.shape, part.spacing_mm, part.axes) == (VOXELS.shape, SPACING, ("+z", "+y", "+x"))
    with registry.open_file(store, part) as file:
        loaded = phantom.load(part, file)
    nz, ny, nx = loaded.labels.shape
    assert part.extent_mm == pytest.approx(((nx - 1) * 0.8, (ny - 2) * 0.9, (nz - 2) * 1.0))
    assert not list((store.root / "tmp").iterdir())
    assert added(store, tmp_path).sha256 == upload.sha256  # twice is once
    # The note stays, the file is gone: not there.
    os.chmod(store.path(upload.ref), 0o644)
    store.path(upload.ref).unlink()
    assert registry.uploads(store) == []


def test_files_that_are_of_no_use_leave_nothing_behind(store: Store, tmp_path: Path) -> None:
    strange = files.as_nrrd(np.full((3, 3, 3), 77, "u1"))
    for data, said in ((strange, "no tissue for 77"), (strange[:-5], "cut short|unpacked"), (b"x", "no NRRD")):
        with pytest.raises(SpecError, match=said):
            added(store, tmp_path, data=data)
    with pytest.raises(SpecError, match="no voxel size: give spacing_mm"):
        added(store, tmp_path, data=files.as_nrrd(VOXELS, without="spacings"))
    with pytest.raises(SpecError, match=r"1 x 1 x 100 mm; from 0\.01 to 10 mm"):
        added(store, tmp_path, data=files.as_nrrd(VOXELS, spacing=(100.0, 1.0, 1.0)))
    with pytest.raises(SpecError, match="cannot be read: No such file"):
        registry.add_file(store, tmp_path / "nothing.nrrd")
    assert registry.uploads(store) == []
    assert not [p for p in (store.root / "objects").rglob("*") if p.is_file()]
    assert not list((store.root / "tmp").iterdir())


def test_what_the_file_does_not_say_can_be_said(store: Store, tmp_path: Path) -> None:
    reading = Reading(spacing_mm=SPACING, axes=("-z", "+y", "+x"), compressed=True)
    upload = added(store, tmp_path, data=files.as_nrrd(VOXELS, without="spacings"), reading=reading)
    assert (upload.spec.spacing_mm, upload.spec.axes, upload.spec.compressed) == (SPACING, ("-z", "+y", "+x"), True)
    raw = Reading(raw=RawHeader(shape=VOXELS.shape, spacing_mm=SPACING, axes=("+z", "-y", "+x")))
    upload = added(store, tmp_path, "p_1.raw.gz", gzip.compress(VOXELS.tobytes()), raw)
    assert (upload.name, upload.format, upload.spec.axes) == ("p_1.raw.gz", "nrrd", ("+z", "-y", "+x"))
    (tmp_path / "b.raw").write_bytes(VOXELS.tobytes())
    header = files.as_metaimage(VOXELS, spacing=SPACING, packed=False, data_file="b.raw")
    upload = added(store, tmp_path, "b.mhd", header)
    assert (upload.spec.shape, upload.spec.spacing_mm) == (VOXELS.shape, SPACING)


def case(upload: registry.Upload, **fields: object) -> SimulationSpec:
    tiny = get("tiny")
    part = upload.spec.with_(**fields)
    if part.compressed:
        return tiny.with_(phantom=part, compression=CompressionSpec())
    return tiny.with_(phantom=part, mesh=LatticeMesh(edge_length_mm=16.0))


def test_an_uploaded_phantom_goes_the_whole_way(store: Store, tmp_path: Path) -> None:
    upload = added(store, tmp_path)
    spec = case(upload)
    # Over JSON, as it is posted.
    spec = SimulationSpec.parse(spec.model_dump_json())
    result = pipeline.run(spec, store)
    results = result.manifest["results"]
    assert results["tissue_after_ml"]["mass"] == pytest.approx(results["tissue_before_ml"]["mass"], rel=0.1)
    assert results["thickness_mm"] == pytest.approx(0.7 * results["uncompressed_thickness_mm"], rel=1e-3)
    assert results["force_N"] > 0
    assert any(name.endswith(".dcm") for name in result.files)
    assert [s["name"] for s in result.manifest["stages"]] == list(pipeline.stages_of(spec))
    # Another seed does not read the phantom again.
    again = pipeline.run(spec.with_(seed=5), store)
    assert again.manifest["stages"][0]["cached"]


def test_a_compressed_phantom_is_projected_as_it_is(store: Store, tmp_path: Path) -> None:
    upload = added(store, tmp_path, reading=Reading(compressed=True))
    messages: list[tuple[str, str]] = []
    result = pipeline.run(
        case(upload), store, lambda stage, fraction, message, cached=False: messages.append((stage, message))
    )
    stages = {s["name"]: s for s in result.manifest["stages"]}
    left_out = {"mesh", "warp", "mechanics", "transport", "detection"}
    assert set(pipeline.STAGES) - set(stages) == left_out
    assert {stage for stage, message in messages if message == "not needed"} == left_out
    assert list(dict.fromkeys(stage for stage, _ in messages)) == list(pipeline.STAGES)
    results = result.manifest["results"]
    assert "force_N" not in results
    assert results["thickness_mm"] == upload.spec.extent_mm[2]
    assert any(name.endswith(".dcm") for name in result.files)
    json.dumps(result.manifest)
    known = pipeline.run(case(upload, force_N=80.0), store)
    assert known.manifest["results"]["force_N"] == 80.0
    assert {s["name"] for s in known.manifest["stages"] if s["cached"]} >= {"phantom", "projection"}


def test_a_phantom_that_was_never_added_is_refused(store: Store, tmp_path: Path) -> None:
    upload = added(store, tmp_path)
    with pytest.raises(SpecError, match=r"phantom\.sha256 = 0{64}: there is no such file here: .*phantom add"):
        pipeline.run(case(upload, sha256=64 * "0"), store)
    with pytest.raises(SpecError, match=r"phantom\.shape = \[9, 9, 9\]: the file has"):
        pipeline.run(case(upload, shape=(9, 9, 9)), store)


def test_needs_are_predicted_from_the_specification_alone(store: Store, tmp_path: Path) -> None:
    upload = added(store, tmp_path)
    needs = estimate.check(case(upload))
    assert needs.voxels == VOXELS.size
    assert estimate.check(case(upload, compressed=True)).seconds < needs.seconds
    large = case(upload, shape=(4000, 4000, 4000), extent_mm=None, spacing_mm=(0.02, 0.02, 0.02))
    with pytest.raises(ResourceLimitError, match=r"phantom\.shape = \[4000, 4000, 4000\] and 5 views needs \d\d\d"):
        estimate.check(large, memory_limit_bytes=8_000_000_000)
    wide = case(upload, extent_mm=(500.0, 100.0, 60.0))
    with pytest.raises(SpecError, match=r"acquisition\.detector\.pixels_x"):
        estimate.check(wide)
