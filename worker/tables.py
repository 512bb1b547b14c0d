"""Every file that registers tables, so that importing this one makes ``worker.database.metadata`` complete."""

from worker import (
    chores,
    counters,
    database,
    deliveries,
    destinations,
    dicom_tables,
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
    "dicom_tables",
    "idempotency",
    "keys",
    "metadata",
    "studies",
    "webhooks",
]

metadata = database.metadata
