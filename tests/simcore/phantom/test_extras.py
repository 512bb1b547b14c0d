"""Nipple, ducts, lesions and slabs against closed forms and the plain phantom."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from pydantic import ValidationError

from simcore.core.artifacts import Phantom
from simcore.core.errors import PhantomError
from simcore.core.tissues import Tissue
from simcore.phantom import generate
from simcore.phantom.anthropomorphic import settle, slabs
from simcore.phantom.ducts import carve
from simcore.phantom.lesions import CalcificationCluster, Mass
from simcore.phantom.spec import AnthropomorphicPhantom, CompartmentSpec, DuctSpec, NippleSpec, TextureSpec

PLAIN = AnthropomorphicPhantom(volume_ml=100.0, voxel_mm=0.8, compartments=CompartmentSpec(count=100))
FULL = PLAIN.with_(
    texture=TextureSpec(amplitude_mm=2.0, scale_mm=8.0),
    nipple=NippleSpec(),
    ducts=DuctSpec(trees=6, generations=5),
    lesions=(Mass(centre_mm=(25.0, 3.0, 2.0), size_mm=(9.0, 8.0, 7.0), lobulation=0.4), CalcificationCluster()),
)


@pytest.fixture(scope="module")
def plain() -> Phantom:
    return generate(PLAIN, 2)


@pytest.fixture(scope="module")
def full() -> Phantom:
    return generate(FULL, 2)


def ml(phantom: Phantom, tissue: Tissue) -> float:
    return float(np.count_nonzero(phantom.labels == tissue)) * phantom.grid.voxel_volume * 1e-3


def test_everything_together_still_meets_volume_and_glandularity(full: Phantom) -> None:
    counted = np.count_nonzero(full.labels) * full.grid.voxel_volume * 1e-3
    assert counted == pytest.approx(100.0, rel=0.01)
    assert full.report["volume_ml"] == pytest.approx(counted, rel=1e-12)
    assert full.report["glandularity"] == pytest.approx(0.30, abs=0.02)
    for tissue in Tissue:
        if tissue:
            assert full.report["tissue_ml"].get(tissue.name.lower(), 0.0) == pytest.approx(ml(full, tissue), rel=1e-12)
    assert {"nipple", "duct", "mass", "calcification"} <= set(full.report["tissue_ml"])


def test_slabs_are_the_phantom_byte_for_byte(full: Phantom) -> None:
    parts = list(slabs(FULL, 2, slices=32))
    assert len(parts) > 2
    np.testing.assert_array_equal(np.concatenate([labels for _, labels in parts]), full.labels)
    assert parts[0][0].corner == full.grid.corner
    assert parts[1][0].corner[2] == pytest.approx(full.grid.corner[2] + 32 * 0.8)
    with pytest.raises(ValueError, match="multiple of 16"):
        next(slabs(FULL, 2, slices=20))


def test_same_bytes_for_any_number_of_threads(threads: Callable[[int], None]) -> None:
    phantoms = []
    for count in (1, 2):
        threads(count)
        phantoms.append(generate(FULL, 2))
    one, two = phantoms
    assert one.labels.tobytes() == two.labels.tobytes()
    assert one.truth == two.truth
    assert one.report == two.report


def test_additions_leave_the_rest_of_the_breast_as_it_was(plain: Phantom) -> None:
    added = (Tissue.DUCT, Tissue.MASS, Tissue.CALCIFICATION)
    phantom = generate(PLAIN.with_(ducts=FULL.ducts, lesions=FULL.lesions), 2)
    rest = ~np.isin(phantom.labels, added)
    assert 0.9 < rest.mean() < 1
    np.testing.assert_array_equal(phantom.labels[rest], plain.labels[rest])
    assert plain.truth == ()


def test_nipple_stands_out_by_its_height_and_takes_the_place_of_the_skin() -> None:
    spec = PLAIN.with_(voxel_mm=0.4, nipple=NippleSpec(diameter_mm=8.0, height_mm=6.0))
    phantom = generate(spec, 1)
    depth = phantom.report["semi_axes_mm"][0]
    k, j, i = np.nonzero(phantom.labels == Tissue.NIPPLE)
    x, y, z = (phantom.grid.centres(axis)[n] for axis, n in (("x", i), ("y", j), ("z", k)))
    assert x.max() == pytest.approx(depth + 6.0, abs=0.5)
    assert np.hypot(y, z).max() == pytest.approx(4.0, abs=0.4)
    assert np.hypot(y, z)[x > depth + 5.5].max() < 3.9  # a round tip
    # Out of the skin: h pi r^2 times the mean of (1 - t^4)^(1/4) over the disc, 0.927; under it, the skin's thickness.
    stands_out = 6.0 * math.pi * 16.0 * 0.927
    assert ml(phantom, Tissue.NIPPLE) * 1e3 == pytest.approx(stands_out + math.pi * 16.0 * spec.skin_mm, rel=0.06)
    axis = phantom.labels[np.argmin(np.abs(phantom.grid.centres("z"))), phantom.grid.shape[1] // 2]
    assert Tissue.SKIN not in axis
    assert generate(spec.with_(nipple=NippleSpec(height_mm=0.0)), 1).grid.shape[2] < phantom.grid.shape[2]


def test_ducts_are_trees_from_the_nipple_to_the_gland(full: Phantom) -> None:
    breast = settle(FULL, 2)
    begins, ends = breast.ducts[:, :3], breast.ducts[:, 4:7]
    ducts = FULL.ducts
    assert ducts is not None
    ended = {tuple(p) for p in ends}
    roots = {tuple(p) for p in begins} - ended
    assert len(roots) == ducts.trees  # every other piece begins where one ends
    assert all(root[0] > breast.shape.axes[0] for root in roots)  # in the nipple
    tips = np.array(sorted(ended - {tuple(p) for p in begins}))
    assert 0.8 * ducts.trees * 2**ducts.generations < len(tips) <= ducts.trees * 2**ducts.generations
    whole = generate(FULL.with_(ducts=None, lesions=()), 2)
    index = np.floor((tips - whole.grid.corner) / whole.grid.spacing).astype(int)
    tissues = whole.labels[tuple(index[:, ::-1].T)]
    # Up to half a voxel lies between a tip and the centre of its voxel.
    assert np.mean(np.isin(tissues, (Tissue.GLAND, Tissue.LIGAMENT))) > 0.95
    assert np.mean(tissues == Tissue.GLAND) > 0.85
    # Radii fall from the nipple to the tips.
    assert breast.ducts[:, 3].max() == np.float32(ducts.main_diameter_mm / 2)
    assert breast.ducts[:, 7].min() == pytest.approx(ducts.terminal_diameter_mm / 2)
    assert np.all(breast.ducts[:, 3] >= breast.ducts[:, 7])
    assert ml(full, Tissue.DUCT) > 0.05


def carve_ball() -> np.ndarray:
    labels = np.full((100, 100, 100), Tissue.GLAND, dtype=np.uint8)
    carve(np.array([[3.0, -1.0, 0.0, 2.0, 3.0, -1.0, 0.0, 2.0]], np.float32), 0.1, -5.0, -5.0, 0, labels)
    return labels == Tissue.DUCT


def test_a_carved_piece_is_a_capsule() -> None:
    labels = np.full((100, 100, 200), Tissue.GLAND, dtype=np.uint8)
    labels[:, :, 150:] = Tissue.SKIN
    piece = np.array([[5.0, 0.0, 0.5, 2.0, 13.0, 1.0, -0.5, 1.0]], dtype=np.float32)
    replaced = carve(piece, 0.1, -5.0, -5.0, 0, labels)
    length, big, small = math.sqrt(66.0), 2.0, 1.0
    frustum = math.pi / 3 * length * (big**2 + big * small + small**2)
    volume = frustum + 2 / 3 * math.pi * (big**3 + small**3)
    assert np.count_nonzero(labels == Tissue.DUCT) * 1e-3 == pytest.approx(volume, rel=0.02)
    assert replaced[Tissue.GLAND] == np.count_nonzero(labels == Tissue.DUCT) == replaced.sum()
    middle = [axis.mean() for axis in np.nonzero(carve_ball())]
    np.testing.assert_allclose(middle, [49.5, 39.5, 29.5], atol=0.05)  # at z, y, x of 0, -1 and 3 mm
    skinned = carve(np.array([[14, 0, 0, 2, 16, 0, 0, 2]], np.float32), 0.1, -5.0, -5.0, 0, labels)
    assert skinned[Tissue.SKIN] == 0
    assert np.all(labels[:, :, 150:] == Tissue.SKIN)


def test_ducts_without_gland_are_refused() -> None:
    with pytest.raises(PhantomError, match=r"ducts\.trees = 12 .* higher glandularity"):
        generate(PLAIN.with_(glandularity=0.0, ducts=DuctSpec()), 1)


@pytest.mark.parametrize("lobulation", [0.0, 0.5])
def test_a_mass_has_its_place_and_the_volume_of_its_ellipsoid(lobulation: float) -> None:
    mass = Mass(centre_mm=(25.3, 2.2, -1.7), size_mm=(12.0, 10.0, 8.0), lobulation=lobulation)
    phantom = generate(PLAIN.with_(voxel_mm=0.4, lesions=(mass,)), 1)
    (entry,) = phantom.truth
    volume = math.pi / 6 * 12 * 10 * 8
    assert entry["volume_mm3"] == pytest.approx(volume, rel=0.02)
    assert entry["volume_mm3"] == pytest.approx(ml(phantom, Tissue.MASS) * 1e3)
    assert (entry["id"], entry["kind"], entry["tissue"]) == ("lesion-1", "mass", "mass")
    k, j, i = np.nonzero(phantom.labels == Tissue.MASS)
    points = np.stack([phantom.grid.centres(axis)[n] for axis, n in (("x", i), ("y", j), ("z", k))])
    assert entry["centre_mm"] == [25.3, 2.2, -1.7]
    np.testing.assert_allclose(points.mean(axis=1), entry["centre_mm"], atol=0.1 if lobulation == 0 else 1.0)
    extent = np.ptp(points, axis=1) + 0.4
    if lobulation == 0:
        np.testing.assert_allclose(extent, mass.size_mm, atol=0.5)
    else:
        assert np.any(np.abs(extent - mass.size_mm) > 0.8)


def test_calcifications_are_known_one_by_one_and_never_get_lost_between_voxels() -> None:
    cluster = CalcificationCluster(centre_mm=(25.0, 0.0, 0.0), count=12, smallest_mm=0.1, largest_mm=1.5)
    phantom = generate(PLAIN.with_(lesions=(cluster,)), 4)
    whole, *parts = phantom.truth
    assert len(parts) == whole["parts"] == 12
    assert all(p["part_of"] == whole["id"] and p["kind"] == "calcification" for p in parts)
    assert all(p["volume_mm3"] >= 0.99 * 0.8**3 for p in parts)
    assert whole["volume_mm3"] == pytest.approx(ml(phantom, Tissue.CALCIFICATION) * 1e3, rel=0.05)  # some may touch
    for part in parts:
        index = np.floor((np.array(part["centre_mm"]) - phantom.grid.corner) / 0.8).astype(int)
        assert phantom.labels[tuple(index[::-1])] == Tissue.CALCIFICATION
        assert math.dist(part["centre_mm"], whole["centre_mm"]) <= 5.0
    assert len({tuple(p["centre_mm"]) for p in parts}) == 12


def test_lesions_without_a_place_lie_in_the_gland_inside_the_skin() -> None:
    spec = PLAIN.with_(lesions=(Mass(size_mm=(8.0, 8.0, 8.0)), Mass(size_mm=(8.0, 8.0, 8.0))))
    plain, phantom = generate(PLAIN, 1), generate(spec, 1)
    centres = [entry["centre_mm"] for entry in phantom.truth]
    assert centres[0] != centres[1]
    for centre in centres:
        index = np.floor((np.array(centre) - plain.grid.corner) / 0.8).astype(int)
        assert plain.labels[tuple(index[::-1])] in (Tissue.GLAND, Tissue.LIGAMENT)
    assert [e["centre_mm"] for e in generate(spec, 1).truth] == centres
    assert [e["centre_mm"] for e in generate(spec, 2).truth] != centres
    with pytest.raises(PhantomError, match=r"lesion-1 of 60 x 60 x 60 mm finds no place"):
        generate(PLAIN.with_(lesions=(Mass(size_mm=(60.0, 60.0, 60.0)),)), 1)


def test_a_later_lesion_takes_the_place_of_an_earlier_one() -> None:
    big, small = (Mass(centre_mm=(25.0, 0.0, 0.0), size_mm=(s, s, s)) for s in (10.0, 4.0))
    cluster = CalcificationCluster(centre_mm=(25.0, 0.0, 0.0), count=1, cluster_mm=0.0, smallest_mm=3.0, largest_mm=3.0)
    phantom = generate(PLAIN.with_(lesions=(big, cluster)), 1)
    middle = np.floor((np.array([25.0, 0.0, 0.0]) - phantom.grid.corner) / 0.8).astype(int)[::-1]
    assert phantom.labels[tuple(middle)] == Tissue.CALCIFICATION
    covered = generate(PLAIN.with_(lesions=(cluster, big, small)), 1)
    assert not np.any(covered.labels == Tissue.CALCIFICATION)


@pytest.mark.parametrize("centre", [(70.0, 0.0, 0.0), (0.5, 0.0, 200.0), (-1.0, 0.0, 0.0)])
def test_a_lesion_outside_the_tissue_is_refused(centre: tuple[float, float, float]) -> None:
    with pytest.raises(PhantomError, match=r"centre of lesion-2.*outside the tissue: x from 0 to \d"):
        generate(PLAIN.with_(lesions=(Mass(), Mass(centre_mm=centre))), 1)


@pytest.mark.parametrize(
    ("model", "fields", "said"),
    [
        (TextureSpec, {"amplitude_mm": 5.0, "scale_mm": 8.0}, "fold borders over"),
        (TextureSpec, {"amplitude_mm": 1.0, "scale_mm": 8.0, "octaves": 5}, "below 1 mm"),
        (CalcificationCluster, {"smallest_mm": 2.0, "largest_mm": 1.0}, "below smallest_mm"),
    ],
)
def test_contradictions_in_a_specification_are_refused(model: type, fields: dict[str, object], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        model(**fields)
