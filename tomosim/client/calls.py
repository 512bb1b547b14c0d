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

from simcore.needs import Estimate
from simcore.phantom.upload.reading import Reading
from simcore.spec import SimulationSpec
from simcore.study.spec import StudySpec
from tomosim_contract.catalog import PresetList, PresetResource, ServiceInfo
from tomosim_contract.deliveries import DeliveryPage, DeliveryResource, InstancePage, NewDelivery
from tomosim_contract.destination import Destination
from tomosim_contract.destinations import DestinationList, DestinationResource, EchoResource
from tomosim_contract.phantoms import PhantomList, PhantomResource
from tomosim_contract.simulations import ArtifactList, SimulationPage, SimulationResource
from tomosim_contract.studies import CasePage, StudyEstimate, StudyPage, StudyResource
from tomosim_contract.webhooks import (
    CreatedWebhook,
    MessagePage,
    MessageResource,
    NewWebhook,
    WebhookList,
    WebhookResource,
)

T = TypeVar("T")
M = TypeVar("M", bound=BaseModel)

Json = dict[str, Any]

Specification = SimulationSpec | Mapping[str, Any]
Study = StudySpec | Mapping[str, Any]


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
    return Call("GET", path, _model(model), _given(params))


def _create(path: str, model: type[M], body: Any, key: str | None, **params: Any) -> Call[M]:
    """A POST that makes something: with a key, so that it makes it once however often it is sent."""
    headers = {"Idempotency-Key": key or uuid.uuid4().hex}
    return Call("POST", path, _model(model), _given(params), json=body, headers=headers)


def _act(path: str, model: type[M], *, repeatable: bool = False, **params: Any) -> Call[M]:
    return Call("POST", path, _model(model), _given(params), repeatable=repeatable)


def _given(params: Json) -> Json:
    return {name: value for name, value in params.items() if value is not None}


def _part(text: str) -> str:
    return quote(text, safe="")


def _json(document: BaseModel | Mapping[str, Any]) -> Json:
    return document.model_dump(mode="json") if isinstance(document, BaseModel) else dict(document)


# Simulations


def submit(
    specification: Specification, deliver: list[Json], priority: str | None, device: str | None, key: str | None
) -> Call[SimulationResource]:
    body = _json(specification) | ({"deliver": deliver} if deliver else {})
    return _create("/v1/simulations", SimulationResource, body, key, priority=priority, device=device)


def estimate(specification: Specification) -> Call[Estimate]:
    return Call("POST", "/v1/simulations/estimate", _model(Estimate), json=_json(specification))


def simulation(identifier: str) -> Call[SimulationResource]:
    return _get(f"/v1/simulations/{_part(identifier)}", SimulationResource)


def simulations(state: str | None, study_id: str | None, limit: int, cursor: str | None) -> Call[SimulationPage]:
    return _get("/v1/simulations", SimulationPage, state=state, study_id=study_id, limit=limit, cursor=cursor)


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


# Studies


def submit_study(study: Study, priority: str | None, device: str | None, key: str | None) -> Call[StudyResource]:
    return _create("/v1/studies", StudyResource, _json(study), key, priority=priority, device=device)


def estimate_study(study: Study) -> Call[StudyEstimate]:
    return Call("POST", "/v1/studies/estimate", _model(StudyEstimate), json=_json(study))


def study(identifier: str) -> Call[StudyResource]:
    return _get(f"/v1/studies/{_part(identifier)}", StudyResource)


def studies(limit: int, cursor: str | None) -> Call[StudyPage]:
    return _get("/v1/studies", StudyPage, limit=limit, cursor=cursor)


def study_cases(identifier: str, state: str | None, limit: int, cursor: str | None) -> Call[CasePage]:
    return _get(f"/v1/studies/{_part(identifier)}/cases", CasePage, state=state, limit=limit, cursor=cursor)


def study_table(identifier: str) -> Call[str]:
    path = f"/v1/studies/{_part(identifier)}/manifest"
    return Call("GET", path, lambda response: response.text, {"format": "csv"})


def cancel_study(identifier: str) -> Call[StudyResource]:
    return _act(f"/v1/studies/{_part(identifier)}/cancel", StudyResource, repeatable=True)


def retry_study(identifier: str, cancelled: bool) -> Call[StudyResource]:
    return _act(f"/v1/studies/{_part(identifier)}/retry", StudyResource, cancelled=str(cancelled).lower())


def delete_study(identifier: str) -> Call[None]:
    return Call("DELETE", f"/v1/studies/{_part(identifier)}", _nothing)


def study_manifest(identifier: str) -> Call[Json]:
    path = f"/v1/studies/{_part(identifier)}/manifest"
    return Call("GET", path, lambda response: response.json(), {"format": "json"})


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
    return _create(f"/v1/webhooks/{_part(identifier)}/test", MessageResource, None, None)


def enable_webhook(identifier: str) -> Call[WebhookResource]:
    return _act(f"/v1/webhooks/{_part(identifier)}/enable", WebhookResource, repeatable=True)


def webhook_messages(identifier: str, limit: int, cursor: str | None) -> Call[MessagePage]:
    return _get(f"/v1/webhooks/{_part(identifier)}/messages", MessagePage, limit=limit, cursor=cursor)


def webhook_message(identifier: str, message_id: str) -> Call[MessageResource]:
    return _get(f"/v1/webhooks/{_part(identifier)}/messages/{_part(message_id)}", MessageResource)


def replay_message(identifier: str, message_id: str) -> Call[MessageResource]:
    return _act(f"/v1/webhooks/{_part(identifier)}/messages/{_part(message_id)}/replay", MessageResource)


# Destinations and deliveries


def create_destination(destination: Destination) -> Call[DestinationResource]:
    return _create("/v1/destinations", DestinationResource, _json(destination), None)


def destinations() -> Call[DestinationList]:
    return _get("/v1/destinations", DestinationList)


def destination(identifier: str) -> Call[DestinationResource]:
    return _get(f"/v1/destinations/{_part(identifier)}", DestinationResource)


def change_destination(identifier: str, changes: Mapping[str, Any]) -> Call[DestinationResource]:
    path = f"/v1/destinations/{_part(identifier)}"
    headers = {"Content-Type": "application/merge-patch+json"}
    return Call("PATCH", path, _model(DestinationResource), json=dict(changes), headers=headers)


def delete_destination(identifier: str) -> Call[None]:
    return Call("DELETE", f"/v1/destinations/{_part(identifier)}", _nothing)


def echo(identifier: str) -> Call[EchoResource]:
    return _act(f"/v1/destinations/{_part(identifier)}/echo", EchoResource, repeatable=True)


def deliver(new: NewDelivery, key: str | None) -> Call[DeliveryResource]:
    return _create("/v1/deliveries", DeliveryResource, new.model_dump(mode="json"), key)


def delivery(identifier: str) -> Call[DeliveryResource]:
    return _get(f"/v1/deliveries/{_part(identifier)}", DeliveryResource)


def deliveries(filters: Json, limit: int, cursor: str | None) -> Call[DeliveryPage]:
    return _get("/v1/deliveries", DeliveryPage, **filters, limit=limit, cursor=cursor)


def delivery_instances(identifier: str, state: str | None, after: int | None) -> Call[InstancePage]:
    return _get(f"/v1/deliveries/{_part(identifier)}/instances", InstancePage, state=state, after=after)


def cancel_delivery(identifier: str) -> Call[DeliveryResource]:
    return _act(f"/v1/deliveries/{_part(identifier)}/cancel", DeliveryResource, repeatable=True)


def retry_delivery(identifier: str) -> Call[DeliveryResource]:
    return _act(f"/v1/deliveries/{_part(identifier)}/retry", DeliveryResource)
