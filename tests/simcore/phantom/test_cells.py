"""Hierarchical cells against the plainest form, region growing and a slab of known thickness."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from simcore.core.rng import stream
from simcore.core.tissues import Tissue
from simcore.phantom.cells import ROWS, keep_rivals, seed_table
from simcore.phantom.glandularity import Compartments, settle
from simcore.phantom.outline import Outline, outline
from simcore.phantom.raster import label_voxels
from simcore.phantom.seeds import layers, plant
from simcore.phantom.spec import AnthropomorphicPhantom, CompartmentSpec, TextureSpec
from simcore.phantom.survey import survey
from simcore.phantom.texture import PLAIN, Texture, displaced, displaced_box, texture
from tests.support import oracles


def grown(
    seed: int = 1, modulation: Texture = PLAIN, **fields: object
) -> tuple[AnthropomorphicPhantom, Outline, Compartments]:
    spec = AnthropomorphicPhantom(**fields)
    shape = outline(spec)
    border = layers(spec, shape.axes, 1.0)
    return spec, shape, settle(spec, shape, modulation, plant(spec, shape.axes, border, 0.3, stream(seed, "test")))


def label(spec: AnthropomorphicPhantom, shape: Outline, cells: Compartments, modulation: Texture = PLAIN) -> np.ndarray:
    labels = np.zeros(shape.grid.shape, dtype=np.uint8)
    label_voxels(cells.table, cells.gland_seeds, spec.compartments.ligament_mm, modulation, shape.tissue_rows,
                 shape.breast_rows, shape.cover, spec.voxel_mm, shape.grid.corner[1], shape.grid.corner[2], 0,
                 labels)  # fmt: skip
    return labels


def label_box(table: np.ndarray, gland_seeds: int, ligament_mm: float, modulation: Texture, shape: tuple[int, int, int],
              voxel_mm: float, corner_y: float, corner_z: float) -> np.ndarray:  # fmt: skip
    """A box of tissue without any cover."""
    labels = np.zeros(shape, dtype=np.uint8)
    rows = np.full(shape[:2], shape[2], dtype=np.int32)
    cover = np.zeros(shape[:2], dtype=np.uint8)
    label_voxels(
        table, gland_seeds, ligament_mm, modulation, rows, rows, cover, voxel_mm, corner_y, corner_z, 0, labels
    )
    return labels


def tissue_points(shape: Outline) -> tuple[np.ndarray, np.ndarray]:
    inside = np.arange(shape.grid.shape[2]) < shape.tissue_rows[:, :, None]
    k, j, i = np.nonzero(inside)
    points = [shape.grid.centres(axis)[index] for axis, index in (("x", i), ("y", j), ("z", k))]
    return inside, np.stack(points, axis=1)


@pytest.mark.parametrize("ligament_mm", [0.0, 0.4, 1.0])
def test_labels_equal_every_seed_at_every_voxel(ligament_mm: float) -> None:
    compartments = CompartmentSpec(count=60, ligament_mm=ligament_mm)
    spec, shape, cells = grown(volume_ml=30.0, voxel_mm=0.8, compartments=compartments)
    labels = label(spec, shape, cells)
    inside, points = tissue_points(shape)
    expected, doubt = oracles.tissue(cells.table, cells.gland_seeds, ligament_mm, points)
    differ = labels[inside] != expected
    assert not np.any(differ & (doubt > 1e-4))
    assert np.count_nonzero(differ) < 1e-4 * len(points)
    assert set(np.unique(expected)) >= {Tissue.ADIPOSE, Tissue.GLAND}
    # Skin and air are those of the outline.
    breast = np.arange(shape.grid.shape[2]) < shape.breast_rows[:, :, None]
    assert np.all(labels[breast & ~inside] == Tissue.SKIN)
    assert not labels[~breast].any()


def test_labels_equal_every_seed_where_blocks_are_smaller_than_ligaments() -> None:
    _, _, cells = grown(volume_ml=30.0, voxel_mm=0.8, compartments=CompartmentSpec(count=60))
    labels = label_box(cells.table, cells.gland_seeds, 1.5, PLAIN, (100, 100, 200), 0.1, -3.0, -6.0)
    index = np.random.default_rng(0).integers(0, (100, 100, 200), (40_000, 3))
    points = (index[:, ::-1] + 0.5) * 0.1 + [0.0, -3.0, -6.0]
    expected, doubt = oracles.tissue(cells.table, cells.gland_seeds, 1.5, points)
    differ = labels[tuple(index.T)] != expected
    assert not np.any(differ & (doubt > 1e-4))
    assert set(np.unique(expected)) == {Tissue.ADIPOSE, Tissue.GLAND, Tissue.LIGAMENT}


def test_seeds_dropped_for_a_box_neither_win_nor_draw_a_ligament_in_it() -> None:
    random = np.random.default_rng(3)
    _, _, cells = grown(volume_ml=100.0, voxel_mm=2.0, compartments=CompartmentSpec(count=200))
    table, n = cells.table, cells.table.shape[1]
    kept, work = np.empty((ROWS, n), np.float32), np.empty((2, n), np.float32)
    sizes = []
    for _ in range(400):
        half = 10 ** random.uniform(-1.5, 0.8, 3).astype(np.float32)
        centre = random.uniform([0, -25, -25], [40, 25, 25]).astype(np.float32)
        thickness = np.float32(random.uniform(0, 5))
        number = keep_rivals(table, n, *centre, *half, thickness, np.float32(0), work[0], work[1], kept)
        points = centre + random.uniform(-1, 1, (200, 3)) * half
        delay, gradient = oracles.delays(table, points)
        winner, row = delay.argmin(axis=1), np.arange(len(points))
        steep = np.linalg.norm(gradient - gradient[row, winner][:, None], axis=2)
        matters = (delay - delay[row, winner][:, None] < thickness * steep).any(axis=0)
        matters[winner] = True
        assert set(np.flatnonzero(matters)) <= set(kept[ROWS - 1, :number].astype(int))
        sizes.append(number)
    assert np.mean(sizes) < 0.3 * n  # it does drop


def test_survey_equals_every_seed_at_every_point_and_region_growing_up_to_connectivity() -> None:
    _, shape, cells = grown(volume_ml=12.0, voxel_mm=1.0, compartments=CompartmentSpec(count=40))
    cover = survey(shape, PLAIN, cells.table, cells.gland_seeds, 0.4)
    inside, points = tissue_points(shape)
    delay, _ = oracles.delays(cells.table, points)
    order = np.sort(delay, axis=1)
    clear = order[:, 1] - order[:, 0] > 1e-4
    np.testing.assert_array_equal(cover.first[clear], delay.argmin(axis=1)[clear])
    regions = oracles.grow_regions(cells.table, shape.grid, inside)[inside]
    # Growing stops at whoever was there first; the arg-max reaches behind him. With seeds that differ in size and
    # direction, few voxels lie behind another cell.
    assert np.mean(regions == cover.first) > 0.985


def test_ligaments_hold_those_of_the_two_largest_and_little_more() -> None:
    spec, shape, cells = grown(volume_ml=30.0, voxel_mm=0.8, glandularity=0.0, compartments=CompartmentSpec(count=60))
    labels = label(spec, shape, cells)
    inside, points = tissue_points(shape)
    ligament = labels[inside] == Tissue.LIGAMENT
    of_two = oracles.two_largest(cells.table, spec.compartments.ligament_mm, points)
    assert np.count_nonzero(of_two & ~ligament) <= 2  # float ties
    assert np.count_nonzero(ligament) < 1.03 * np.count_nonzero(of_two)


def test_ligament_between_two_equal_spheres_is_a_slab_of_the_given_thickness() -> None:
    centres = np.array([[5.0, 0.0, 0.0], [25.34, 0.0, 0.0]])  # bisector at 15.17 mm
    table = seed_table(centres, np.tile(np.eye(3) / 64.0, (2, 1, 1)))
    x = (np.arange(300) + 0.5) * 0.1
    for gland_seeds, tissues in ((0, {1, 4}), (1, {1, 2, 4}), (2, {2})):
        labels = label_box(table, gland_seeds, 1.2, PLAIN, (4, 4, 300), 0.1, -0.2, -0.2)
        assert set(np.unique(labels)) == tissues
        slab = (np.abs(x - 15.17) < 0.6) & (gland_seeds < 2)
        np.testing.assert_array_equal(labels == Tissue.LIGAMENT, np.broadcast_to(slab, labels.shape))


def test_margin_is_the_common_start_that_changes_a_point() -> None:
    _, shape, cells = grown(volume_ml=12.0, voxel_mm=1.0, glandularity=0.25, compartments=CompartmentSpec(count=40))
    margin = survey(shape, PLAIN, cells.table, cells.gland_seeds, 0.4, slack=0.3).margin
    _, points = tissue_points(shape)
    for shift in (-0.2, 0.0, 0.2):
        table = cells.table.copy()
        table[9, : cells.gland_seeds] += np.float32(shift)
        expected, doubt = oracles.tissue(table, cells.gland_seeds, 0.4, points)
        clear = doubt > 1e-4
        np.testing.assert_array_equal((margin > shift)[clear], (expected == Tissue.GLAND)[clear])


def test_same_bytes_for_any_number_of_threads(threads: Callable[[int], None]) -> None:
    spec, shape, _ = grown(volume_ml=60.0, voxel_mm=0.8)
    results = []
    for count in (1, 2):
        threads(count)
        seeds = plant(spec, shape.axes, layers(spec, shape.axes, 1.0), 0.3, stream(1, "test"))
        modulation = bumps(shape)
        cells = settle(spec, shape, modulation, seeds)
        results.append([label(spec, shape, cells, m).tobytes() for m in (PLAIN, modulation)])
    assert results[0] == results[1]


def bumps(shape: Outline, amplitude_mm: float = 2.0, scale_mm: float = 6.0, octaves: int = 3) -> Texture:
    spec = TextureSpec(amplitude_mm=amplitude_mm, scale_mm=scale_mm, octaves=octaves)
    return texture(spec, shape.axes, stream(1, "bumps"))


def displaced_points(modulation: Texture, points: np.ndarray) -> np.ndarray:
    """Trilinear interpolation in float64, by an implementation that is not ours."""
    nodes = [c + modulation.pitch * np.arange(n)
             for c, n in zip(modulation.corner, modulation.field.shape[:0:-1], strict=True)]  # fmt: skip
    return points + np.stack(
        [RegularGridInterpolator(nodes[::-1], f.astype(np.float64))(points[:, ::-1]) for f in modulation.field], axis=1
    )


@pytest.mark.parametrize("ligament_mm", [0.0, 0.6])
def test_textured_labels_equal_every_seed_at_every_displaced_voxel(ligament_mm: float) -> None:
    compartments = CompartmentSpec(count=60, ligament_mm=ligament_mm)
    shape = outline(AnthropomorphicPhantom(volume_ml=30.0, voxel_mm=0.8))
    modulation = bumps(shape)
    spec, shape, cells = grown(modulation=modulation, volume_ml=30.0, voxel_mm=0.8, compartments=compartments)
    labels = label(spec, shape, cells, modulation)
    inside, points = tissue_points(shape)
    expected, doubt = oracles.tissue(cells.table, cells.gland_seeds, ligament_mm, displaced_points(modulation, points))
    differ = labels[inside] != expected
    assert not np.any(differ & (doubt > 1e-4))
    assert np.count_nonzero(differ) < 1e-4 * len(points)
    assert np.mean(labels[inside] != label(spec, shape, cells)[inside]) > 0.05  # it does something
    # The survey sees the same cells, so that the glandularity is met.
    cover = survey(shape, modulation, cells.table, cells.gland_seeds, ligament_mm)
    delay, _ = oracles.delays(cells.table, displaced_points(modulation, points))
    order = np.sort(delay, axis=1)
    clear = order[:, 1] - order[:, 0] > 1e-4
    np.testing.assert_array_equal(cover.first[clear], delay.argmin(axis=1)[clear])


def test_textured_labels_equal_every_seed_where_blocks_are_smaller_than_bumps() -> None:
    shape = outline(AnthropomorphicPhantom(volume_ml=30.0, voxel_mm=0.8))
    modulation = bumps(shape, 1.0, 2.0, 2)
    _, _, cells = grown(volume_ml=30.0, voxel_mm=0.8, compartments=CompartmentSpec(count=60))
    labels = label_box(cells.table, cells.gland_seeds, 0.5, modulation, (100, 100, 200), 0.1, -3.0, -6.0)
    index = np.random.default_rng(0).integers(0, (100, 100, 200), (40_000, 3))
    points = displaced_points(modulation, (index[:, ::-1] + 0.5) * 0.1 + [0.0, -3.0, -6.0])
    expected, doubt = oracles.tissue(cells.table, cells.gland_seeds, 0.5, points)
    assert not np.any((labels[tuple(index.T)] != expected) & (doubt > 1e-3))
    assert set(np.unique(expected)) == {Tissue.ADIPOSE, Tissue.GLAND, Tissue.LIGAMENT}


def test_a_displaced_box_holds_its_displaced_points() -> None:
    shape = outline(AnthropomorphicPhantom(volume_ml=30.0, voxel_mm=0.8))
    modulation = bumps(shape)
    random = np.random.default_rng(5)
    shrunk = []
    for _ in range(300):
        half = 10 ** random.uniform(-1, 1, 3).astype(np.float32)
        centre = random.uniform([0, -20, -20], [30, 20, 20]).astype(np.float32)
        points = (centre + random.uniform(-1, 1, (100, 3)) * half).astype(np.float32)
        moved = np.array([displaced(modulation, *p) for p in points])
        box = np.array(displaced_box(modulation, *centre, *half))
        assert np.all(np.abs(moved - box[:3]) <= box[3:] + 1e-4)
        shrunk.append(np.max(box[3:] - half))
    assert min(shrunk) < 0.5 < 2.0 < max(shrunk) + 0.2  # tight for small boxes, up to the amplitude for large ones


def test_texture_has_the_amplitude_and_spectrum_asked_for() -> None:
    axes = (60.0, 40.0, 40.0, 40.0)
    for octaves in (1, 3):
        spec = TextureSpec(amplitude_mm=2.0, scale_mm=8.0, octaves=octaves)
        field = texture(spec, axes, stream(2, "bumps")).field.astype(np.float64)
        assert np.abs(field).max() == 2.0
        assert field.std() == pytest.approx(0.8, rel=0.08)
        # Independent along x, y and z.
        assert np.abs(np.corrcoef(field.reshape(3, -1))[np.triu_indices(3, 1)]).max() < 0.1
    # Twice the finest scale, twice the pitch: the nodes follow the finest octave.
    assert texture(spec, axes, stream(2, "bumps")).pitch == 1.0
    # Each octave has half the strength: neighbours differ by more than in one octave of the coarse scale.
    coarse = texture(TextureSpec(amplitude_mm=2.0, scale_mm=8.0, octaves=1), axes, stream(2, "bumps"))
    assert np.diff(coarse.field, axis=3).std() / coarse.pitch < 0.8 * np.diff(field, axis=3).std()


def test_texture_is_the_same_for_any_voxel_size_and_none_without_amplitude() -> None:
    spec = TextureSpec(amplitude_mm=1.0)
    shapes = [outline(AnthropomorphicPhantom(volume_ml=60.0, voxel_mm=v)) for v in (0.4, 0.8)]
    fields = [texture(spec, shape.axes, stream(1, "bumps")).field.tobytes() for shape in shapes]
    assert fields[0] == fields[1]
    assert texture(TextureSpec(), shapes[0].axes, stream(1, "bumps")) is PLAIN
