"""Artifacts survive the way through files, and the same artifact gives the same bytes."""

from pathlib import Path

import numpy as np
import pytest

from simcore.core.artifacts import Compression, Phantom, ProjectionStack, TetMesh, Volume
from simcore.core.geometry import AcquisitionGeometry, Detector
from simcore.core.grid import Grid
from simcore.store import codecs

GRID = Grid((3, 4, 5), (0.2, 0.3, 0.4), (0.0, -1.0, 2.0))
GEOMETRY = AcquisitionGeometry(
    np.array([-5.0, 5.0]),
    np.array([[0.0, -50.0, 600.0], [0.0, 50.0, 600.0]]),
    Detector(6, 7, 0.1),
    np.array([-1.0, 1.0]),
    40.0,
    660.0,
    20.0,
)
rng = np.random.default_rng(0)
CASES = {
    "phantom": (
        Phantom(rng.integers(0, 5, GRID.shape, dtype=np.uint8), GRID, ({"kind": "mass"},), {"volume_ml": 1.0}),
        codecs.save_phantom,
        codecs.load_phantom,
    ),
    "mesh": (
        TetMesh(rng.random((5, 3)), np.array([[0, 1, 2, 3]]), np.array([0]), np.array([[0, 1, 2]]), {"n": 1}),
        codecs.save_mesh,
        codecs.load_mesh,
    ),
    "compression": (
        Compression(rng.random((5, 3)), (-1.0, 2.0), 80.0, "converged", {"a": [1, 2]}),
        codecs.save_compression,
        codecs.load_compression,
    ),
    "stack": (
        ProjectionStack(rng.integers(0, 60000, (2, 6, 7), dtype=np.uint16), 6e4, GEOMETRY, {"r": 1}),
        codecs.save_stack,
        codecs.load_stack,
    ),
    "volume": (
        Volume(rng.integers(0, 60000, GRID.shape, dtype=np.uint16), GRID, 1e-5, -0.2, {}),
        codecs.save_volume,
        codecs.load_volume,
    ),
}


def same(a, b) -> bool:
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and np.array_equal(a, b)
    if isinstance(a, AcquisitionGeometry):
        return all(same(v, getattr(b, k)) for k, v in vars(a).items())
    return a == b


@pytest.mark.parametrize("name", CASES)
def test_round_trip(name: str, tmp_path: Path):
    artifact, save, load = CASES[name]
    save(tmp_path, artifact)
    again = load(lambda n: tmp_path / n)
    for key, value in vars(artifact).items():
        assert same(value, getattr(again, key)), key
    for value in vars(again).values():
        assert not isinstance(value, np.ndarray) or not value.flags.writeable


@pytest.mark.parametrize("name", CASES)
def test_same_bytes(name: str, tmp_path: Path):
    artifact, save, _ = CASES[name]
    contents = []
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        save(tmp_path / folder, artifact)
        contents.append({p.name: p.read_bytes() for p in (tmp_path / folder).iterdir()})
    assert contents[0] == contents[1]


def test_a_label_volume_cut_short_is_an_error(tmp_path: Path):
    codecs.save_phantom(tmp_path, CASES["phantom"][0])
    path = tmp_path / "labels.npy.zst"
    path.write_bytes(path.read_bytes()[:-5])
    with pytest.raises(ValueError):
        codecs.load_phantom(lambda n: tmp_path / n)


def test_labels_and_grid_must_agree():
    with pytest.raises(ValueError, match="differ"):
        Phantom(np.zeros((2, 2, 2), np.uint8), GRID)
