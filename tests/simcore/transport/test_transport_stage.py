"""The stage as a whole: bytes, balances, refusals."""

import numpy as np
import pytest

from bench.scatter.bodies import arc, beam, breast, pmma_plates
from simcore.core.artifacts import Phantom
from simcore.core.errors import GeometryError, SimulationError, SpecError
from simcore.core.tissues import Tissue
from simcore.physics.materials import tissue_sets
from simcore.transport import TransportSpec, monte_carlo, transport
from simcore.transport.stage import by_label

SPECTRUM = beam([12.0, 18.0, 24.0], [0.2, 0.5, 0.3])
TISSUES = tissue_sets()["icru-hammerstein"]
SPEC = TransportSpec(rays_per_view=4000, equivalent_breast_rays_per_view=2000)


def run(phantom, geometry, spec=SPEC, tissues=TISSUES, **more):
    return transport(
        phantom, geometry, spec, spectrum=SPECTRUM, tissues=tissues, plates=pmma_plates(15.0, 40.0), **more
    )


@pytest.fixture(scope="module")
def phantom():
    return breast(40.0, voxel=1.0)


def test_one_and_two_threads_give_the_same_bytes(phantom, threads):
    geometry = arc([-15, -5, 0, 5, 15])
    results = []
    for count in (1, 2):
        threads(count)
        results.append(run(phantom, geometry, seed=5))
    one, two = results
    assert one.scatter.tobytes() == two.scatter.tobytes()
    assert one.scatter_variance.tobytes() == two.scatter_variance.tobytes()
    assert one.report == two.report
    other = run(phantom, geometry, seed=6)
    assert not np.array_equal(one.scatter, other.scatter)


def test_energy_goes_somewhere(phantom):
    report = run(phantom, arc([0, 15])).report
    assert sum(report["energy_shares"].values()) == pytest.approx(1.0, abs=0.01)
    for missing, deviation in zip(report["energy_imbalance"], report["energy_imbalance_standard_error"], strict=True):
        assert abs(missing) < 4 * deviation < 0.05


def test_energy_that_is_lost_is_told(phantom, monkeypatch):
    monkeypatch.setattr(monte_carlo, "LEFT", monte_carlo.SHARED)
    with pytest.raises(SimulationError, match="of the energy that was sent out is neither absorbed nor gone"):
        run(phantom, arc([0]))


def test_no_scatter_where_none_is_asked_for(phantom):
    with_scatter, without = (run(phantom, arc([0]), SPEC.with_(scatter=kind)) for kind in ("monte-carlo", "none"))
    assert with_scatter.scatter.max() > 0
    assert not without.scatter.any()
    assert not without.scatter_variance.any()
    assert without.report["dose"] == with_scatter.report["dose"]


def test_a_tissue_without_composition_is_refused(phantom):
    some = {tissue: substance for tissue, substance in TISSUES.items() if tissue != Tissue.GLAND}
    with pytest.raises(SpecError, match="gland is in the breast, but there is no composition of it"):
        run(phantom, arc([0]), tissues=some)


def test_tissue_behind_the_chest_wall_is_refused(phantom):
    shifted = Phantom(phantom.labels.copy(), phantom.grid.moved(x=-3.0))
    with pytest.raises(GeometryError, match="tissue behind the chest wall, down to x = -3 mm"):
        run(shifted, arc([0]))


def test_a_source_beside_the_breast_is_refused(phantom):
    with pytest.raises(GeometryError, match="view 0: the source stands 50 mm above the detector"):
        run(phantom, arc([0], distance=50.0))


def test_calcifications_are_seen_but_do_not_slow_flights(phantom):
    labels = phantom.labels.copy()
    labels[18:22, 108:112, 40:44] = Tissue.CALCIFICATION
    report = run(Phantom(labels, phantom.grid), arc([0])).report
    assert report["energy_shares"]["calcification"] > 0


def test_dose_of_a_breast_all_gland_is_that_of_its_equivalent(phantom):
    labels = phantom.labels.copy()
    labels[labels == Tissue.ADIPOSE] = Tissue.GLAND
    spec = TransportSpec(rays_per_view=8000, equivalent_breast_rays_per_view=8000)
    dose = run(Phantom(labels, phantom.grid), arc([0]), spec).report["dose"]
    own, equivalent = dose["glandular"], dose["equivalent_breast_glandular"]
    assert own["mean"] == pytest.approx(equivalent["mean"], rel=0.03)
    assert dose["equivalent_breast_glandularity"] == 1.0


def test_tissues_that_are_not_there_do_not_slow_flights(phantom):
    """Calcifications among the materials, with none in the breast, made the time five times as long."""
    substances = by_label(phantom, TISSUES)
    assert [Tissue(label) for label, one in enumerate(substances) if one] == [Tissue.ADIPOSE, Tissue.GLAND, Tissue.SKIN]
