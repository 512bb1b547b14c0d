"""Small specifications that between them touch every kind of every part of a specification."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore import presets
from simcore.core.spec_base import Spec
from simcore.core.tissues import Tissue
from simcore.dicom.spec import ExportSpec
from simcore.fem.laws.by_tissue import ByTissue
from simcore.fem.laws.linear_elastic import LinearElastic
from simcore.fem.laws.mooney_rivlin import MooneyRivlin
from simcore.fem.laws.polynomial import Polynomial
from simcore.fem.laws.published import Published
from simcore.fem.laws.veronda_westmann import VerondaWestmann
from simcore.fem.laws.wellman import Wellman
from simcore.fem.spec import ElasticPlates, Gravity, SkinMembrane, SpringPaddle
from simcore.mesh.spec import LatticeMesh
from simcore.phantom.lesions import CalcificationCluster, Mass
from simcore.phantom.spec import DuctSpec, NippleSpec, TextureSpec
from simcore.phantom.upload import registry
from simcore.phantom.upload.reading import RawHeader, Reading
from simcore.projection.spec import AcquisitionSpec, DetectorPoseSpec, PhysicsSpec, SlabSpec, ViewSpec
from simcore.reconstruction.spec import (
    Backprojection,
    FilteredBackprojection,
    MaximumLikelihood,
    RegionSpec,
    Sart,
    Sirt,
)
from simcore.spec import SimulationSpec
from simcore.store.store import Store

TINY = presets.get("tiny")
PLAIN = TINY.with_(mesh=LatticeMesh(edge_length_mm=16.0))
COMPRESSION, ACQUISITION = PLAIN.compression, PLAIN.acquisition
FULL = TINY.phantom.with_(
    texture=TextureSpec(amplitude_mm=1.0),
    nipple=NippleSpec(),
    ducts=DuctSpec(trees=4, generations=3, terminal_diameter_mm=0.8),
    lesions=(
        Mass(size_mm=(8.0, 6.0, 7.0), lobulation=0.2),
        CalcificationCluster(count=6, smallest_mm=1.0, largest_mm=2.0),
    ),
)
TILTED = DetectorPoseSpec(
    origin_mm=[0.0, 4.0, -6.0], row_direction=[0.0, 84 / 85, 13 / 85], column_direction=[1.0, 0.0, 0.0]
)

Make = Callable[[Store], SimulationSpec]


def _grown(spec: SimulationSpec) -> Make:
    return lambda store: spec


def _uploaded(compressed: bool, **changes: object) -> Make:
    """A label volume with axes of its own, put into the store."""
    labels = half_ellipsoid()
    raw = RawHeader(shape=labels.shape, spacing_mm=(1.5, 1.0, 1.2), axes=("-y", "+z", "+x"))
    tissues = {str(int(t)): t.name.lower() for t in (Tissue.AIR, Tissue.ADIPOSE, Tissue.GLAND, Tissue.SKIN)}
    reading = Reading(raw=raw, tissues=tissues, compressed=compressed)

    def make(store: Store) -> SimulationSpec:
        with store.workspace() as folder:
            path = folder / "breast.raw"
            path.write_bytes(labels.tobytes())
            upload = registry.add_received(store, path, path.name, reading)
        return PLAIN.with_(phantom=upload.spec, **changes)

    return make


def half_ellipsoid() -> NDArray[np.uint8]:
    """uint8 (y, z, x) in whole numbers alone: skin around fat around two lumps of gland."""
    y, z, x = np.ogrid[-22:23, -24:25, 0:44]
    y, z, x = (np.broadcast_to(c, (45, 49, 44)).astype(np.int64) for c in (y, z, x))

    def within(a: int, b: int, c: int, middle: tuple[int, int, int] = (0, 0, 0)) -> NDArray[np.bool_]:
        p, q, r = (y - middle[0]) ** 2, (z - middle[1]) ** 2, (x - middle[2]) ** 2
        return np.asarray(p * (b * c) ** 2 + q * (a * c) ** 2 + r * (a * b) ** 2 <= (a * b * c) ** 2)

    labels = np.where(within(21, 23, 42), int(Tissue.SKIN), int(Tissue.AIR))
    labels[within(20, 21, 40)] = int(Tissue.ADIPOSE)
    for lump in (within(9, 8, 13, (4, -3, 14)), within(6, 9, 8, (-8, 5, 20))):
        labels[lump] = int(Tissue.GLAND)
    return np.ascontiguousarray(labels.astype(np.uint8))


CASES: dict[str, Make] = {
    "lattice": _grown(
        PLAIN.with_(
            export=ExportSpec(extra_objects=["presentation", "synthetic-2d", "ct", "attenuation", "report"]),
            reconstruction=FilteredBackprojection(slice_mm=4.0),
        )
    ),
    "tetwild": _grown(
        TINY.with_(
            physics=PhysicsSpec(sampling="trilinear"),
            reconstruction=Sart(slice_mm=4.0, iterations=2, start="fbp", total_variation=1e-4),
            export=ExportSpec(encoding="jpeg-ls"),
        )
    ),
    "turning-detector": _grown(
        PLAIN.with_(
            phantom=FULL,
            compression=COMPRESSION.with_(
                material=ByTissue.example(),
                skin=SkinMembrane(youngs_modulus_kPa=200.0),
                gravity=Gravity(),
            ),
            acquisition=ACQUISITION.with_(detector_range_degrees=6.0, support=SlabSpec(), paddle=SlabSpec()),
            reconstruction=Sirt(slice_mm=4.0, iterations=3, start="backprojection"),
            export=ExportSpec(encoding="rle", view="MLO", extra_objects=["report"]),
        )
    ),
    "trajectory": _grown(
        PLAIN.with_(
            compression=COMPRESSION.with_(material=Published.example(), elastic_plates=ElasticPlates(thickness_mm=3.0)),
            acquisition=AcquisitionSpec(
                trajectory=[
                    ViewSpec(source_mm=[0.0, -150.0, 640.0]),
                    ViewSpec(source_mm=[5.0, 0.0, 660.0]),
                    ViewSpec(source_mm=[0.0, 160.0, 640.0], detector=TILTED),
                ],
                detector=ACQUISITION.detector,
            ),
            physics=PhysicsSpec(attenuation="icru-20keV", rays_per_pixel_edge=2),
            reconstruction=MaximumLikelihood(slice_mm=4.0, iterations=2, views_per_subset=2),
        )
    ),
    "upload": _uploaded(
        False,
        compression=COMPRESSION.with_(material=MooneyRivlin.example(), chest_wall="fixed"),
        reconstruction=Backprojection(slice_mm=4.0, method="shift-and-add", field="breast"),
    ),
    "compressed-upload": _uploaded(
        True,
        mesh=SimulationSpec().mesh,
        compression=SimulationSpec().compression,
        reconstruction=FilteredBackprojection(
            slice_mm=2.0, filter="ramp", detector_edge="extend", region=RegionSpec(y_max_mm=10.0)
        ),
    ),
    "polynomial": _grown(
        PLAIN.with_(
            compression=COMPRESSION.with_(material=Polynomial.example(), friction=0.3),
            reconstruction=FilteredBackprojection(slice_mm=4.0, filter="hamming", breast_edge="flatten"),
        )
    ),
    "exponential": _grown(
        PLAIN.with_(
            compression=COMPRESSION.with_(material=VerondaWestmann.example(), force_N=20.0, percent=60.0),
            reconstruction=Backprojection(slice_mm=4.0),
        )
    ),
    "wellman": _grown(
        PLAIN.with_(
            compression=COMPRESSION.with_(material=Wellman.example(), paddle_angle_degrees=4.0),
            reconstruction=FilteredBackprojection(slice_mm=4.0, filter="none"),
        )
    ),
    "linear": _grown(
        PLAIN.with_(
            compression=COMPRESSION.with_(
                material=LinearElastic.example(), spring_paddle=SpringPaddle(stiffness_Nmm_per_degree=500.0)
            ),
            reconstruction=FilteredBackprojection(slice_mm=4.0, regularisation_mm=2.0),
        )
    ),
}


UNNAMED = "monoenergetic"
"""A kind that specifications did not name while there was no other, and that earlier revisions do not know."""


def brief(value: Any) -> Any:
    """A specification as JSON without what is at its default: the same whatever fields are added later."""
    if isinstance(value, Spec):
        fields = type(value).model_fields.items()
        parts = {
            name: getattr(value, name) for name, f in fields if name == "kind" or getattr(value, name) != f.default
        }
        if parts.get("kind") == UNNAMED:
            del parts["kind"]
        return {name: brief(part) for name, part in parts.items()}
    if isinstance(value, list | tuple):
        return [brief(item) for item in value]
    return value
