"""The discretised body: what stays the same during a compression."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import TetMesh
from simcore.fem.elements.geometry import Array, shape_gradients
from simcore.fem.elements.linear_strain import assemble_linear_strain
from simcore.fem.elements.membrane import Membrane
from simcore.fem.elements.neo_hookean import assemble_neo_hookean
from simcore.fem.elements.principal import assemble_principal
from simcore.fem.laws.of_elements import ElementLaws
from simcore.kernels import njit
from simcore.simd import aligned

Floats = NDArray[np.float64]


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
        return cls(*_upper_half(tets, node_count))


@njit(cache=True, nogil=True)
def _upper_half(tets: Array, node_count: int) -> tuple[Array, Array, Array]:
    """(row_start, column, block_of) of ``Pattern``."""
    room = np.zeros(node_count + 1, np.int64)
    for e in range(tets.shape[0]):
        for a in range(4):
            room[tets[e, a] + 1] += 4 - a
    for row in range(node_count):
        room[row + 1] += room[row]
    others, count = np.empty(room[-1], np.int32), np.zeros(node_count, np.int64)
    for e in range(tets.shape[0]):
        for a in range(4):
            row = tets[e, a]
            for b in range(a, 4):
                end = room[row] + count[row]
                k = room[row]
                while k < end and others[k] != tets[e, b]:
                    k += 1
                if k == end:
                    others[k] = tets[e, b]
                    count[row] += 1
    row_start = np.zeros(node_count + 1, np.int32)
    for row in range(node_count):
        row_start[row + 1] = row_start[row] + count[row]
    column = np.empty(row_start[-1], np.int32)
    for row in range(node_count):
        for k in range(count[row]):
            place = row_start[row] + k
            while place > row_start[row] and column[place - 1] > others[room[row] + k]:
                column[place] = column[place - 1]
                place -= 1
            column[place] = others[room[row] + k]
    block_of = np.empty((tets.shape[0], 10), np.int32)
    for e in range(tets.shape[0]):
        pair = 0
        for a in range(4):
            for b in range(a, 4):
                k = row_start[tets[e, a]]
                while column[k] != tets[e, b]:
                    k += 1
                block_of[e, pair] = k
                pair += 1
    return row_start, column, block_of


@dataclass(frozen=True, eq=False)
class System:
    """Assembled arrays, overwritten by ``Model.assemble``.

    force: (n, 3) internal force less the dead load, N. node_volume: (n,) deformed volume around the nodes, mm^3.
    blocks: (blocks, 4, 4), float64 or float32, of the upper half of [[K, B], [B^T, 0]]: K = dR_a/du_b (3, 3), the last
    column dR_a/dp_b, the last row dR_b/dp_a.
    """

    force: Floats
    node_volume: Floats
    blocks: NDArray[Any]

    @classmethod
    def empty(cls, node_count: int, block_count: int, *, single: bool = False) -> System:
        """single: blocks in single precision."""
        blocks = aligned.empty(block_count, 4, 4) if single else np.empty((block_count, 4, 4))
        return cls(np.empty((node_count, 3)), np.empty(node_count), blocks)

    @property
    def stiffness(self) -> NDArray[Any]:
        """(blocks, 3, 3), dR_a/du_b, a view."""
        return self.blocks[:, :3, :3]

    @property
    def coupling_upper(self) -> NDArray[Any]:
        """(blocks, 3), dR_a/dp_b, a view."""
        return self.blocks[:, :3, 3]

    @property
    def coupling_lower(self) -> NDArray[Any]:
        """(blocks, 3), dR_b/dp_a, a view."""
        return self.blocks[:, 3, :3]


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

    def system(self, *, single: bool = False) -> System:
        """single: its blocks in single precision."""
        return System.empty(len(self.nodes), len(self.pattern.column), single=single)

    def without_tangent(self) -> System:
        """For forces and volumes alone; in the precision of the solver, whose kernel is compiled."""
        return System.empty(len(self.nodes), 0, single=True)

    def assemble(self, displacement: Floats, pressure: Floats, system: System, *, with_tangent: bool = True) -> float:
        """Forces, volumes and, if asked for, the tangent of a state into ``system``.

        displacement: (n, 3), mm. pressure: (n,), N/mm^2.
        returns: the smallest det F; where it is not positive nothing else is of use.
        """
        body = (displacement, pressure, self.tets, self.gradients, self.volumes)
        rest = (self.pattern.block_of, with_tangent, system.force, system.node_volume, system.blocks)
        laws = self.laws
        if laws.linear is not None:
            smallest = assemble_linear_strain(*body, laws.shear, laws.linear.large, *rest)
        elif laws.neo_hookean:
            smallest = assemble_neo_hookean(*body, laws.shear, *rest)
        else:
            smallest = assemble_principal(*body, laws.numbers, laws.coefficients, laws.fractions, *rest)
        if self.membrane is not None:
            self.membrane.add(displacement, self.nodes, with_tangent, system.force, system.blocks)
        if self.load is not None:
            system.force[:] -= self.load
        return float(smallest)

    def internal_force(self, displacement: Floats, pressure: Floats) -> Floats:
        """Nodal forces of a state less the dead load, (n, 3), N: what plates and chest wall must carry."""
        system = self.without_tangent()
        self.assemble(displacement, pressure, system, with_tangent=False)
        return system.force

    def volume_ratio_of_pressure(self, pressure: Floats) -> tuple[Floats, Floats]:
        """(J, dJ/dp) at the nodes, the inverse of p = kappa U'(J) = kappa/2 (J - 1/J); pressure in N/mm^2, positive
        in tension. Laws of linear strain: 1 + tr(E) with p = kappa tr(E)."""
        t = pressure / self.node_bulk
        if self.laws.linear is not None:
            return 1 + t, 1 / self.node_bulk
        root = np.sqrt(t * t + 1)
        return t + root, (1 + t / root) / self.node_bulk


def _lumped(tets: NDArray[np.int64], values: NDArray[Any], node_count: int) -> Floats:
    """A quarter of each element's value at each of its nodes."""
    return np.bincount(tets.ravel(), np.repeat(values / 4, 4), node_count).astype(np.float64, copy=False)
