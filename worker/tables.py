"""Every file that registers tables, so that importing this one makes ``worker.database.metadata`` complete."""

from worker import database

__all__ = ["database", "metadata"]

metadata = database.metadata
