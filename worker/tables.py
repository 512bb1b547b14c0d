"""Every file that registers tables, so that importing this one makes ``worker.database.metadata`` complete."""

from worker import database, keys, webhooks

__all__ = ["database", "keys", "metadata", "webhooks"]

metadata = database.metadata
