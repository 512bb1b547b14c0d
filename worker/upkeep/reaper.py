"""The sweep: sends what was never sent or has lost its message, takes back what has lost its worker.

Everything it does is a compare-and-set, so several sweeps at once do no harm.
"""

from __future__ import annotations

import logging

from tomosim_contract.names import SIMULATION_QUEUES, Queue
from worker.messages import Messenger
from worker.records import counters
from worker.records.deliveries import Deliveries
from worker.records.delivery_tables import Delivery
from worker.records.fleet import Fleet
from worker.records.idempotency import Idempotency
from worker.records.jobs import Jobs, Simulation
from worker.records.studies import Studies
from worker.settings import Settings
from worker.upkeep.repeat import Repeated

log = logging.getLogger(__name__)

FORGET_WORKERS_SECONDS = 24 * 3600.0


class Reaper:
    """Runs ``sweep`` every few seconds in a thread of its own."""

    def __init__(
        self,
        settings: Settings,
        jobs: Jobs,
        fleet: Fleet,
        messenger: Messenger,
        deliveries: Deliveries | None = None,
    ) -> None:
        self.settings = settings
        self.jobs = jobs
        self.deliveries = deliveries
        self.fleet = fleet
        self.messenger = messenger
        self.studies = Studies(jobs)
        self.idempotency = Idempotency(jobs.engine, settings.idempotency_seconds)
        self._repeated = Repeated("reaper", self.sweep, settings.sweep_seconds)
        self.start, self.stop = self._repeated.start, self._repeated.stop

    def sweep(self) -> None:
        """One pass. raises: Exception where the database or the broker does not answer"""
        self._revive(self.jobs)
        for queue in SIMULATION_QUEUES:
            self._find_lost(self.jobs, queue)
        if self.deliveries is not None:
            self._revive(self.deliveries)
            self._find_lost(self.deliveries, "delivery")
        self.studies.announce_finished()
        self.fleet.forget(FORGET_WORKERS_SECONDS)
        self.idempotency.forget()

    def _revive(self, leases: Jobs | Deliveries) -> None:
        for identifier in leases.take_back(self.settings.max_attempts):
            log.warning("lease ran out", extra={leases.what: identifier})
            with leases.engine.begin() as connection:
                counters.add(connection, {(counters.LEASE_EXPIRIES, leases.what): 1.0})
        for row in leases.unsent():
            self._send(leases, row)

    def _find_lost(self, leases: Jobs | Deliveries, queue: Queue) -> None:
        lost = leases.sent_to(queue, leases.clock() - self.settings.resend_seconds)
        # Behind a long queue a message waits for hours. It is lost only where the broker has none left there.
        if lost and self.messenger.waiting(queue) == 0:
            for row in lost:
                log.warning("message was lost", extra={leases.what: row.id})
                self._send(leases, row)

    def _send(self, leases: Jobs | Deliveries, row: Simulation | Delivery) -> None:
        self.messenger.send(row.id, row.queue)
        leases.mark_sent(row.id)
