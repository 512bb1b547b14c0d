"""Boundary value problems without plates on the assembled tangent of the solver, with direct linear solution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_matrix, coo_matrix, csc_matrix
from scipy.sparse.linalg import splu

from bench.support.bodies import Floats
from simcore.fem.elements.model import Model, System

_MAX_NEWTON = 30


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """displacement: (n, 3), mm. pressure: (n,), N/mm^2. reaction: (n, 3), N, internal less external forces."""

    displacement: Floats
    pressure: Floats
    reaction: Floats


def equilibrium(
    model: Model,
    fixed: NDArray[np.bool_],
    prescribed: Floats,
    load: Floats | None = None,
    *,
    start: Floats | None = None,
    load_steps: int = 1,
    tolerance: float = 1e-9,
) -> Equilibrium:
    """Newton's method.

    fixed: bool (n, 3). prescribed: (n, 3), displacement where fixed, mm. load: (n, 3) dead nodal forces, N.
    tolerance: residual forces relative to the largest nodal force, and volumes relative to their own.
    raises: RuntimeError where it does not converge or an element turns over
    """
    n = len(model.nodes)
    u = np.zeros((n, 3)) if start is None else start.copy()
    p = np.zeros(n)
    load = np.zeros((n, 3)) if load is None else load
    system = model.system()
    free = np.concatenate([~fixed.ravel(), np.ones(n, dtype=bool)])
    for share in np.linspace(0, 1, load_steps + 1)[1:]:
        for iteration in range(_MAX_NEWTON):
            residual, tangent = residual_and_tangent(model, u, p, system)
            scale = max(np.abs(residual[: 3 * n]).max(), np.abs(load).max())
            residual[: 3 * n] -= share * load.ravel()
            step = np.concatenate([np.where(fixed, share * prescribed - u, 0.0).ravel(), np.zeros(n)])
            unbalanced = np.abs(residual[: 3 * n][~fixed.ravel()]).max(initial=0.0)
            mismatch = np.abs(residual[3 * n :] / model.node_volume).max()
            if iteration > 0 and unbalanced < tolerance * scale and mismatch < tolerance and not step.any():
                break
            rhs = -(residual + tangent @ step)
            step[free] = splu(tangent[free][:, free]).solve(rhs[free])
            u, p = u + step[: 3 * n].reshape(n, 3), p + step[3 * n :]
            u[fixed] = (share * prescribed)[fixed]
        else:
            raise RuntimeError(f"no convergence in {_MAX_NEWTON} iterations")
    return Equilibrium(u, p, residual[: 3 * n].reshape(n, 3))


def residual_and_tangent(model: Model, u: Floats, p: Floats, system: System) -> tuple[Floats, csc_matrix]:
    """(internal forces then volume residuals (4 n,), [[K, B], [B^T, -V dJ/dp]] (4 n, 4 n)). raises: RuntimeError"""
    if not model.assemble(u, p, system) > 0:
        raise RuntimeError("an element has turned inside out")
    ratio, compliance = model.volume_ratio_of_pressure(p)
    volume = system.node_volume - model.node_volume * ratio
    n, pattern = len(p), model.pattern
    row, column = np.repeat(np.arange(n), np.diff(pattern.row_start)), pattern.column.astype(np.int64)
    mirrored = row != column
    blocks = np.zeros((len(row), 4, 4))
    blocks[:, :3, :3] = system.stiffness
    blocks[:, :3, 3] = system.coupling_upper
    blocks[:, 3, :3] = system.coupling_lower
    blocks[~mirrored, 3, 3] = -model.node_volume * compliance
    rows = np.concatenate([row, column[mirrored]])
    columns = np.concatenate([column, row[mirrored]])
    values = np.concatenate([blocks, blocks[mirrored].transpose(0, 2, 1)])
    order = coo_matrix((np.arange(1, len(rows) + 1), (rows, columns)), shape=(n, n)).tocsr()
    interleaved = bsr_matrix((values[order.data - 1], order.indices, order.indptr), shape=(4 * n, 4 * n))
    split = np.concatenate([np.arange(4 * n).reshape(n, 4)[:, :3].ravel(), np.arange(4 * n)[3::4]])
    tangent = interleaved.tocsr()[split][:, split].tocsc()
    return np.concatenate([system.force.ravel(), volume]), tangent
