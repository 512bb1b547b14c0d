"""What a file holds is told before anything runs: tissues, volumes, doubts, segments, lesions, pieces."""

from __future__ import annotations

import gzip
import io
import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from simcore import phantom
from simcore.core.errors import SpecError
from simcore.core.tissues import Tissue
from simcore.phantom.upload import lesions, registry, segments, tissue_maps
from simcore.phantom.upload.formats import decoding
from simcore.phantom.upload.reading import Reading
from simcore.phantom.upload.spec import UploadedPhantom
from simcore.store.store import Store


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "store", min_free_bytes=0)


def breast() -> NDArray[np.uint8]:
    """VICTRE's labels (z, y, x), voxels of 1.5 mm: half ellipsoid of skin, fat and gland."""
    z, y, x = np.meshgrid(np.arange(-27, 28), np.arange(-31, 32), np.arange(42), indexing="ij")
    radius = np.sqrt((x / 40) ** 2 + (y / 30) ** 2 + (z / 26) ** 2)
    labels = np.where(radius <= 1, 2, 0).astype(np.uint8)
    labels[radius <= 0.94] = 1
    labels[radius <= 0.6] = 29
    return labels


def nrrd(labels: NDArray[np.uint8], more: str = "") -> bytes:
    sizes = " ".join(map(str, reversed(labels.shape)))
    head = f"NRRD0004\ntype: uchar\ndimension: 3\nsizes: {sizes}\nencoding: raw\nspacings: 1.5 1.5 1.5\n{more}\n"
    return head.encode() + labels.tobytes()


def added(
    store: Store, tmp_path: Path, labels: NDArray[np.uint8], more: str = "", **reading: object
) -> registry.Upload:
    path = tmp_path / "labels.seg.nrrd"
    path.write_bytes(nrrd(labels, more))
    return registry.add_file(store, path, Reading(**reading))


def load(labels: NDArray[np.uint8], **fields: object) -> phantom.Phantom:
    spec = UploadedPhantom(sha256=64 * "0", shape=labels.shape, spacing_mm=(1.5, 1.5, 1.5), **fields)
    return phantom.load(spec, io.BytesIO(nrrd(labels)))


def test_values_tissues_volumes_and_shares_are_told(store: Store, tmp_path: Path) -> None:
    labels = breast()
    upload = added(store, tmp_path, labels)
    tissue = np.count_nonzero(labels)
    assert [(e["value"], e["tissue"]) for e in upload.contents] == [
        (0, "air"), (1, "adipose"), (2, "skin"), (29, "gland"),
    ]  # fmt: skip
    for entry in upload.contents:
        voxels = np.count_nonzero(labels == entry["value"])
        assert (entry["voxels"], entry["ml"]) == (voxels, pytest.approx(voxels * 1.5**3 / 1000))
        assert entry["share"] == (pytest.approx(voxels / tissue, abs=1e-6) if entry["value"] else None)
    assert upload.remarks == ()
    assert registry.get(store, upload.sha256) == upload


def test_labels_of_ones_own_that_victre_would_read_as_skin_are_refused(store: Store, tmp_path: Path) -> None:
    labels = breast()
    own = np.where(labels == 29, 2, np.where(labels > 0, 1, 0)).astype(np.uint8)  # 1 fat with the skin, 2 gland
    with pytest.raises(SpecError, match=r"its skin lies inside; as read: .*2 = skin \(\d+") as refused:
        added(store, tmp_path, own)
    assert refused.value.code == "upload-doubtful-tissues"
    assert registry.uploads(store) == []
    upload = added(store, tmp_path, own, tissues={"0": "air", "1": "adipose", "2": "gland"})
    assert upload.remarks == ("no value is skin",)
    confirmed = added(store, tmp_path, own, confirm_tissues=True)
    assert confirmed.remarks[0].startswith("doubtful: only 0% of its surface is skin")


def test_a_map_without_fat_and_gland_is_refused_and_odd_ones_are_told(store: Store, tmp_path: Path) -> None:
    labels = breast()
    with pytest.raises(SpecError, match="it has no fat and no gland"):
        added(store, tmp_path, np.where(labels > 0, 40, 0).astype(np.uint8))
    no_gland = added(store, tmp_path, np.where(labels == 29, 1, labels).astype(np.uint8))
    assert no_gland.remarks == ("doubtful: no value is gland",)
    no_fat = added(store, tmp_path, np.where(labels == 1, 29, labels).astype(np.uint8))
    assert no_fat.remarks == ("doubtful: no value is fat",)
    chalk = added(store, tmp_path, np.where(labels == 29, 250, labels).astype(np.uint8))
    assert any("of the tissue is calcification" in remark for remark in chalk.remarks)


def test_a_patch_of_skin_is_skin(store: Store, tmp_path: Path) -> None:
    labels = breast()
    labels[:, :, :37][labels[:, :, :37] == 2] = 1  # less than a tenth of the surface is left, all of it outside
    assert added(store, tmp_path, labels).remarks == ()


@pytest.mark.parametrize(("value", "name"), [(2, "skin"), (40, "muscle"), (200, "mass")])
def test_a_tissue_that_is_nearly_all_is_told(value: int, name: str, store: Store, tmp_path: Path) -> None:
    labels = breast()
    labels[(labels == 1) | (labels == 29)] = value
    labels[20:30, 25:30, 5:10] = 1
    labels[20:30, 30:35, 5:10] = 29
    (doubt,) = (remark for remark in added(store, tmp_path, labels).remarks if remark.startswith("doubtful"))
    assert doubt.endswith(f"of the tissue is {name}")


SEGMENTS = "Segment0_ID:=a\nSegment0_Name:=Fatty tissue\nSegment0_LabelValue:=1\nSegment0_Layer:=0\n"


def test_names_of_slicer_segments_are_the_tissue_map(store: Store, tmp_path: Path) -> None:
    labels = breast()
    own = np.zeros_like(labels)
    for value, mine in ((1, 1), (29, 2), (2, 3)):
        own[labels == value] = mine
    more = (
        SEGMENTS
        + "Segment1_Name:=Fibroglandular\nSegment1_LabelValue:=2\nSegment2_Name:=Skin_1\nSegment2_LabelValue:=3\n"
    )
    upload = added(store, tmp_path, own, more)
    assert upload.spec.tissues == {"0": "air", "1": "adipose", "2": "gland", "3": "skin"}
    assert upload.remarks == (
        "tissues are taken from the names of the segments: 1 'Fatty tissue' = adipose, 2 'Fibroglandular' = gland, "
        "3 'Skin_1' = skin",
    )
    said = added(store, tmp_path, own, more, tissues="tomosim")  # what is said counts
    assert said.spec.tissues == "tomosim"
    with pytest.raises(SpecError, match=r"2 = 'Segment_1'; give the tissue map \{.*\"2\": \"\?\"") as refused:
        added(store, tmp_path, own, SEGMENTS + "Segment1_Name:=Segment_1\nSegment1_LabelValue:=2\n")
    proposal = str(refused.value)
    proposal = proposal[proposal.index("{") : proposal.index("}") + 1]
    assert json.loads(proposal) == {"0": "air", "1": "adipose", "2": "?"}
    assert segments.names(io.BytesIO(nrrd(labels))) == {}
    long = "# " + 1_200_000 * "x" + "\n"
    for data in (nrrd(own, long + more), gzip.compress(nrrd(own, more)), gzip.compress(nrrd(own, long + more), 1)):
        (tmp_path / "a.seg.nrrd.gz").write_bytes(data)
        packed = registry.add_file(store, tmp_path / "a.seg.nrrd.gz")
        assert (packed.spec.tissues, packed.remarks) == (upload.spec.tissues, upload.remarks)


def test_openvct_by_name(store: Store, tmp_path: Path) -> None:
    labels = breast()
    own = np.zeros_like(labels)
    for value, index in ((1, 3), (29, 4), (2, 2)):
        own[labels == value] = index
    own[20, 30, 5:20] = 1
    upload = added(store, tmp_path, own, tissues="openvct")
    named = {e["value"]: e["tissue"] for e in upload.contents}
    assert named == {0: "air", 1: "ligament", 2: "skin", 3: "adipose", 4: "gland"}
    own[20, 30, 5] = 6
    with pytest.raises(SpecError, match="no tissue for 6"):
        added(store, tmp_path, own, tissues="openvct")
    assert set(tissue_maps.BUILT_IN) == {"victre", "tomosim", "openvct"}


def test_every_mass_and_every_lone_calcification_is_a_lesion(store: Store, tmp_path: Path) -> None:
    labels = breast()
    labels[20:24, 20:26, 8:12] = 200
    labels[30:33, 40:43, 10:13] = 200
    labels[33, 43, 13] = 200  # touches by a corner
    labels[15, 30, 8] = labels[40, 20, 10] = 250
    for j in (30, 32, 35):
        labels[27, j, 20] = 250
    loaded = load(labels)
    truth = {e["id"]: e for e in loaded.truth}
    assert list(truth) == [
        "mass-1", "mass-2", "calcification-1", "cluster-1", "cluster-1/1", "cluster-1/2", "cluster-1/3",
        "calcification-2",
    ]  # fmt: skip
    assert truth["mass-1"]["volume_mm3"] == 4 * 6 * 4 * 1.5**3
    assert truth["mass-1"]["size_mm"] == [6.0, 9.0, 6.0]
    assert truth["mass-2"]["volume_mm3"] == 28 * 1.5**3
    assert truth["cluster-1"]["parts"] == 3
    assert {e["id"] for e in loaded.truth if e.get("part_of") == "cluster-1"} == {f"cluster-1/{k}" for k in (1, 2, 3)}
    for entry in loaded.truth:
        if "parts" not in entry:
            index = np.floor((np.array(entry["centre_mm"]) - loaded.grid.corner) / loaded.grid.spacing).astype(int)
            assert loaded.labels[tuple(index[::-1])] == Tissue[entry["tissue"].upper()]
    upload = added(store, tmp_path, labels)
    assert upload.remarks == ("lesions: 2 masses, 1 cluster of calcifications, 2 single calcifications",)


def test_clusters_are_chains_of_near_calcifications() -> None:
    far, near = lesions.CLUSTER_MM + 0.1, lesions.CLUSTER_MM - 0.1
    line = lambda *steps: np.cumsum([[0.0, 0.0, step] for step in (0.0, *steps)], axis=0)  # noqa: E731
    assert lesions.clusters(line(near, near)) == [[0, 1, 2]]
    assert lesions.clusters(line(near)) == [[0], [1]]
    assert lesions.clusters(line(far, near, near)) == [[0], [1, 2, 3]]
    assert lesions.clusters(np.empty((0, 3))) == []


def test_more_lesions_than_are_followed_are_refused_when_the_file_is_added(store: Store, tmp_path: Path) -> None:
    labels = breast()
    labels[::2, ::2, ::2] = np.where(labels[::2, ::2, ::2] > 0, 250, 0)
    with pytest.raises(SpecError, match=r"\d+ separate pieces of calcification; at most 5000") as refused:
        added(store, tmp_path, labels, confirm_tissues=True)
    assert refused.value.code == "too-many-lesions"
    assert registry.uploads(store) == []


def test_small_pieces_are_left_out_and_told_large_ones_refused(store: Store, tmp_path: Path) -> None:
    labels = np.pad(breast(), ((0, 0), (0, 20), (0, 6)))
    alone = labels.copy()
    labels[2:4, 3:5, 36:38] = 1  # within its box
    np.testing.assert_array_equal(load(labels).labels, load(alone).labels)
    labels[2:4, 3:5, 36:38] = 0
    labels[10:12, 70:73, 40:42] = 1
    upload = added(store, tmp_path, labels)
    assert upload.remarks == ("left out: 1 piece beside the breast, 0.0405 ml in all",)
    loaded = load(labels)
    np.testing.assert_array_equal(loaded.labels, load(alone).labels)
    assert loaded.report["dropped_pieces"] == 1
    assert loaded.report["left_out_ml"] == {"adipose": pytest.approx(12 * 1.5**3 / 1000)}
    assert upload.spec.extent_mm == pytest.approx(tuple(np.array(loaded.labels.shape)[::-1] * 1.5 - (1.5, 3.0, 3.0)))
    assert np.array_equal(load(labels, compressed=True).labels.any(axis=(0, 2))[-3:], [True] * 3)  # all of it is kept
    labels[10:40, 68:80, 0:30] = 1
    with pytest.raises(SpecError, match=r"falls into 3 pieces of \d+, 36.5, 0\.0405 ml; only one"):
        added(store, tmp_path, labels)
    with pytest.raises(SpecError, match="only one connected body"):
        load(labels)


@pytest.mark.parametrize(("axis", "name"), [(0, "z"), (1, "y"), (2, "x")])
def test_a_slice_is_no_breast_to_be_compressed(axis: int, name: str, store: Store, tmp_path: Path) -> None:
    middle = [28, 31, 3]
    one = np.take(breast(), [middle[axis]], axis)
    with pytest.raises(SpecError, match=rf"the tissue is 1 voxel along {name}; .*at least 4 along every axis"):
        added(store, tmp_path, one)  # of 10 ml or so: confirming that would not do


def test_what_is_seen_does_not_depend_on_the_blocks_in_which_a_file_is_read(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    labels = np.pad(breast(), ((2, 3), (0, 20), (0, 6)))
    labels[12:14, 70:73, 40:42] = 1
    labels[22:26, 20:26, 8:12] = 200
    labels[17, 30, 8] = 250
    seen = []
    for piece in (1 << 20, 20_000, 1000):  # many planes, few, and some rows of one
        monkeypatch.setattr(decoding, "PIECE", piece)
        upload = added(store, tmp_path, labels)
        seen.append((upload.contents, upload.remarks, upload.phantom, upload.ends))
    assert seen[0] == seen[1] == seen[2]
    assert seen[0][1] == (
        "left out: 1 piece beside the breast, 0.0405 ml in all", "lesions: 1 mass, 1 single calcification",
    )  # fmt: skip
    own = np.where(breast() == 29, 2, np.where(breast() > 0, 1, 0)).astype(np.uint8)
    with pytest.raises(SpecError, match="its skin lies inside"):
        added(store, tmp_path, own)


def test_tissues_that_a_specification_changes_must_fit_the_values(store: Store, tmp_path: Path) -> None:
    part = added(store, tmp_path, breast()).spec
    own = {"0": "air", "1": "adipose", "2": "skin", "29": "gland"}
    registry.require(store, part.with_(tissues=own))
    for tissues, said in (
        ("openvct", "no tissue for 29"),
        ({**own, "29": "paddle"}, "compressed already"),
        (dict.fromkeys(own, "air"), "nothing but air"),
    ):
        with pytest.raises(SpecError, match=said):
            registry.require(store, part.with_(tissues=tissues))
