"""The Celery worker of the queue ``delivery``: a process of its own, so that no archive can hold up a simulation."""

from __future__ import annotations

from tomosim_contract.names import TASK_DELIVER
from worker.delivery.commitment import Listener
from worker.delivery.sender import Sender
from worker.records.deliveries import Deliveries
from worker.records.fleet import DELIVERY_PREFIX
from worker.settings import Settings
from worker.storage import open_store
from worker.upkeep.queue_worker import QueueWorker


class DeliveryWorker(QueueWorker):
    """The worker that delivers, and takes reports of storage commitment."""

    kind = "tomosim-delivery"
    what = "delivery"
    task = TASK_DELIVER
    prefix = DELIVERY_PREFIX

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings, ["delivery"], settings.delivery_slots)
        deliveries = Deliveries(self.engine, settings.lease_seconds)
        self.sender = Sender(self.name, settings, deliveries, open_store(settings), self.stopping)
        address = settings.commitment_address
        self.listener = Listener(address, self.sender.reports) if address else None

    def carry_out(self, identifier: str) -> None:
        self.sender.run(identifier)

    def end(self) -> None:
        if self.listener is not None:
            self.listener.close()
