"""What the database keeps: tables, repositories, migrations. Knows no other room of the worker."""

from worker.records import ends as ends  # subscribes, before anybody uses a repository
