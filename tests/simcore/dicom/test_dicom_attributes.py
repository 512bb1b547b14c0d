"""Attributes that readers trip over: where they stand, where they must not, and what they say."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pydicom
import pytest
from pydicom.dataset import Dataset
from skimage.color import lab2rgb, rgb2lab

from simcore.core.artifacts import ProjectionStack
from simcore.core.tissues import Tissue
from tests.support.dicom_case import ALL_EXTRAS, SmallCase, make_case

VIEWS = [("L", "CC"), ("R", "CC"), ("L", "MLO"), ("R", "MLO")]


@pytest.fixture(scope="module")
def folder(exported: Callable[[SmallCase], Path]) -> Path:
    return exported(make_case(lesions=True, extras=ALL_EXTRAS, views=3))


def _voi(dataset: Dataset) -> Dataset:
    shared = dataset.SharedFunctionalGroupsSequence[0]
    group: Dataset = shared.FrameVOILUTSequence[0]
    return group


def test_default_voi_lut_function_is_left_out(folder: Path) -> None:
    """Cornerstone 5 takes the first letter of "LINEAR" and throws; the IHE mammography profile wants it in views."""
    for name in ("tomosynthesis.dcm", "synthetic_2d.dcm", "projections.dcm"):
        voi = _voi(pydicom.dcmread(folder / name, stop_before_pixels=True))
        assert "VOILUTFunction" not in voi
        assert voi.WindowWidth > 0
    for file in (folder / "presentation").glob("*.dcm"):
        assert pydicom.dcmread(file, stop_before_pixels=True).VOILUTFunction == "LINEAR"
    # Not the default, so it has to be said.
    assert _voi(pydicom.dcmread(folder / "attenuation.dcm")).VOILUTFunction == "LINEAR_EXACT"


def test_zero_is_a_signal_in_raw_projections(tmp_path: Path) -> None:
    """The densest tissue of a weak beam; padding is what stands for nothing, the air of views for presentation."""
    case = make_case(views=1, extras=["presentation"])
    data = case.stack.data.copy()
    data[0, 20:40, :30] = 0
    replace(case, stack=ProjectionStack(data, 60000.0, case.stack.geometry)).export(tmp_path)
    raw = pydicom.dcmread(tmp_path / "projections/0001.dcm")
    assert np.count_nonzero(raw.pixel_array == 0) == 600
    assert "PixelPaddingValue" not in raw
    assert "PixelPaddingValue" not in pydicom.dcmread(tmp_path / "projections.dcm")
    view = pydicom.dcmread(tmp_path / "presentation/0001.dcm")
    assert view.PixelPaddingValue == 0
    assert np.all(view.pixel_array[24:44, :30] > 0)  # turned: the chest wall of a left breast at the left


@pytest.mark.parametrize("name", ["labels.dcm", "lesions.dcm"])
def test_segments_have_colours(exported: Callable[[SmallCase], Path], folder: Path, name: str) -> None:
    file = folder / name if name == "lesions.dcm" else exported(make_case()) / name
    segments = [s for s in pydicom.dcmread(file).SegmentSequence if s.SegmentNumber or name == "lesions.dcm"]
    colours = []
    for segment in segments:
        lightness, a, b = (int(v) / 65535 for v in segment.RecommendedDisplayCIELabValue)
        lab = np.array([[[100 * lightness, 255 * a - 128, 255 * b - 128]]])
        # Inside sRGB: a display shows it as it is.
        np.testing.assert_allclose(rgb2lab(lab2rgb(lab)), lab, atol=0.5)
        colours.append(tuple(np.round(255 * lab2rgb(lab)[0, 0]).astype(int)))
    kinds = [s.SegmentedPropertyTypeCodeSequence[0].CodeValue for s in segments]
    assert len(set(colours)) == len(set(kinds)) > 1
    if name == "labels.dcm":
        assert [s.SegmentNumber for s in segments] == list(range(Tissue.ADIPOSE, Tissue.DUCT + 1))


def test_views_are_one_stack(folder: Path) -> None:
    """Weasis before 4.6 splits where the Frame Acquisition Number changes; it may be absent."""
    frames = pydicom.dcmread(folder / "projections.dcm").PerFrameFunctionalGroupsSequence
    content = [frame.FrameContentSequence[0] for frame in frames]
    assert not any("FrameAcquisitionNumber" in c for c in content)
    assert [c.DimensionIndexValues for c in content] == [1, 2, 3]
    assert content[0].FrameLabel == "view 1, tube angle -20.000 degrees"


def test_pixel_spacing_at_the_top_level(folder: Path) -> None:
    for name in ("projections.dcm", "projections/0001.dcm", "presentation/0001.dcm"):
        assert pydicom.dcmread(folder / name, stop_before_pixels=True).ImagerPixelSpacing == [0.85, 0.85]
    shared = pydicom.dcmread(folder / "projections.dcm").SharedFunctionalGroupsSequence[0]
    assert shared.FramePixelDataPropertiesSequence[0].ImagerPixelSpacing == [0.85, 0.85]


STORED = {"LCC": ["A", "L"], "RCC": ["A", "L"], "LMLO": ["A", "HL"], "RMLO": ["A", "FL"]}
HUNG = {"LCC": ["A", "R"], "RCC": ["P", "L"], "LMLO": ["A", "FR"], "RMLO": ["P", "FL"]}


@pytest.mark.parametrize(("laterality", "view"), VIEWS)
def test_orientation_of_stored_and_hung_images(tmp_path: Path, laterality: str, view: str) -> None:
    """As docs/dicom.md says: the rows of a stored LMLO run upwards in the patient, so it shows upside down."""
    make_case(laterality=laterality, view=view, views=1, extras=["presentation"]).export(tmp_path)
    for name in ("projections/0001.dcm", "projections.dcm", "labels.dcm"):
        orientation = pydicom.dcmread(tmp_path / name, stop_before_pixels=True).PatientOrientation
        assert list(orientation) == STORED[laterality + view]
    hung = pydicom.dcmread(tmp_path / "presentation/0001.dcm", stop_before_pixels=True)
    assert list(hung.PatientOrientation) == HUNG[laterality + view]
