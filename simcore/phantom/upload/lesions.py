"""Lesions of an uploaded label volume: every mass and every calcification that stands alone, and clusters of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.core.components import Components, Extents, slabs
from simcore.core.errors import SpecError
from simcore.core.grid import Grid
from simcore.core.tissues import Tissue

CLUSTER_MM = 5.0
"""Largest distance of the centres of two calcifications that belong together. BI-RADS calls calcifications grouped that
lie within 1 cm; here each has a neighbour within half of that, so that strewn ones do not chain up."""
CLUSTER_COUNT = 3
"""Calcifications that make a cluster, as in evaluations of computer-aided detection (3 within 1 cm^2)."""
MOST = 5000
"""Lesions, with the calcifications of clusters, that are followed one by one."""
LESIONS = (Tissue.MASS, Tissue.CALCIFICATION)


@dataclass(frozen=True)
class Kinds:
    """How many there are of each."""

    masses: int
    clusters: int
    calcifications: int

    def __str__(self) -> str:
        named = (
            (self.masses, "mass", "masses"),
            (self.clusters, "cluster of calcifications", "clusters of calcifications"),
            (self.calcifications, "single calcification", "single calcifications"),
        )
        return ", ".join(f"{n} {one if n == 1 else many}" for n, one, many in named if n)


class Lesions:
    """Slabs of tissues are added in their order along any axis."""

    def __init__(self) -> None:
        self._components = {tissue: Components(corners=True) for tissue in LESIONS}

    def add(self, labels: NDArray[np.uint8]) -> None:
        """Tissues (z, y, x)."""
        for tissue, components in self._components.items():
            components.add(labels == tissue)

    def skip(self, planes: int) -> None:
        """So many planes without a lesion."""
        for components in self._components.values():
            components.skip(planes)

    def extents(self) -> dict[Tissue, Extents]:
        """The connected components of each tissue. raises: SpecError where they are too many to be followed"""
        extents = {tissue: components.extents() for tissue, components in self._components.items()}
        for tissue, components in extents.items():
            if len(components) > MOST:
                name = tissue.name.lower()
                message = (
                    f"{len(components)} separate pieces of {name}; at most {MOST} lesions are followed one by one: "
                    "give these voxels another tissue in the tissue map"
                )
                raise SpecError(
                    f"phantom.tissues: {message}",
                    code="too-many-lesions",
                    problems=[{"field": "phantom.tissues", "value": name, "message": message}],
                )
        return extents


def kinds(extents: dict[Tissue, Extents], spacing: NDArray[np.float64]) -> Kinds:
    """spacing: voxel edges along the axes of the extents, mm."""
    groups = clusters(extents[Tissue.CALCIFICATION].centre * spacing)
    return Kinds(len(extents[Tissue.MASS]), sum(len(g) > 1 for g in groups), sum(len(g) == 1 for g in groups))


def clusters(centres: NDArray[np.float64]) -> list[list[int]]:
    """Numbers of calcifications that belong together, each group by its lowest; a single one where they are fewer than
    CLUSTER_COUNT. centres: float64 (n, 3), mm."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    if not len(centres):
        return []
    pairs = cKDTree(centres).query_pairs(CLUSTER_MM, output_type="ndarray")
    graph = csr_matrix((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(centres),) * 2)
    _, group = connected_components(graph, directed=False)
    sizes = np.bincount(group)
    groups: dict[int, list[int]] = {}
    for k, g in enumerate(group):
        groups.setdefault(int(g) if sizes[g] >= CLUSTER_COUNT else -1 - k, []).append(k)
    return list(groups.values())


def truth(labels: NDArray[np.uint8], grid: Grid) -> tuple[dict[str, Any], ...]:
    """The entries of ``Phantom.truth``: one a lesion, and one a calcification of a cluster ("part_of" it).

    raises: SpecError where they are too many to be followed
    """
    lesions = Lesions()
    for _, slab in slabs(labels):
        lesions.add(slab)
    extents = lesions.extents()
    masses = extents[Tissue.MASS]
    entries = [_entry(f"mass-{k + 1}", "mass", Tissue.MASS, masses, [k], grid) for k in range(len(masses))]
    single = extents[Tissue.CALCIFICATION]
    spacing = np.array(grid.spacing)[::-1]
    numbers = {"cluster": 0, "calcification": 0}
    for group in clusters(single.centre * spacing):
        kind = "cluster" if len(group) > 1 else "calcification"
        numbers[kind] += 1
        name = f"{kind}-{numbers[kind]}"
        entries += list(_calcifications(name, single, group, grid))
    return tuple(entries)


def _calcifications(name: str, single: Extents, group: list[int], grid: Grid) -> Iterable[dict[str, Any]]:
    if len(group) == 1:
        yield _entry(name, "calcification", Tissue.CALCIFICATION, single, group, grid)
        return
    whole = _entry(name, "calcifications", Tissue.CALCIFICATION, single, group, grid)
    yield {**whole, "parts": len(group)}
    for number, k in enumerate(group, start=1):
        part = _entry(f"{name}/{number}", "calcification", Tissue.CALCIFICATION, single, [k], grid)
        yield {**part, "part_of": name}


def _entry(name: str, kind: str, tissue: Tissue, extents: Extents, members: list[int], grid: Grid) -> dict[str, Any]:
    """Of some components together: their common centre of volume and box."""
    spacing = np.array(grid.spacing)
    first, behind = extents.first[members].min(axis=0), extents.behind[members].max(axis=0)
    centre = np.average(extents.centre[members], axis=0, weights=extents.voxels[members])
    return {
        "id": name,
        "kind": kind,
        "centre_mm": [round(float(c), 4) for c in np.array(grid.corner) + (centre[::-1] + 0.5) * spacing],
        "size_mm": [round(float(e), 4) for e in (behind - first)[::-1] * spacing],
        "volume_mm3": float(extents.voxels[members].sum()) * grid.voxel_volume,
        "tissue": tissue.name.lower(),
    }
