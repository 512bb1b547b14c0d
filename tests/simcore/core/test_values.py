"""Grid, geometry and random streams."""

import numpy as np
import pytest

from simcore.core import rng
from simcore.core.geometry import AcquisitionGeometry, Detector
from simcore.core.grid import Grid


def test_grid_centres_and_corners():
    grid = Grid((2, 3, 4), (0.5, 1.0, 2.0), (0.0, -1.5, 10.0))
    assert grid.centres("x") == pytest.approx([0.25, 0.75, 1.25, 1.75])
    assert grid.centres("y") == pytest.approx([-1, 0, 1])
    assert grid.centres("z") == pytest.approx([11, 13])
    assert grid.upper == (2.0, 1.5, 14.0)
    assert grid.voxel_volume == 1.0
    assert Grid.from_dict(grid.to_dict()) == grid
    assert grid.moved(z=5).corner == (0.0, -1.5, 15.0)


def geometry(detector_angles: list[float]) -> AcquisitionGeometry:
    angles = np.array([-20.0, 0.0, 20.0])
    a = np.deg2rad(angles)
    sources = np.stack([0 * a, 620 * np.sin(a), 40 + 620 * np.cos(a)], 1)
    return AcquisitionGeometry(angles, sources, Detector(5, 3, 2.0), np.array(detector_angles), 40.0, 660.0, 20.0)


def test_pixels_of_a_detector_at_rest():
    g = geometry([0, 0, 0])
    assert g.stationary
    assert g.pixel_position(0, 0, 0) == pytest.approx([1, -4, 0])
    assert g.pixel_position(2, 4, 2) == pytest.approx([5, 4, 0])


def test_a_turning_detector_turns_rigidly_with_the_tube_about_the_isocenter():
    """A detector that turns by the full tube angle sees the source always at the same place."""
    g = geometry([-20, 0, 20])
    assert not g.stationary
    distances = [np.linalg.norm(g.pixel_position(v, 0, 1) - g.sources[v]) for v in range(3)]
    assert distances == pytest.approx([distances[1]] * 3)
    isocenter = np.array([0, 0, 40.0])
    radii = [np.linalg.norm(g.pixel_position(v, 4, 0) - isocenter) for v in range(3)]
    assert radii == pytest.approx([radii[1]] * 3)


def test_streams_depend_on_seed_and_name_alone():
    first = rng.stream(1, "phantom", "seeds").random(4)
    assert np.array_equal(first, rng.stream(1, "phantom", "seeds").random(4))
    assert not np.array_equal(first, rng.stream(2, "phantom", "seeds").random(4))
    assert not np.array_equal(first, rng.stream(1, "phantom", "sizes").random(4))
    # Fixed for ever: results made with earlier versions must be reproducible.
    assert first[0] == pytest.approx(rng.stream(1, "phantom", "seeds").random(), rel=0)
