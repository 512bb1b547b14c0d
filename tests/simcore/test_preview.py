"""Pictures open, are turned the right way and are the same every time."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from simcore import preview
from simcore.core.artifacts import Phantom, ProjectionStack, Volume
from simcore.core.geometry import AcquisitionGeometry, Detector
from simcore.core.grid import Grid
from simcore.core.tissues import Tissue
from simcore.preview import TISSUE_GREY, image_png, phantom_png, write_previews


def phantom():
    """Breast tissue at the chest wall, a mass near the nipple, at -y and high up."""
    grid = Grid((20, 60, 40), (1.0, 1.0, 1.0), (0.0, -30.0, 0.0))
    labels = np.zeros(grid.shape, np.uint8)
    labels[:, 10:50, :30] = Tissue.ADIPOSE
    labels[8:18, 12:31, 22:28] = Tissue.MASS
    return Phantom(labels, grid)


def stack(views=7):
    """Thick at the chest wall; a dense spot towards the nipple at -y."""
    thickness = np.zeros((60, 40))
    thickness[10:50, :30] = np.linspace(50.0, 10.0, 30)
    line_integrals = 0.05 * thickness
    line_integrals[15:20, 20:25] += 3.0
    data = np.rint(60000 * np.exp(-line_integrals)).astype(np.uint16)
    a = np.deg2rad(np.linspace(-20, 20, views))
    sources = np.stack([0 * a, 600 * np.sin(a), 60 + 600 * np.cos(a)], 1)
    geometry = AcquisitionGeometry(np.rad2deg(a), sources, Detector(60, 40, 1.0), np.zeros(views), 60.0, 660.0, 20.0)
    return ProjectionStack(np.repeat(data[None], views, axis=0), 60000.0, geometry)


def volume():
    grid = Grid((9, 60, 40), (1.0, 1.0, 1.0), (0.0, -30.0, 20.0))
    attenuation = np.zeros(grid.shape)
    attenuation[:, 10:50, :30] = 0.005
    attenuation[:, 15:20, 20:25] = 0.02
    attenuation[:, 5:10, :30] = -0.004
    return Volume(np.rint((attenuation + 0.2) / 1e-5).astype(np.uint16), grid, 1e-5, -0.2)


def read(path):
    with Image.open(path) as picture:
        picture.load()
        assert picture.format == "PNG"
        assert picture.mode == "L"
        return np.asarray(picture)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("case")
    names = write_previews(folder, phantom=phantom(), compressed=phantom(), stack=stack(), volume=volume())
    return folder, names


def test_all_pictures_are_there(written):
    folder, names = written
    expected = {"phantom", "compressed", "projections", "volume", "volume_slices"}
    expected |= {f"projection_{k:02d}" for k in range(1, 8)}
    assert set(names) == {f"preview/{name}.png" for name in expected}
    assert {f"preview/{p.name}" for p in (folder / "preview").iterdir()} == set(names)
    assert write_previews(folder, volume=volume()) == ["preview/volume.png", "preview/volume_slices.png"]


def test_phantom_is_upright(written):
    """Across z: chest wall left, -y on top. Across y, on the right: chest wall left, +z on top."""
    picture = read(written[0] / "preview" / "phantom.png")
    across_z, across_y = picture[:, :40], picture[20:40, 48:88]
    assert across_z[20, 25] == TISSUE_GREY[Tissue.MASS]
    assert across_z[40, 25] == across_z[20, 10] == TISSUE_GREY[Tissue.ADIPOSE]
    assert across_z[5, 5] == across_z[30, 35] == TISSUE_GREY[Tissue.AIR]
    assert across_y[3, 25] == TISSUE_GREY[Tissue.MASS]
    assert across_y[0, 25] == across_y[17, 25] == across_y[3, 5] == TISSUE_GREY[Tissue.ADIPOSE]


def test_projection_is_upright_and_dense_is_bright(written):
    picture = read(written[0] / "preview" / "projection_03.png").astype(int)
    assert picture.shape == (60, 40)
    assert picture[17, 22] > 200
    assert picture[42, 22] < picture[17, 22]
    assert picture[30, 2] > picture[30, 28]
    assert picture[30, 35] == picture[2, 5] == 0


def test_volume_window_shows_the_breast(written):
    picture = read(written[0] / "preview" / "volume.png").astype(int)
    assert picture[17, 22] > 200
    assert 20 < picture[30, 10] < 150
    assert picture[7, 10] == picture[30, 35] == 0


def test_sheets(written):
    assert read(written[0] / "preview" / "projections.png").shape == (30, 5 * 20 + 4 * 8)
    assert read(written[0] / "preview" / "volume_slices.png").shape == (30, 4 * 20 + 3 * 8)


def test_equal_input_gives_equal_bytes(written, tmp_path):
    write_previews(tmp_path, phantom=phantom(), compressed=phantom(), stack=stack(), volume=volume())
    for name in written[1]:
        assert (tmp_path / name).read_bytes() == (written[0] / name).read_bytes()


def test_large_images_are_reduced_and_constant_ones_do_no_harm(tmp_path):
    image_png(np.arange(2100 * 1500, dtype=np.float32).reshape(2100, 1500), tmp_path / "ramp.png")
    ramp = read(tmp_path / "ramp.png")
    assert ramp.shape == (700, 500)
    assert ramp[0, 0] == 0
    assert ramp[-1, -1] == 255
    image_png(np.full((5, 4), 3.0), tmp_path / "flat.png")
    image_png(np.array([[0.0, 1.0, 2.0]]), tmp_path / "window.png", window=(0.0, 2.0))
    np.testing.assert_array_equal(read(tmp_path / "window.png"), [[0, 128, 255]])
    phantom_png(np.full((3000, 10), Tissue.GLAND, np.uint8), tmp_path / "label.png")
    assert np.all(read(tmp_path / "label.png") == TISSUE_GREY[Tissue.GLAND])


@pytest.mark.parametrize("factor", [1, 2, 3, 5])
def test_whole_numbers_have_the_same_means_as_floats(factor):
    image = np.random.default_rng(factor).integers(0, 65536, (31, 47), dtype=np.uint16)
    np.testing.assert_array_equal(preview._reduced(image, factor), preview._reduced(image.astype(np.float32), factor))


def test_one_view_and_one_slice(tmp_path):
    one = volume()
    thin = Volume(one.data[:1].copy(), Grid((1, 60, 40), (1.0, 1.0, 1.0), (0.0, -30.0, 20.0)), 1e-5, -0.2)
    names = write_previews(tmp_path, stack=stack(views=1), volume=thin)
    assert names == [
        "preview/projection_01.png",
        "preview/projections.png",
        "preview/volume.png",
        "preview/volume_slices.png",
    ]


def test_every_tissue_has_a_grey_value_of_its_own():
    assert set(TISSUE_GREY) == set(Tissue)
    assert len(set(TISSUE_GREY.values())) == len(Tissue)
