"""Schemathesis against the whole service."""
