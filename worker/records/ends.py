"""What the end of a case, a delivery or a study means to everything else, and its second beginning.

The repositories know none of this: they call what is subscribed at the end of this file, in the transaction that
changes the row.
"""

from __future__ import annotations

from collections import defaultdict
from functools import partial
from typing import cast

import sqlalchemy as sa

from tomosim_contract.names import WebhookEvent
from worker.records import counters, retention, webhooks
from worker.records.database import simulations
from worker.records.deliveries import Deliveries
from worker.records.delivery_tables import Delivery
from worker.records.jobs import Jobs, Simulation
from worker.records.rows import Json
from worker.records.studies import Studies, Study, studies


def _keep_files(jobs: Jobs, connection: sa.Connection, rows: list[Simulation]) -> None:
    """From now on it is known how long the files are kept."""
    for row in {row.study_id or row.id: row for row in rows}.values():
        retention.set_expiry(connection, row, jobs.clock())


def _deliver(jobs: Jobs, connection: sa.Connection, rows: list[Simulation]) -> None:
    """The deliveries that were asked for with a case begin with its success."""
    repository = Deliveries(jobs.engine, jobs.lease_seconds, jobs.clock)
    c = simulations.c
    for row in rows:
        if row.state == "succeeded":
            deliver, manifest = connection.execute(sa.select(c.deliver, c.manifest).where(c.id == row.id)).one()
            for request in deliver or ():
                repository.insert_automatic(connection, row.id, request, manifest)


def _tell_of_cases(jobs: Jobs, connection: sa.Connection, rows: list[Simulation]) -> None:
    event = cast(WebhookEvent, f"simulation.{rows[0].state}")
    webhooks.announce(connection, jobs.clock(), event, *(partial(_case, row) for row in rows))


def _count_cases(jobs: Jobs, connection: sa.Connection, rows: list[Simulation]) -> None:
    state = rows[0].state
    counts: defaultdict[tuple[str, str], float] = defaultdict(float, {(counters.ENDED, state): float(len(rows))})
    if state == "succeeded":
        for row in rows:
            manifest = connection.scalar(sa.select(simulations.c.manifest).where(simulations.c.id == row.id))
            for stage in (manifest or {}).get("stages", ()):
                name = str(stage.get("name"))[:64]
                if stage.get("cached"):
                    counts[counters.STAGES_CACHED, name] += 1
                else:
                    counts[counters.STAGES_COMPUTED, name] += 1
                    counts[counters.STAGE_SECONDS, name] += stage.get("seconds", 0.0)
    counters.add(connection, counts)


def _study_goes_on(jobs: Jobs, connection: sa.Connection, row: Simulation) -> None:
    """The end of the study of a case that is retried is told once more."""
    if row.study_id is not None:
        connection.execute(studies.update().where(studies.c.id == row.study_id).values(announced=None))


def _tell_of_deliveries(deliveries: Deliveries, connection: sa.Connection, rows: list[Delivery]) -> None:
    webhooks.announce(connection, deliveries.clock(), "delivery.finished", *(partial(_delivery, row) for row in rows))


def _count_deliveries(deliveries: Deliveries, connection: sa.Connection, rows: list[Delivery]) -> None:
    counters.add(connection, {(counters.DELIVERIES_ENDED, rows[0].state): float(len(rows))})


def _keep_files_of_study(repository: Studies, connection: sa.Connection, study: Study) -> None:
    retention.set_study_expiry(connection, study.id, repository.jobs.clock())


def _tell_of_study(repository: Studies, connection: sa.Connection, study: Study) -> None:
    webhooks.announce(connection, repository.jobs.clock(), "study.finished", partial(_study, study))


def _case(row: Simulation) -> Json:
    """What a webhook is told of a case that ended."""
    names = ("id", "name", "state", "attempt", "results", "error")
    return {**{name: getattr(row, name) for name in names}, "href": f"/v1/simulations/{row.id}"}


def _delivery(row: Delivery) -> Json:
    """What a webhook is told of a delivery that ended."""
    names = ["id", "state", "destination_id", "destination_name", "simulation_id", "study_id"]
    names += ["instances", "instances_stored", "instances_failed", "error"]
    return {**{name: getattr(row, name) for name in names}, "href": f"/v1/deliveries/{row.id}"}


def _study(study: Study) -> Json:
    """What a webhook is told of a study that ended."""
    names = ("id", "name", "state", "cases", "counts")
    return {**{name: getattr(study, name) for name in names}, "href": f"/v1/studies/{study.id}"}


# Counters come last: whoever counts the same waits from then on for the end of the transaction.
Jobs.on_end = (_keep_files, _deliver, _tell_of_cases, _count_cases)
Jobs.on_retry = (_study_goes_on,)
Deliveries.on_end = (_tell_of_deliveries, _count_deliveries)
Studies.on_end = (_keep_files_of_study, _tell_of_study)
