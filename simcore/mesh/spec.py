"""What to ask of a mesh."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from simcore.core.advice import where
from simcore.core.spec_base import Spec, quantity

SHORTEST_EDGE_MM = 2.0
SMALLEST_EPSILON = 1e-5


class TetwildMesh(Spec):
    """Tetrahedra by fTetWild from the smoothed outline of the labels. 10 mm gives about 6k tetrahedra for a C cup
    (plate forces within 0.3 %), 5.5 mm about 35k (node positions within 0.04 mm). Not bit-reproducible: the mesh is
    stored, and its digest feeds what follows."""

    kind: Literal["tetwild"] = "tetwild"
    edge_length_mm: float = quantity(
        "wanted edge length for a breast of 700 ml; scaled with the cube root of the volume, so that every size gets "
        "the same number of tetrahedra",
        unit="mm",
        default=5.5,
        ge=SHORTEST_EDGE_MM,
        le=40.0,
    )
    epsilon: float = quantity(
        "largest distance of the mesh surface from the outline, relative to the diagonal of the bounding box",
        unit="1",
        default=1e-3,
        ge=SMALLEST_EPSILON,
        le=1e-2,
    )
    border_refinement: float = quantity(
        "edges at the borders between gland and fat and near the skin are this many times shorter; 1 is uniform",
        unit="1",
        default=1.0,
        ge=1.0,
        le=4.0,
    )
    time_limit_s: float = quantity(
        "time after which the mesher is stopped and the case fails; outlines with edges and flat sides, which no "
        "breast has, can take it minutes; changes no mesh",
        unit="s",
        default=1800.0,
        ge=1.0,
        le=86400.0,
    )

    @classmethod
    def example(cls) -> TetwildMesh:
        return cls()

    def parameters(self) -> dict[str, Any]:
        """What the mesh depends on."""
        return self.model_dump(exclude={"time_limit_s"})

    def finer(self) -> tuple[str | None, ...]:
        """Remedies for a mesh that follows its outline too loosely, of those that are left."""
        return (
            where(self.edge_length_mm > SHORTEST_EDGE_MM, f"an edge_length_mm below {self.edge_length_mm:g}"),
            where(self.epsilon > SMALLEST_EPSILON, f"an epsilon below {self.epsilon:g}"),
            "mesh.kind = 'lattice'",
        )


class LatticeMesh(Spec):
    """Tetrahedra of a body-centred cubic lattice, cut at the smoothed outline of the labels (isosurface stuffing).
    Bit-reproducible for any number of threads, in a fraction of a second; the smallest dihedral angle is above 10
    degrees. Uniform: elements are as large inside as at the surface. 5.5 mm gives about 35k tetrahedra."""

    kind: Literal["lattice"] = "lattice"
    edge_length_mm: float = quantity(
        "mean edge length for a breast of 700 ml; scaled with the cube root of the volume, so that every size gets "
        "the same number of tetrahedra",
        unit="mm",
        default=5.5,
        ge=SHORTEST_EDGE_MM,
        le=20.0,
    )

    @classmethod
    def example(cls) -> LatticeMesh:
        return cls()

    def parameters(self) -> dict[str, Any]:
        """What the mesh depends on."""
        return self.model_dump()

    def finer(self) -> tuple[str | None, ...]:
        """Remedies for a mesh that follows its outline too loosely, of those that are left."""
        return (
            where(self.edge_length_mm > SHORTEST_EDGE_MM, f"an edge_length_mm below {self.edge_length_mm:g}"),
            "mesh.kind = 'tetwild' (not with reproducible)",
        )


def _with_kind(data: Any) -> Any:
    """Specifications written when there was one mesher name no kind."""
    return {"kind": "tetwild", **data} if isinstance(data, dict) else data


MeshSpec = Annotated[
    TetwildMesh | LatticeMesh,
    Field(discriminator="kind", description="how the breast is meshed"),
    BeforeValidator(_with_kind),
]
"""Union by ``kind``: a new mesher is one file and one more member here."""
