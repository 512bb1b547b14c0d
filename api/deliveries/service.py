"""What a posted delivery sends."""

from __future__ import annotations

from api.http.deps import Services
from api.http.errors import ApiError
from api.simulations.artifacts import finished_manifest
from simcore.store.hashing import FileRef
from tomosim_contract.deliveries import NewDelivery
from worker.records.delivery_tables import Item, items_of

CASES_AT_A_TIME = 200


def items_of_study(served: Services, new: NewDelivery) -> list[Item]:
    """The files of all cases that have succeeded. raises: NotFoundError; ApiError 409, 422 where there are none"""
    assert new.study_id is not None
    served.studies.get(new.study_id)
    items: list[Item] = []
    before = None
    while rows := served.jobs.page(CASES_AT_A_TIME, "succeeded", before, new.study_id):
        before = (rows[-1].created, rows[-1].id)
        for row in rows:
            items += items_of(row.id, served.jobs.manifest(row.id) or {}, new.files)
    if not items:
        raise ApiError(409, "not-finished", "no case of the study has succeeded with a file that was asked for")
    return items


def items_of_case(served: Services, new: NewDelivery) -> list[Item]:
    """What a body asks of a case. raises: ApiError 409 not-finished, 410 expired, 422 where it names nothing"""
    assert new.simulation_id is not None
    manifest = finished_manifest(served, new.simulation_id)
    items = items_of(new.simulation_id, manifest, new.files)
    for item in items:
        if not served.store.has(FileRef(item.sha256, item.size)):
            raise ApiError(410, "expired", f"{item.name} is not in the store any more: post the case again")
    if new.series:
        items = _of_series(served, items, new.series)
    if not items:
        names = ", ".join(item.name for item in items_of(new.simulation_id, manifest)) or "no DICOM file"
        detail = f"nothing of the case matches; it has: {names}"
        error = {"pointer": "/series" if new.series else "/files", "value": None, "detail": detail}
        raise ApiError(422, "invalid-request", detail, errors=[error])
    return items


def _of_series(served: Services, items: list[Item], series: list[str]) -> list[Item]:
    """Those of the items that belong to these series. raises: ApiError 422 naming a series that is not there"""
    from worker.delivery.files import read_series

    series_of = {item.name: read_series(served.store.path(FileRef(item.sha256, item.size))) for item in items}
    for name in series:
        if name not in series_of.values():
            known = ", ".join(sorted(set(filter(None, series_of.values()))))
            detail = f"the case has no series {name[:80]!r}; it has: {known}"
            error = {"pointer": f"/series/{series.index(name)}", "value": name[:80], "detail": detail}
            raise ApiError(422, "invalid-request", detail, errors=[error])
    return [item for item in items if series_of[item.name] in series]
