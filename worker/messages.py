"""Giving messages to the broker, and the Celery application of those who take them."""

from __future__ import annotations

from typing import Any, Protocol

from celery import Celery

from tomosim_contract.names import DEFAULT_QUEUE, TASK_DELIVER, TASK_SIMULATE, Queue
from worker.settings import Settings

CONNECT_SECONDS = 2.0


class Messenger(Protocol):
    """What sends the messages of simulations and deliveries."""

    def send(self, identifier: str, queue: Queue = DEFAULT_QUEUE) -> None:
        """Sends a message for a simulation, or on the queue ``delivery`` for a delivery.

        raises: Exception where the broker does not take it
        """

    def waiting(self, queue: Queue) -> int:
        """Messages of a queue that no worker has taken yet. raises: Exception where the broker does not answer"""

    def ping(self) -> None:
        """raises: Exception where the broker does not answer"""


def create_celery(settings: Settings) -> Celery:
    """The Celery application, without its task: enough for sending."""
    app = Celery("tomosim", broker=settings.resolved_broker_url, set_as_current=False)
    app.conf.update(
        task_ignore_result=True,
        task_serializer="json",
        accept_content=["json"],
        task_acks_late=True,
        task_reject_on_worker_lost=True,
        worker_prefetch_multiplier=1,
        worker_cancel_long_running_tasks_on_connection_loss=False,
        worker_enable_remote_control=False,
        worker_send_task_events=False,
        worker_hijack_root_logger=False,
        broker_connection_retry_on_startup=True,
        task_default_queue=DEFAULT_QUEUE,
        task_create_missing_queues=True,
        broker_transport_options={
            "visibility_timeout": settings.visibility_timeout,
            # A free slot looks into its queues in their order, not in turn: batches never hold up what somebody waits
            # for, beyond the cases that run already.
            "queue_order_strategy": "priority",
            "socket_connect_timeout": CONNECT_SECONDS,
        },
    )
    return app


class CeleryMessenger:
    """Sends through the broker of the settings; a broker that does not answer is an error within seconds."""

    def __init__(self, settings: Settings) -> None:
        self._app = create_celery(settings)

    def send(self, identifier: str, queue: Queue = DEFAULT_QUEUE) -> None:
        with self._connection() as connection:
            task = TASK_DELIVER if queue == "delivery" else TASK_SIMULATE
            self._app.send_task(task, args=[identifier], queue=queue, connection=connection, retry=False)

    def waiting(self, queue: Queue) -> int:
        with self._connection() as connection:
            return _waiting(connection, queue)

    def ping(self) -> None:
        with self._connection() as connection:
            connection.ensure_connection(max_retries=1, timeout=CONNECT_SECONDS)

    def _connection(self) -> Any:
        return self._app.connection_for_write(connect_timeout=CONNECT_SECONDS)


def _waiting(connection: Any, queue: str) -> int:
    try:
        with connection.channel() as channel:
            return int(channel.queue_declare(queue, passive=True).message_count)
    except connection.channel_errors:
        return 0  # no message was ever sent to it
