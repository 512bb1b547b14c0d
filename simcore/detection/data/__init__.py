"""Detectors of named systems, with their sources in SOURCES.md."""
