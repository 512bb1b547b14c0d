"""Where a breast would roll aside, against the eigenvalues of the whole tangent in double precision."""

from __future__ import annotations

import numpy as np
import pytest

from simcore.core.artifacts import Phantom, TetMesh
from simcore.core.grid import Grid
from simcore.fem import CompressionSpec, compress
from simcore.fem.compression import press_of, solver_of, target_of
from simcore.fem.newton.outcome import CompressionFailed
from simcore.fem.newton.path import follow
from simcore.fem.newton.solver import Solver
from simcore.fem.plates.constraints import Constraints
from simcore.fem.plates.contact import Contact
from simcore.mesh.structured import half_ellipsoid

ANY_PHANTOM = Phantom(np.ones((1, 1, 1), np.uint8), Grid((1, 1, 1), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)))


@pytest.fixture(scope="module")
def tall() -> TetMesh:
    """120 mm high, 50 mm wide."""
    return half_ellipsoid((60.0, 25.0, 70.0, 50.0), 6)


def smallest_eigenvalue(mesh: TetMesh, percent: float, monkeypatch: pytest.MonkeyPatch) -> float:
    """Of the tangent with the pressure condensed, in the directions that supports, plates and the guard leave, at an
    equilibrium that nobody asks whether it is stable, N/mm."""
    spec = CompressionSpec(percent=percent)
    solver = solver_of(mesh, ANY_PHANTOM, spec)
    contact = Contact.none(mesh.skin, len(mesh.nodes)).holding(mesh.wall)
    with monkeypatch.context() as patch:
        patch.setattr(Solver, "_refuse_instability", lambda *_: None)
        state = follow(solver, contact, target_of(spec, float(np.ptp(mesh.nodes[:, 2]))), press=press_of(spec)).state
    assert state.plates is not None
    model, n = solver.model, len(mesh.nodes)
    system = model.system()
    model.assemble(state.displacement, state.pressure, system)
    stiffness, coupling = np.zeros((n, 3, n, 3)), np.zeros((n, 3, n))
    row = np.repeat(np.arange(n), np.diff(model.pattern.row_start))
    for k, (a, b) in enumerate(zip(row, model.pattern.column, strict=True)):
        stiffness[a, :, b], stiffness[b, :, a] = system.stiffness[k], system.stiffness[k].T
        coupling[a, :, b], coupling[b, :, a] = system.coupling_upper[k], system.coupling_lower[k]
    compliance = 1 / (model.node_volume * model.volume_ratio_of_pressure(state.pressure)[1])
    flat = coupling.reshape(3 * n, n)
    condensed = stiffness.reshape(3 * n, 3 * n) + flat * compliance @ flat.T
    free = Constraints.of(solver.fixed, state.contact, state.plates).free.ravel()
    guard = np.zeros((3 * n, solver.guard.vectors.shape[1]))
    guard[3 * solver.guard.nodes + 1] = solver.guard.vectors
    kept = np.linalg.svd(guard[free])[0][:, guard.shape[1] :]
    return float(np.linalg.eigvalsh(kept.T @ condensed[np.ix_(free, free)] @ kept)[0])


def test_it_is_refused_where_an_eigenvalue_turns_negative(tall: TetMesh, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(CompressionFailed, match="buckle") as error:
        compress(tall, ANY_PHANTOM, CompressionSpec(percent=40.0))
    last = error.value.percent
    assert smallest_eigenvalue(tall, last, monkeypatch) > 0
    assert smallest_eigenvalue(tall, last + 0.6, monkeypatch) < 0


def test_a_cup_c_is_stable_at_70_percent(monkeypatch: pytest.MonkeyPatch) -> None:
    cup = half_ellipsoid((92.1, 60.2, 67.3, 53.1), 6)
    assert smallest_eigenvalue(cup, 70.0, monkeypatch) > 5e-3
    assert compress(cup, ANY_PHANTOM, CompressionSpec(percent=70.0)).outcome == "converged"
