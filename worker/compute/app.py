"""The Celery worker that simulates: it never imports numba; each slot owns a compute process that does."""

from __future__ import annotations

from celery import Celery

from tomosim_contract.names import TASK_SIMULATE
from worker import logs
from worker.compute.supervisor import Slots
from worker.messages import create_celery
from worker.records.jobs import Jobs
from worker.settings import Settings
from worker.storage import open_store
from worker.upkeep.queue_worker import QueueWorker


class Worker(QueueWorker):
    """The worker of the queues of simulations."""

    kind = "tomosim"
    what = "simulation"
    task = TASK_SIMULATE

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings, settings.queue_names, settings.worker_slots)
        self.slots = Slots(self.name, settings, Jobs(self.engine, settings.lease_seconds), self.stopping)
        open_store(settings).sweep_temporary()

    def carry_out(self, identifier: str) -> None:
        self.slots.run(identifier)

    def warm_up(self) -> None:
        self.slots.warm_up()

    def end(self) -> None:
        self.slots.kill()


def main() -> int:
    """``python -m worker``: a worker with the settings of the environment."""
    settings = Settings.load()
    logs.configure(settings.log_level)
    return Worker(settings).run()


def __getattr__(name: str) -> Celery:
    """``celery -A worker.compute.app ...``: the application is made when first asked for, not at import."""
    if name == "app":
        return create_celery(Settings.load())
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
