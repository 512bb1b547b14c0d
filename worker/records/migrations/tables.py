"""Every file that registers tables, so that importing this one makes ``worker.records.database.metadata`` complete."""

from worker.records import (
    counters,
    database,
    delivery_tables,
    destinations,
    dicom,
    fleet,
    idempotency,
    keys,
    studies,
    webhooks,
)

__all__ = [
    "counters",
    "database",
    "delivery_tables",
    "destinations",
    "dicom",
    "fleet",
    "idempotency",
    "keys",
    "metadata",
    "studies",
    "webhooks",
]

metadata = database.metadata
