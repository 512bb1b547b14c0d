"""Answers about presets, schemas and limits."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel


class PresetResource(BaseModel):
    """A ready specification."""

    name: str
    description: str
    href: str
    specification: dict[str, Any] | None = None


class Listing(BaseModel):
    """Things with names."""

    items: list[dict[str, str]]


class PresetList(BaseModel):
    """All presets, without their specifications."""

    items: list[PresetResource]


class Limits(BaseModel):
    """What is refused beyond."""

    memory_bytes: int
    body_bytes: int
    upload_bytes: int
    seconds: float
    attempts: int
    study_cases: int


class ServiceInfo(BaseModel):
    """What answers here."""

    name: str
    version: str
    api_version: str
    states: list[str]
    queues: list[str]
    limits: Limits
    threads_per_case: int
    links: dict[str, str]
