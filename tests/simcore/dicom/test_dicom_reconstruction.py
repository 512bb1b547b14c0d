"""Whoever has the files alone reconstructs the volume that is in them: with a reader that shares no code with us."""

from __future__ import annotations

import ast
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simcore.core.artifacts import ProjectionStack
from simcore.core.geometry import AcquisitionGeometry, Detector
from simcore.reconstruction import reconstruct
from simcore.reconstruction.kinds.fbp import FilteredBackprojection
from tests.support.dicom_case import SmallCase, make_case

from . import independent_reader as reader


def simulated(laterality: str, view: str, encoding: str) -> SmallCase:
    """A ball and noise seen by seven views, reconstructed by the ramp alone."""
    angles = np.linspace(-18.0, 18.0, 7)
    t = np.deg2rad(angles)
    sources = np.stack([0 * t, 600 * np.sin(t), 35.0 + 600 * np.cos(t)], axis=1)
    geometry = AcquisitionGeometry(angles, sources, Detector(61, 40, 0.9), 0 * angles, 35.0, 635.0, 15.0)
    y, x = np.mgrid[-30:31, 0:40].astype(float)
    chord = 2 * np.sqrt(np.maximum(14.0**2 - x**2 - y**2, 0))
    signal = 60000 * np.exp(-0.05 * 0.9 * chord) * np.random.default_rng(2).normal(1, 0.01, (7, 61, 40))
    stack = ProjectionStack(np.rint(np.clip(signal, 1, 65535)).astype(np.uint16), 60000.0, geometry)
    spec = FilteredBackprojection(filter="ramp", slice_thickness_filter=False, slice_mm=4.0)
    case = make_case(laterality=laterality, view=view, encoding=encoding)
    return replace(case, stack=stack, volume=reconstruct(stack, spec, case.compression.thickness))


@pytest.mark.parametrize(
    ("laterality", "view", "encoding"),
    [("L", "CC", "none"), ("R", "CC", "jpeg-ls"), ("L", "MLO", "rle"), ("R", "MLO", "none")],
)
def test_the_volume_again(exported: Callable[[SmallCase], Path], laterality: str, view: str, encoding: str) -> None:
    folder = exported(simulated(laterality, view, encoding))
    written = reader.read_volume(folder / "tomosynthesis.dcm")
    assert written.attenuation.std() > 200 * written.step
    open_field = reader.read_open_field(folder / "projections.dcm")
    for views in (
        reader.read_multi_frame(folder / "projections.dcm"),
        reader.read_single_files(folder / "projections"),
    ):
        again = reader.reconstruct(views, open_field, written)
        # Stored values are rounded; single precision may round another way.
        difference = np.abs(again - written.attenuation) / written.step
        assert difference.max() < 0.75
        assert np.mean(difference <= 0.5) > 0.99


def test_the_reader_shares_no_code() -> None:
    tree = ast.parse(Path(reader.__file__).read_text())
    imported = {
        name.split(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in ([node.module or ""] if isinstance(node, ast.ImportFrom) else [a.name for a in node.names])
    }
    assert imported == {"__future__", "json", "dataclasses", "pathlib", "numpy", "pydicom"}
