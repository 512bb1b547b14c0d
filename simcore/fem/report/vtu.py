"""A compression as a VTK file (.vtu), for ParaView, PyVista, meshio."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshio  # type: ignore[import-untyped,unused-ignore]
import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import Compression, Phantom, TetMesh
from simcore.core.tissues import Tissue
from simcore.fem.laws import MaterialSpec
from simcore.fem.report.fields import Strain, Stress
from simcore.fem.tissues import element_laws, tissue_fractions


def write_mesh(
    path: Path,
    mesh: TetMesh,
    compression: Compression,
    phantom: Phantom | None,
    material: MaterialSpec | None,
) -> None:
    """See simcore.fem.write_vtu."""
    displacement = compression.displacement
    strain = Strain.of(mesh, displacement)
    at_nodes: dict[str, NDArray[Any]] = {"displacement_mm": displacement}
    in_tets: dict[str, NDArray[Any]] = {
        "J": strain.volume_ratio,
        "green_lagrange_strain": strain.green_lagrange.reshape(-1, 9),
    }
    if phantom is not None:
        shares = tissue_fractions(mesh, phantom)
        in_tets["tissue"] = shares.argmax(axis=1)
        in_tets |= {f"fraction_{t.name.lower()}": shares[:, t] for t in Tissue if shares[:, t].any()}
        if material is not None:
            stress = Stress.of(mesh, displacement, element_laws(mesh, phantom, material))
            at_nodes["pressure_kPa"] = stress.pressure
            in_tets["cauchy_stress_kPa"] = stress.cauchy.reshape(-1, 9)
            in_tets["von_mises_stress_kPa"] = stress.von_mises
    meshio.Mesh(
        mesh.nodes,
        [("tetra", mesh.tets)],
        point_data={name: _single(values) for name, values in at_nodes.items()},
        cell_data={name: [_single(values)] for name, values in in_tets.items()},
    ).write(path, file_format="vtu")


def _single(values: NDArray[Any]) -> NDArray[Any]:
    return values.astype(np.uint8 if values.dtype.kind in "iu" else np.float32)
