"""The discretised body: what stays the same during a compression."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import TetMesh
from simcore.fem.assembly import assemble_neo_hookean
from simcore.fem.element import shape_gradients
from simcore.fem.laws import ElementLaws
from simcore.fem.linear_strain import assemble_linear_strain
from simcore.fem.membrane import Membrane
from simcore.fem.principal import assemble_principal

Floats = NDArray[np.float64]
_UPPER_PAIRS = [(a, b) for a in range(4) for b in range(a, 4)]


@dataclass(frozen=True, eq=False)
class Pattern:
    """Where the blocks of a symmetric matrix stand: the upper half, row by row, the diagonal block first.

    row_start: int32 (n + 1,). column: int32 (blocks,).
    block_of: int32 (m, 10), block of each pair a <= b of corners of a tetrahedron.
    """

    row_start: NDArray[np.int32]
    column: NDArray[np.int32]
    block_of: NDArray[np.int32]

    @classmethod
    def of(cls, tets: NDArray[np.int64], node_count: int) -> Pattern:
        """tets: int64 (m, 4), each row ascending."""
        keys = np.stack([tets[:, a] * node_count + tets[:, b] for a, b in _UPPER_PAIRS], axis=1)
        unique, inverse = np.unique(keys, return_inverse=True)
        per_row = np.bincount(unique // node_count, minlength=node_count)
        return cls(
            row_start=np.concatenate([[0], np.cumsum(per_row)]).astype(np.int32),
            column=(unique % node_count).astype(np.int32),
            block_of=inverse.reshape(-1, len(_UPPER_PAIRS)).astype(np.int32),
        )


@dataclass(frozen=True, eq=False)
class System:
    """Assembled arrays, overwritten by ``Model.assemble``.

    force: (n, 3) internal force less the dead load, N. node_volume: (n,) deformed volume around the nodes, mm^3.
    stiffness: (blocks, 3, 3) dR_a/du_b of the upper half. coupling_upper, coupling_lower: (blocks, 3), dR_a/dp_b and
    dR_b/dp_a.
    """

    force: Floats
    node_volume: Floats
    stiffness: Floats
    coupling_upper: Floats
    coupling_lower: Floats

    @classmethod
    def empty(cls, node_count: int, block_count: int) -> System:
        return cls(
            np.empty((node_count, 3)),
            np.empty(node_count),
            np.empty((block_count, 3, 3)),
            np.empty((block_count, 3)),
            np.empty((block_count, 3)),
        )

    def arrays(self) -> tuple[Floats, ...]:
        return self.force, self.node_volume, self.stiffness, self.coupling_upper, self.coupling_lower


@dataclass(frozen=True, eq=False)
class Model:
    """Linear tetrahedra with a pressure at every node.

    nodes: (n, 3), mm. tets: int64 (m, 4), each row ascending (so of any orientation).
    gradients: (m, 4, 3) of the shape functions, 1/mm. volumes: (m,), mm^3.
    node_volume: (n,), a quarter of the tetrahedra around each node, mm^3.
    node_bulk: (n,) bulk modulus averaged over the same volume, N/mm^2.
    membrane: skin on the surface. load: (n, 3) dead load, N.
    """

    nodes: Floats
    tets: NDArray[np.int64]
    gradients: Floats
    volumes: Floats
    laws: ElementLaws
    node_volume: Floats
    node_bulk: Floats
    pattern: Pattern
    membrane: Membrane | None = None
    load: Floats | None = None

    @classmethod
    def of(
        cls,
        mesh: TetMesh,
        laws: ElementLaws,
        *,
        skin_tension: float = 0.0,
        weight: tuple[float, ...] = (0, 0, 0),
    ) -> Model:
        """skin_tension: thickness times shear modulus of the skin, N/mm. weight: of the tissue, (x, y, z) N/mm^3."""
        count = len(mesh.nodes)
        tets = np.sort(mesh.tets, axis=1)
        gradients, volumes = shape_gradients(mesh.nodes, tets)
        node_volume = _lumped(tets, volumes, count)
        pattern = Pattern.of(tets, count)
        membrane = None
        if skin_tension > 0:
            membrane = Membrane.of(mesh.nodes, mesh.skin, pattern.row_start, pattern.column, skin_tension)
        return cls(
            nodes=mesh.nodes,
            tets=tets,
            gradients=gradients,
            volumes=volumes,
            laws=laws,
            node_volume=node_volume,
            node_bulk=_lumped(tets, volumes * laws.bulk, count) / node_volume,
            pattern=pattern,
            membrane=membrane,
            load=node_volume[:, None] * np.array(weight) if any(weight) else None,
        )

    def system(self) -> System:
        return System.empty(len(self.nodes), len(self.pattern.column))

    def assemble(self, displacement: Floats, pressure: Floats, system: System, *, with_tangent: bool = True) -> float:
        """Forces, volumes and, if asked for, the tangent of a state into ``system``.

        displacement: (n, 3), mm. pressure: (n,), N/mm^2.
        returns: the smallest det F; where it is not positive nothing else is of use.
        """
        body = (displacement, pressure, self.tets, self.gradients, self.volumes)
        rest = (self.pattern.block_of, with_tangent, *system.arrays())
        laws = self.laws
        if laws.linear_strain:
            smallest = assemble_linear_strain(*body, laws.shear, laws.st_venant_kirchhoff, *rest)
        elif laws.neo_hookean:
            smallest = assemble_neo_hookean(*body, laws.shear, *rest)
        else:
            smallest = assemble_principal(*body, laws.kinds, laws.coefficients, laws.fractions, *rest)
        if self.membrane is not None:
            self.membrane.add(displacement, self.nodes, with_tangent, system.force, system.stiffness)
        if self.load is not None:
            system.force[:] -= self.load
        return float(smallest)

    def internal_force(self, displacement: Floats, pressure: Floats) -> Floats:
        """Nodal forces of a state less the dead load, (n, 3), N: what plates and chest wall must carry."""
        system = System.empty(len(self.nodes), 0)
        self.assemble(displacement, pressure, system, with_tangent=False)
        return system.force

    def volume_ratio_of_pressure(self, pressure: Floats) -> tuple[Floats, Floats]:
        """(J, dJ/dp) at the nodes, the inverse of p = kappa U'(J) = kappa/2 (J - 1/J); pressure in N/mm^2, positive
        in tension. Laws of linear strain: 1 + tr(E) with p = kappa tr(E)."""
        t = pressure / self.node_bulk
        if self.laws.linear_strain:
            return 1 + t, 1 / self.node_bulk
        root = np.sqrt(t * t + 1)
        return t + root, (1 + t / root) / self.node_bulk


def _lumped(tets: NDArray[np.int64], values: NDArray[Any], node_count: int) -> Floats:
    """A quarter of each element's value at each of its nodes."""
    return np.bincount(tets.ravel(), np.repeat(values / 4, 4), node_count).astype(np.float64, copy=False)
