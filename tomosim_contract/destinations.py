"""Answers about destinations."""

from __future__ import annotations

from datetime import datetime

from pydantic import BaseModel, Field

from tomosim_contract.destination import Destination


class DestinationResource(Destination):
    """A destination."""

    id: str
    revision: int = Field(description="raised with every change")
    created_at: datetime
    links: dict[str, str]


class DestinationName(BaseModel):
    """What those may see who may deliver and are no administrators."""

    id: str
    name: str


class DestinationList(BaseModel):
    """All destinations, by name."""

    items: list[DestinationResource | DestinationName]


class EchoResource(BaseModel):
    """How a destination answered."""

    reachable: bool = Field(description="whether it accepted the association and answered C-ECHO")
    code: str = Field(description="'ok', or what went wrong: stable, machine-readable")
    message: str
    seconds: float
    accepted: list[str] = Field(description="SOP classes of ours that it accepts")
    refused: list[str] = Field(description="SOP classes of ours that it refuses: those series will not be stored")
