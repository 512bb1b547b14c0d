"""What a phantom must hold: volume, glandularity, tissues, anatomy, repeatability, errors with advice."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy import ndimage

from simcore.core.artifacts import Phantom
from simcore.core.errors import Cancelled, PhantomError
from simcore.core.tissues import Tissue
from simcore.phantom import generate
from simcore.phantom.outline import similar_radius
from simcore.phantom.spec import AnthropomorphicPhantom, CompartmentSpec

CUPS = {"A": (250.0, 350), "C": (700.0, 450), "DD": (1500.0, 550)}


def cup(name: str, voxel_mm: float = 1.0, **fields: object) -> AnthropomorphicPhantom:
    volume_ml, count = CUPS[name]
    compartments = CompartmentSpec(count=count)
    return AnthropomorphicPhantom(volume_ml=volume_ml, voxel_mm=voxel_mm, compartments=compartments, **fields)


@pytest.fixture(scope="module")
def cup_c() -> Phantom:
    return generate(cup("C", 0.8, glandularity=0.2), seed=1)


@pytest.mark.parametrize("name", CUPS)
@pytest.mark.parametrize("glandularity", [0.05, 0.3, 0.6])
def test_volume_and_glandularity_are_met(name: str, glandularity: float) -> None:
    spec = cup(name, 1.2, glandularity=glandularity)
    phantom = generate(spec, seed=3)
    counts = np.bincount(phantom.labels.ravel(), minlength=5)
    ml = counts * phantom.grid.voxel_volume * 1e-3
    assert ml[1:].sum() == pytest.approx(spec.volume_ml, rel=0.01)
    met = counts[Tissue.GLAND] / (counts[1:].sum() - counts[Tissue.SKIN])
    assert met == pytest.approx(glandularity, abs=0.005)
    assert phantom.report["volume_ml"] == pytest.approx(ml[1:].sum(), rel=1e-12)
    assert phantom.report["glandularity"] == pytest.approx(met, rel=1e-12)
    for tissue in Tissue:
        expected = ml[tissue] if tissue < len(ml) and tissue else 0.0
        assert phantom.report["tissue_ml"].get(tissue.name.lower(), 0.0) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("glandularity", [0.0, 0.05, 0.3, 0.6, 0.9])
@pytest.mark.parametrize(("volume_ml", "voxel_mm", "count"), [(5.0, 2.0, 450), (5.0, 2.0, 20), (700.0, 3.0, 20)])
def test_few_voxels_or_few_compartments_still_meet_the_glandularity(
    volume_ml: float, voxel_mm: float, count: int, glandularity: float
) -> None:
    spec = AnthropomorphicPhantom(volume_ml=volume_ml, voxel_mm=voxel_mm, glandularity=glandularity,
                                  compartments=CompartmentSpec(count=count))  # fmt: skip
    for seed in range(3):
        assert generate(spec, seed).report["glandularity"] == pytest.approx(glandularity, abs=0.02)


def test_gland_is_one_central_region_with_small_fat_inside(cup_c: Phantom) -> None:
    gland = cup_c.labels == Tissue.GLAND
    parts, _ = ndimage.label(gland)
    sizes = np.bincount(parts.ravel())[1:]
    assert sizes.max() > 0.95 * sizes.sum()
    k, j, i = np.nonzero(gland)
    x, y, z = (cup_c.grid.centres(axis)[index] for axis, index in (("x", i), ("y", j), ("z", k)))
    a, b, *_ = cup_c.report["semi_axes_mm"]
    assert abs(y.mean()) < 0.1 * b
    assert 0.25 * a < x.mean() < 0.6 * a
    radius = similar_radius(tuple(cup_c.report["semi_axes_mm"]), x, y, z)
    assert np.percentile(radius, 99) < 0.9  # a subcutaneous layer stays free of gland
    volumes = cup_c.report["compartment_volume_cm3"]
    assert volumes["enclosed"]["median"] < 0.4 * volumes["subcutaneous"]["median"]
    assert cup_c.report["compartments"]["enclosed"] > 20


def test_little_gland_lies_in_the_middle() -> None:
    phantom = generate(cup("C", 1.2, glandularity=0.08), seed=1)
    a, b, upper, lower = phantom.report["semi_axes_mm"]
    k, j, i = np.nonzero(phantom.labels == Tissue.GLAND)
    x, y, z = (phantom.grid.centres(axis)[index] for axis, index in (("x", i), ("y", j), ("z", k)))
    around_middle = similar_radius((a / 2, b, upper, lower), x - 0.45 * a, y, z)
    assert np.percentile(around_middle, 95) < 0.65


def test_layers_have_their_thickness(cup_c: Phantom) -> None:
    kinds, volumes = cup_c.report["compartments"], cup_c.report["compartment_volume_cm3"]
    assert sum(kinds.values()) == 450
    a, b, upper, lower = cup_c.report["semi_axes_mm"]
    whole = np.pi / 3 * a * b * (upper + lower) * 1e-3
    outer = 1 - 1.45 / np.mean([a, b, upper, lower])
    subcutaneous = whole * (outer**3 - (outer - 0.2) ** 3)
    assert kinds["subcutaneous"] * volumes["subcutaneous"]["median"] == pytest.approx(subcutaneous, rel=0.15)
    cut = 8.0 / ((outer - 0.2) * a)
    retromammary = whole * (outer - 0.2) ** 3 * (1.5 * cut - 0.5 * cut**3)
    assert kinds["retromammary"] * volumes["retromammary"]["median"] == pytest.approx(retromammary, rel=0.25)


def test_skin_covers_the_breast_but_not_the_chest_wall(cup_c: Phantom) -> None:
    labels = cup_c.labels
    tissue = (labels != Tissue.AIR) & (labels != Tissue.SKIN)
    # With skin of 1.8 voxels no tissue touches air across a face ...
    air = labels == Tissue.AIR
    for axis in range(3):
        for shift in (1, -1):
            touching = tissue & np.roll(air, shift, axis=axis)
            if axis == 2 and shift == 1:
                touching[:, :, 0] = False  # ... but through the chest wall, where the array wraps around.
            assert not touching.any()
    wall = labels[:, :, 0]
    assert np.count_nonzero((wall != Tissue.AIR) & (wall != Tissue.SKIN)) > 0.9 * np.count_nonzero(wall)


def test_skin_and_ligaments_have_the_same_volume_in_coarse_and_fine_voxels() -> None:
    coarse, fine = (
        generate(AnthropomorphicPhantom(volume_ml=60.0, voxel_mm=v, glandularity=0.2), 5).report for v in (1.0, 0.4)
    )
    for tissue in ("skin", "ligament", "adipose"):
        assert coarse["tissue_ml"][tissue] == pytest.approx(fine["tissue_ml"][tissue], rel=0.03)


def test_the_same_seed_gives_the_same_bytes_and_another_seed_another_breast() -> None:
    spec = AnthropomorphicPhantom(volume_ml=20.0, voxel_mm=1.0)
    one, again, other = generate(spec, 7), generate(spec, 7), generate(spec, 8)
    assert one.labels.tobytes() == again.labels.tobytes()
    assert one.report == again.report
    assert one.labels.tobytes() != other.labels.tobytes()
    assert one.grid == other.grid


def test_progress_rises_to_one_and_can_stop_the_stage() -> None:
    spec = AnthropomorphicPhantom(volume_ml=5.0, voxel_mm=2.0)
    seen: list[float] = []
    generate(spec, 1, lambda fraction, message: seen.append(fraction))
    assert seen == sorted(seen)
    assert seen[0] == 0.0
    assert seen[-1] == 1.0

    def stop(fraction: float, message: str) -> None:
        if fraction > 0.2:
            raise Cancelled("enough")

    with pytest.raises(Cancelled):
        generate(spec, 1, stop)


def test_ligaments_thicker_than_their_compartments_are_refused_with_advice() -> None:
    spec = AnthropomorphicPhantom(
        volume_ml=20.0, voxel_mm=1.0, compartments=CompartmentSpec(count=5000, ligament_mm=2.0)
    )
    with pytest.raises(
        PhantomError, match=r"ligament_mm = 2 mm .* at most (\d\.\d+) mm or at most (\d+) compartments"
    ) as error:
        generate(spec, 1)
    words = str(error.value).split()
    thickness, count = float(words[-7]), int(words[-2])
    for allowed in (spec.compartments.with_(ligament_mm=thickness - 0.01), spec.compartments.with_(count=count)):
        generate(spec.with_(compartments=allowed), 1)


def test_reading_specifications_loads_no_compiler() -> None:
    code = "import sys, simcore.phantom, simcore.phantom.spec; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
