"""Published numbers as tables, with their sources in SOURCES.md."""
