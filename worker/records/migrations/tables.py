"""Every file that registers tables, so that importing this one makes ``worker.records.database.metadata`` complete."""

from worker.records import (
    chores,
    counters,
    database,
    deliveries,
    destinations,
    dicom,
    idempotency,
    keys,
    studies,
    webhooks,
)

__all__ = [
    "chores",
    "counters",
    "database",
    "deliveries",
    "destinations",
    "dicom",
    "idempotency",
    "keys",
    "metadata",
    "studies",
    "webhooks",
]

metadata = database.metadata
