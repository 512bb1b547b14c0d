"""Names that the API, the worker and clients agree on. Light: imports nothing but the standard library."""

from __future__ import annotations

from typing import Any, Literal, get_args

State = Literal["queued", "running", "cancelling", "succeeded", "failed", "cancelled"]
"""queued -> running -> succeeded | failed; queued | running -> (cancelling ->) cancelled."""

STATES: tuple[State, ...] = get_args(State)
FINAL_STATES: tuple[State, ...] = ("succeeded", "failed", "cancelled")
ACTIVE_STATES: tuple[State, ...] = ("running", "cancelling")

TASK_SIMULATE = "tomosim.simulate"
"""Name of the Celery task; its one argument is the identifier of a simulation."""

TASK_DELIVER = "tomosim.deliver"
"""As above; its argument is the identifier of a delivery."""

Queue = Literal["interactive", "delivery", "batch", "gpu.interactive", "gpu.batch"]
QUEUES: tuple[Queue, ...] = get_args(Queue)
"""In the order in which a worker looks into those that it serves."""

SIMULATION_QUEUES: tuple[Queue, ...] = tuple(name for name in QUEUES if name != "delivery")
DEFAULT_QUEUE: Queue = "interactive"

Priority = Literal["interactive", "batch"]
Device = Literal["cpu", "gpu"]


def queue_of(priority: Priority, device: Device = "cpu") -> Queue:
    """The queue of a case."""
    if device == "gpu":
        return "gpu.batch" if priority == "batch" else "gpu.interactive"
    return priority


Scope = Literal["read", "write", "deliver", "admin"]
"""What an API key may do. read: look and download; write: cases, studies, phantoms, webhooks; deliver: send to a
destination; admin: everything."""

SCOPES: tuple[Scope, ...] = get_args(Scope)

WebhookEvent = Literal[
    "simulation.succeeded",
    "simulation.failed",
    "simulation.cancelled",
    "study.finished",
    "delivery.finished",
    "webhook.test",
]
"""What webhooks are told of."""

MessageState = Literal["pending", "delivered", "failed"]
"""Of a message to a webhook."""

StudyState = Literal["queued", "running", "cancelling", "succeeded", "partial", "failed", "cancelled"]
"""Follows from the states of the cases; partial: some succeeded and some did not."""

STUDY_STATES: tuple[StudyState, ...] = get_args(StudyState)

InstanceState = Literal["waiting", "stored", "failed"]
"""Of a file on its way to a destination."""

EVENT_STATE = "state"
EVENT_PROGRESS = "progress"

# Codes of failures that the service itself reports; the others come from simcore.core.errors.
COMPUTE_CRASHED = "compute-crashed"
OUT_OF_MEMORY = "out-of-memory"
TIMEOUT = "timeout"
WORKER_LOST = "worker-lost"
INTERNAL_ERROR = "internal-error"


def failure(code: str, message: str, kind: str = "system") -> dict[str, Any]:
    """Why a case or a delivery failed, as its row keeps it."""
    return {"kind": kind, "code": code, "message": message}


def internal_failure(error: Exception) -> dict[str, Any]:
    """The same of an error that nobody expected."""
    text = f"{type(error).__name__}: {error} (a mistake in tomosim; the worker's log has the details)"
    return failure(INTERNAL_ERROR, text)
