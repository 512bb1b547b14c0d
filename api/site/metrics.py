"""/metrics: what Prometheus asks for, from the database: the same answer from every process, also after a restart.

To add metrics, write a function of ``Services`` that yields metric families and put ``@collector`` above it.
"""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable, Iterable, Iterator

from fastapi import APIRouter, Request, Response
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.exposition import choose_encoder

from api.http.auth import Read
from api.http.deps import Served, Services
from tomosim_contract.names import QUEUES, STATES
from worker.records import counters

log = logging.getLogger(__name__)

router = APIRouter(tags=["health"])

Collector = Callable[[Services], Iterable[Metric]]

COLLECTORS: list[Collector] = []


def collector(collect: Collector) -> Collector:
    """Adds a function to what /metrics answers."""
    COLLECTORS.append(collect)
    return collect


@router.get("/metrics", response_class=Response, responses={200: {"content": {"text/plain": {}}}})
def metrics(caller: Read, served: Served, request: Request) -> Response:
    """Counts and times in the text format of Prometheus."""
    encode, media_type = choose_encoder(request.headers.get("accept", ""))
    return Response(encode(_Everything(served)), headers={"Content-Type": media_type, "Cache-Control": "no-store"})


class _Everything:
    """What a registry of prometheus_client is to its encoders."""

    def __init__(self, served: Services) -> None:
        self.served = served

    def collect(self) -> Iterator[Metric]:
        failed = GaugeMetricFamily("tomosim_collector_failed", "1 where metrics are missing.", labels=["collector"])
        for collect in COLLECTORS:
            try:
                families = list(collect(self.served))
            except Exception:
                log.exception("metrics are missing", extra={"collector": collect.__name__})
                families = []
                failed.add_metric([collect.__name__], 1)
            else:
                failed.add_metric([collect.__name__], 0)
            yield from families
        yield failed


@collector
def simulations(served: Services) -> Iterator[Metric]:
    """Cases by state now, and ended ones ever."""
    yield _by_state("tomosim_simulations", "Simulations by state.", served.jobs.counts())
    yield _counter(served, counters.ENDED, "Simulations that ended, by state; retried ones each time.", "state")
    yield _counter(served, counters.LEASE_EXPIRIES, "Workers that were lost with a case or a delivery.", "kind")


@collector
def deliveries(served: Services) -> Iterator[Metric]:
    """Deliveries by state now, and ended ones ever."""
    yield _by_state("tomosim_deliveries", "Deliveries by state.", served.deliveries.counts())
    yield _counter(served, counters.DELIVERIES_ENDED, "Deliveries that ended; retried ones each time.", "state")


@collector
def queues(served: Services) -> Iterator[Metric]:
    """How many cases wait, and for how long."""
    length = GaugeMetricFamily("tomosim_queued", "Queued simulations.", labels=["queue"])
    age = GaugeMetricFamily("tomosim_queue_age_seconds", "Age of the oldest queued simulation.", labels=["queue"])
    waiting = served.fleet.queues()
    for queue in QUEUES:
        number, seconds = waiting.get(queue, (0, 0.0))
        length.add_metric([queue], number)
        age.add_metric([queue], seconds)
    yield length
    yield age


@collector
def stages(served: Services) -> Iterator[Metric]:
    """Stages of cases that succeeded: computed, taken from the store, and the seconds of those computed."""
    yield _counter(served, counters.STAGES_COMPUTED, "Stages that were computed.", "stage")
    yield _counter(served, counters.STAGES_CACHED, "Stages that were in the store.", "stage")
    yield _counter(served, counters.STAGE_SECONDS, "Seconds of computed stages.", "stage")


@collector
def workers(served: Services) -> Iterator[Metric]:
    """Workers heard of lately."""
    yield GaugeMetricFamily("tomosim_workers", "Workers heard of lately.", served.fleet.alive())


@collector
def disk(served: Services) -> Iterator[Metric]:
    """Space on the disk of the data folder, and the floor under which nothing is taken."""
    settings = served.settings
    free = shutil.disk_usage(settings.data_folder).free
    yield GaugeMetricFamily("tomosim_free_bytes", "Free space on the disk of the data folder.", free)
    yield GaugeMetricFamily("tomosim_min_free_bytes", "Nothing is taken with less free.", settings.min_free_bytes)


def _by_state(name: str, help_text: str, counts: dict[str, int]) -> Metric:
    family = GaugeMetricFamily(name, help_text, labels=["state"])
    for state in STATES:
        family.add_metric([state], counts.get(state, 0))
    return family


def _counter(served: Services, name: str, help_text: str, label: str) -> Metric:
    family = CounterMetricFamily(f"tomosim_{name}", help_text, labels=[label])
    for value, number in counters.values(served.jobs.engine, name).items():
        family.add_metric([value], number)
    return family
