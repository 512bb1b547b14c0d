"""A chest wall that is fixed altogether: a force that does not hang on the mesh needs plates with an edge."""

from __future__ import annotations

from collections.abc import Iterator

from bench.support.bodies import C_CUP, ONE_TISSUE
from bench.verification.check import Check, at_least, relative
from bench.verification.exact import MATERIAL
from simcore.fem import CompressionSpec, compress
from simcore.fem.laws.veronda_westmann import VerondaWestmann
from simcore.mesh.structured import half_ellipsoid

SPEC = CompressionSpec(percent=50.0, material=MATERIAL, chest_wall="fixed")
STIFFENING = SPEC.with_(percent=55.0, material=VerondaWestmann(youngs_modulus_kPa=20.0, exponent=2.0))
NONE_MM = 1.0
"""An edge narrower than an element is none."""


def force(spec: CompressionSpec, cells: int) -> float:
    return compress(half_ellipsoid(C_CUP, cells), ONE_TISSUE, spec).force_N


def wall_checks(coarse: int = 12, fine: int = 20) -> Iterator[Check]:
    group, meshes = "Fixed wall", f"{4 * coarse**3} and {4 * fine**3} tetrahedra"
    for name, spec in (("neo-Hookean, 50 %", SPEC), ("Veronda-Westmann, 55 %", STIFFENING)):
        what = f"{name}, edge {spec.plate_edge_mm:g} mm, {meshes}: plate force"
        yield relative(group, what, force(spec, fine), force(spec, coarse), 0.03, "N")
    flat = SPEC.with_(plate_edge_mm=NONE_MM)
    growth = force(flat, fine) / force(flat, coarse)
    yield at_least(group, f"neo-Hookean, 50 %, plates flat up to the wall, {meshes}: force grows", 1.15, growth)
