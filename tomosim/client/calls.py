"""Every request the client can send, as data: what both clients share."""

from __future__ import annotations

import json
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar
from urllib.parse import quote

import httpx
from pydantic import BaseModel

from api.catalog_resources import PresetList, PresetResource, ServiceInfo
from api.phantom_resources import PhantomList, PhantomResource
from api.resources import ArtifactList, SimulationPage, SimulationResource
from api.webhook_resources import CreatedWebhook, MessagePage, MessageResource, NewWebhook, WebhookList, WebhookResource
from simcore.estimate import Estimate
from simcore.phantom.upload.reading import Reading
from simcore.spec import SimulationSpec

T = TypeVar("T")
M = TypeVar("M", bound=BaseModel)

Json = dict[str, Any]

Specification = SimulationSpec | Mapping[str, Any]


@dataclass(frozen=True)
class Call(Generic[T]):
    """A request and how its answer is read.

    repeatable: whether it may be sent again where the connection was lost and nobody knows whether it arrived.
    """

    method: str
    path: str
    parse: Callable[[httpx.Response], T]
    params: Json = field(default_factory=dict)
    json: Any = None
    headers: dict[str, str] = field(default_factory=dict)
    repeatable: bool = True


def _model(model: type[M]) -> Callable[[httpx.Response], M]:
    return lambda response: model.model_validate_json(response.content)


def _nothing(response: httpx.Response) -> None:
    return None


def _get(path: str, model: type[M], **params: Any) -> Call[M]:
    return Call("GET", path, _model(model), {name: value for name, value in params.items() if value is not None})


def _create(path: str, model: type[M], body: Any, key: str | None) -> Call[M]:
    """A POST that makes something: with a key, so that it makes it once however often it is sent."""
    headers = {"Idempotency-Key": key or uuid.uuid4().hex}
    return Call("POST", path, _model(model), json=body, headers=headers)


def _act(path: str, model: type[M], *, repeatable: bool = False) -> Call[M]:
    return Call("POST", path, _model(model), repeatable=repeatable)


def _part(text: str) -> str:
    return quote(text, safe="")


def _json(specification: Specification) -> Any:
    return specification.model_dump(mode="json") if isinstance(specification, SimulationSpec) else dict(specification)


# Simulations


def submit(specification: Specification, key: str | None = None) -> Call[SimulationResource]:
    return _create("/v1/simulations", SimulationResource, _json(specification), key)


def estimate(specification: Specification) -> Call[Estimate]:
    return Call("POST", "/v1/simulations/estimate", _model(Estimate), json=_json(specification))


def simulation(identifier: str) -> Call[SimulationResource]:
    return _get(f"/v1/simulations/{_part(identifier)}", SimulationResource)


def simulations(state: str | None, limit: int, cursor: str | None) -> Call[SimulationPage]:
    return _get("/v1/simulations", SimulationPage, state=state, limit=limit, cursor=cursor)


def cancel(identifier: str) -> Call[SimulationResource]:
    return _act(f"/v1/simulations/{_part(identifier)}/cancel", SimulationResource, repeatable=True)


def retry(identifier: str) -> Call[SimulationResource]:
    return _act(f"/v1/simulations/{_part(identifier)}/retry", SimulationResource)


def delete(identifier: str) -> Call[None]:
    return Call("DELETE", f"/v1/simulations/{_part(identifier)}", _nothing)


def artifacts(identifier: str) -> Call[ArtifactList]:
    return _get(f"/v1/simulations/{_part(identifier)}/artifacts", ArtifactList)


def manifest(identifier: str) -> Call[Json]:
    return Call("GET", f"/v1/simulations/{_part(identifier)}/manifest", lambda response: response.json())


# Phantoms


def upload(name: str, reading: Reading | Mapping[str, Any] | None, size: int | None) -> Call[PhantomResource]:
    """Without the content, which is the client's; the same content makes the same phantom, however often it comes."""
    params = {"name": name}
    if reading is not None:
        params["reading"] = reading.model_dump_json() if isinstance(reading, Reading) else json.dumps(dict(reading))
    headers = {"Content-Type": "application/octet-stream"}
    if size is not None:
        headers["Content-Length"] = str(size)
    return Call("POST", "/v1/phantoms", _model(PhantomResource), params, headers=headers)


def phantoms() -> Call[PhantomList]:
    return _get("/v1/phantoms", PhantomList)


def phantom(sha256: str) -> Call[PhantomResource]:
    return _get(f"/v1/phantoms/{_part(sha256)}", PhantomResource)


# What can be asked for


def presets() -> Call[PresetList]:
    return _get("/v1/presets", PresetList)


def preset(name: str) -> Call[PresetResource]:
    return _get(f"/v1/presets/{_part(name)}", PresetResource)


def service_info() -> Call[ServiceInfo]:
    return _get("/v1/service-info", ServiceInfo)


# Webhooks


def create_webhook(new: NewWebhook, key: str | None = None) -> Call[CreatedWebhook]:
    return _create("/v1/webhooks", CreatedWebhook, new.model_dump(mode="json"), key)


def webhooks() -> Call[WebhookList]:
    return _get("/v1/webhooks", WebhookList)


def webhook(identifier: str) -> Call[WebhookResource]:
    return _get(f"/v1/webhooks/{_part(identifier)}", WebhookResource)


def delete_webhook(identifier: str) -> Call[None]:
    return Call("DELETE", f"/v1/webhooks/{_part(identifier)}", _nothing)


def test_webhook(identifier: str) -> Call[MessageResource]:
    return _act(f"/v1/webhooks/{_part(identifier)}/test", MessageResource)


def enable_webhook(identifier: str) -> Call[WebhookResource]:
    return _act(f"/v1/webhooks/{_part(identifier)}/enable", WebhookResource, repeatable=True)


def webhook_messages(identifier: str, limit: int, cursor: str | None) -> Call[MessagePage]:
    return _get(f"/v1/webhooks/{_part(identifier)}/messages", MessagePage, limit=limit, cursor=cursor)


def webhook_message(identifier: str, message_id: str) -> Call[MessageResource]:
    return _get(f"/v1/webhooks/{_part(identifier)}/messages/{_part(message_id)}", MessageResource)


def replay_message(identifier: str, message_id: str) -> Call[MessageResource]:
    return _act(f"/v1/webhooks/{_part(identifier)}/messages/{_part(message_id)}/replay", MessageResource)
