"""The client for programs that wait.

Made from ``async_client.py`` by ``python -m tomosim.client.twin``: change that one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import IO, Any, TypeVar

from simcore.needs import Estimate
from simcore.phantom.upload.reading import Reading
from simcore.spec import SimulationSpec
from tomosim.client import calls, common, files
from tomosim.client.calls import Call, Json, Specification, Study
from tomosim.client.common import Deadline
from tomosim.client.files import Downloaded
from tomosim.client.streams import CaseEvent
from tomosim.client.sync_transport import Transport
from tomosim_contract.catalog import PresetResource, ServiceInfo
from tomosim_contract.deliveries import DeliveryResource, InstanceResource, NewDelivery
from tomosim_contract.destination import Destination
from tomosim_contract.destinations import DestinationName, DestinationResource, EchoResource
from tomosim_contract.names import FINAL_STATES, Device, InstanceState, Priority, State, WebhookEvent
from tomosim_contract.phantoms import PhantomResource
from tomosim_contract.simulations import ArtifactResource, SimulationResource
from tomosim_contract.studies import CaseResource, StudyEstimate, StudyResource
from tomosim_contract.webhooks import DEFAULT_EVENTS, CreatedWebhook, MessageResource, NewWebhook, WebhookResource

T = TypeVar("T")


class Client(Transport):
    """One service. Use as a context manager.

    with Client("http://127.0.0.1:8080") as client:
        case = client.submit(spec)
        case = client.wait(case.id)
        for file in client.download(case.id, Path("out")):
            print(file.path)

    url: the environment's TOMOSIM_URL, or this machine's port 8080, where not given. api_key: TOMOSIM_API_KEY.
    timeout_seconds: without any sign of the service. raises from every method: ServiceError
    """

    # Simulations

    def submit(
        self,
        specification: Specification,
        *,
        deliver: Sequence[str | Mapping[str, Any]] = (),
        priority: Priority | None = None,
        device: Device | None = None,
        idempotency_key: str | None = None,
    ) -> SimulationResource:
        """Queues a case.

        deliver: destinations that its files go to when it has succeeded: a name, or {"destination", "files"}.
        idempotency_key: two requests with the same key make one case; a new key where not given.
        """
        deliveries = [{"destination": one} if isinstance(one, str) else dict(one) for one in deliver]
        return self._do(calls.submit(specification, deliveries, priority, device, idempotency_key))

    def estimate(self, specification: Specification) -> Estimate:
        """What a case would need."""
        return self._do(calls.estimate(specification))

    def get(self, simulation_id: str) -> SimulationResource:
        """A case with its specification."""
        return self._do(calls.simulation(simulation_id))

    def simulations(
        self, state: State | None = None, study_id: str | None = None, page_size: int = 100
    ) -> Iterator[SimulationResource]:
        """Cases, the newest first, page by page as they are needed."""
        return self._pages(lambda cursor: calls.simulations(state, study_id, page_size, cursor))

    def cancel(self, simulation_id: str) -> SimulationResource:
        """Stops a case."""
        return self._do(calls.cancel(simulation_id))

    def retry(self, simulation_id: str) -> SimulationResource:
        """Queues a failed or cancelled case again."""
        return self._do(calls.retry(simulation_id))

    def delete(self, simulation_id: str) -> None:
        """Forgets a finished case."""
        self._do(calls.delete(simulation_id))

    def events(self, simulation_id: str, after: int = 0) -> Iterator[CaseEvent]:
        """What happens to a case until it has ended; a lost connection is taken up again where it broke.

        after: sequence of the last event already seen
        """
        return self._events(simulation_id, after, Deadline(None))

    def wait(
        self,
        simulation_id: str,
        watch: Callable[[CaseEvent], object] | None = None,
        timeout_seconds: float | None = None,
    ) -> SimulationResource:
        """The case in its final state, whichever that is; ``watch`` is called with every event.

        raises: TimeoutError
        """
        for event in self._events(simulation_id, 0, Deadline(timeout_seconds)):
            if watch is not None:
                watch(event)
        return self.get(simulation_id)

    def artifacts(self, simulation_id: str) -> list[ArtifactResource]:
        """The files of a case that succeeded."""
        return self._do(calls.artifacts(simulation_id)).items

    def manifest(self, simulation_id: str) -> Json:
        """Specification, seeds, versions, seconds and digests of a case that succeeded."""
        return self._do(calls.manifest(simulation_id))

    def download(
        self, simulation_id: str, folder: Path, choose: Callable[[str], bool] | None = None
    ) -> Iterator[Downloaded]:
        """Writes the files of a case (those whose name ``choose`` accepts) and manifest.json below ``folder``.

        Files that are there are kept, a file that broke off is gone on with. Gives each file when it is whole.
        raises: DigestError where a file arrives with another content than announced.
        """
        for item in self.artifacts(simulation_id):
            if choose is None or choose(item.name):
                yield self._fetch(item, folder)
        content = self._do(Call("GET", f"/v1/simulations/{simulation_id}/manifest", lambda r: r.content))
        folder.mkdir(parents=True, exist_ok=True)
        target = folder / "manifest.json"
        target.write_bytes(content)
        yield Downloaded("manifest.json", target, len(content))

    def download_archive(self, simulation_id: str, target: Path) -> int:
        """Writes all files of a case as one zip archive; its size in bytes."""
        return self._save(f"/v1/simulations/{simulation_id}/archive", target)

    # Studies

    def submit_study(
        self,
        study: Study,
        *,
        priority: Priority | None = None,
        device: Device | None = None,
        idempotency_key: str | None = None,
    ) -> StudyResource:
        """Queues all cases of a study, or none."""
        return self._do(calls.submit_study(study, priority, device, idempotency_key))

    def estimate_study(self, study: Study) -> StudyEstimate:
        """What a study would need."""
        return self._do(calls.estimate_study(study))

    def study(self, study_id: str) -> StudyResource:
        """A study with its counts."""
        return self._do(calls.study(study_id))

    def studies(self, page_size: int = 100) -> Iterator[StudyResource]:
        """Studies, the newest first."""
        return self._pages(lambda cursor: calls.studies(page_size, cursor))

    def study_cases(self, study_id: str, state: State | None = None, page_size: int = 200) -> Iterator[CaseResource]:
        """The cases of a study in the order of their numbers."""
        return self._pages(lambda cursor: calls.study_cases(study_id, state, page_size, cursor))

    def wait_for_study(
        self,
        study_id: str,
        watch: Callable[[StudyResource], object] | None = None,
        timeout_seconds: float | None = None,
    ) -> StudyResource:
        """The study when all its cases have ended; ``watch`` is called with every look. raises: TimeoutError"""
        deadline = Deadline(timeout_seconds)
        while True:
            study = self.study(study_id)
            if watch is not None:
                watch(study)
            if study.finished_cases == study.cases:
                return study
            deadline.check(study_id)
            time.sleep(common.LOOK_SECONDS)

    def cancel_study(self, study_id: str) -> StudyResource:
        """Stops all cases that have not ended."""
        return self._do(calls.cancel_study(study_id))

    def retry_study(self, study_id: str, *, cancelled: bool = False) -> StudyResource:
        """Queues the failed cases again, and where asked for the cancelled ones."""
        return self._do(calls.retry_study(study_id, cancelled))

    def delete_study(self, study_id: str) -> None:
        """Forgets a study and its cases."""
        self._do(calls.delete_study(study_id))

    def study_manifest(self, study_id: str) -> Json:
        """Every case with its coordinates, results and files."""
        return self._do(calls.study_manifest(study_id))

    def study_table(self, study_id: str) -> str:
        """One line a case, as CSV: coordinates, results, failures."""
        return self._do(calls.study_table(study_id))

    def download_study(
        self, study_id: str, folder: Path, choose: Callable[[str], bool] | None = None
    ) -> Iterator[Downloaded]:
        """Writes the files of all cases that have succeeded, one folder a case, and cases.csv below ``folder``.

        As ``download``: what is there is kept, so that it can be called again while the study goes on.
        """
        for case in self.study_cases(study_id, "succeeded"):
            for file in self.download(case.id, folder / case.folder, choose):
                yield replace(file, name=f"{case.folder}/{file.name}")
        content = self.study_table(study_id).encode()
        folder.mkdir(parents=True, exist_ok=True)
        target = folder / "cases.csv"
        target.write_bytes(content)
        yield Downloaded("cases.csv", target, len(content))

    def download_study_archive(self, study_id: str, target: Path) -> int:
        """Writes the files of all cases that succeeded as one zip archive; its size in bytes."""
        return self._save(f"/v1/studies/{study_id}/archive", target)

    # Phantoms

    def upload_phantom(
        self, content: Path | IO[bytes], *, name: str = "", reading: Reading | Mapping[str, Any] | None = None
    ) -> PhantomResource:
        """Sends a label volume; its ``specification`` is the part of a case that uses it.

        content: a file, or what has ``read``; read piece by piece. reading: how it is to be read, as far as the file
        does not say so itself.
        """
        call = calls.upload(name or files.name_of(content), reading, files.size_of(content))
        again = isinstance(content, Path)  # another stream has been read when it is to be sent a second time
        return self._do(call, lambda: files.chunks_of(content), repeatable=again)

    def phantoms(self) -> list[PhantomResource]:
        """All label volumes."""
        return self._do(calls.phantoms()).items

    def phantom(self, sha256: str) -> PhantomResource:
        """One label volume."""
        return self._do(calls.phantom(sha256))

    # What can be asked for

    def presets(self) -> list[PresetResource]:
        """All presets, without their specifications."""
        return self._do(calls.presets()).items

    def preset(self, name: str) -> SimulationSpec:
        """A specification to begin with."""
        resource = self._do(calls.preset(name))
        return SimulationSpec.from_dict(resource.specification or {})

    def service_info(self) -> ServiceInfo:
        """Version and limits of the service."""
        return self._do(calls.service_info())

    # Webhooks

    def create_webhook(
        self, url: str, events: tuple[WebhookEvent, ...] = DEFAULT_EVENTS, description: str = ""
    ) -> CreatedWebhook:
        """Has ``events`` posted to ``url``. Keep the ``secret`` of the answer: it is not shown again."""
        return self._do(calls.create_webhook(NewWebhook(url=url, events=list(events), description=description)))

    def webhooks(self) -> list[WebhookResource]:
        """All webhooks."""
        return self._do(calls.webhooks()).items

    def webhook(self, webhook_id: str) -> WebhookResource:
        """One webhook."""
        return self._do(calls.webhook(webhook_id))

    def delete_webhook(self, webhook_id: str) -> None:
        """Forgets a webhook."""
        self._do(calls.delete_webhook(webhook_id))

    def test_webhook(self, webhook_id: str) -> MessageResource:
        """Sends a message of the event "webhook.test"."""
        return self._do(calls.test_webhook(webhook_id))

    def enable_webhook(self, webhook_id: str) -> WebhookResource:
        """Takes a disabled webhook up again."""
        return self._do(calls.enable_webhook(webhook_id))

    def webhook_messages(self, webhook_id: str, page_size: int = 100) -> Iterator[MessageResource]:
        """What a webhook was told lately, the newest first."""
        return self._pages(lambda cursor: calls.webhook_messages(webhook_id, page_size, cursor))

    def webhook_message(self, webhook_id: str, message_id: str) -> MessageResource:
        """A message with its content and every attempt to send it."""
        return self._do(calls.webhook_message(webhook_id, message_id))

    def replay_message(self, webhook_id: str, message_id: str) -> MessageResource:
        """Sends a message again."""
        return self._do(calls.replay_message(webhook_id, message_id))

    # Destinations and deliveries

    def create_destination(self, destination: Destination) -> DestinationResource:
        """Makes a destination; for administrators."""
        return self._do(calls.create_destination(destination))

    def destinations(self) -> list[DestinationResource | DestinationName]:
        """All destinations; their names alone, for those who are no administrators."""
        return self._do(calls.destinations()).items

    def destination(self, destination_id: str) -> DestinationResource:
        """One destination."""
        return self._do(calls.destination(destination_id))

    def change_destination(self, destination_id: str, **changes: Any) -> DestinationResource:
        """Changes the fields that are given; None takes one back to its default."""
        return self._do(calls.change_destination(destination_id, changes))

    def delete_destination(self, destination_id: str) -> None:
        """Forgets a destination."""
        self._do(calls.delete_destination(destination_id))

    def echo(self, destination_id: str) -> EchoResource:
        """Whether a destination answers, and what it takes."""
        return self._do(calls.echo(destination_id))

    def deliver(
        self,
        destination: str,
        *,
        simulation_id: str | None = None,
        study_id: str | None = None,
        files: Sequence[str] = (),
        series: Sequence[str] = (),
        idempotency_key: str | None = None,
    ) -> DeliveryResource:
        """Sends a case, or the cases of a study that have succeeded, to a destination (its identifier or name)."""
        new = NewDelivery(
            destination=destination,
            simulation_id=simulation_id,
            study_id=study_id,
            files=list(files),
            series=list(series),
        )
        return self._do(calls.deliver(new, idempotency_key))

    def delivery(self, delivery_id: str) -> DeliveryResource:
        """A delivery with its first instances."""
        return self._do(calls.delivery(delivery_id))

    def deliveries(
        self,
        state: State | None = None,
        *,
        simulation_id: str | None = None,
        study_id: str | None = None,
        destination_id: str | None = None,
        page_size: int = 100,
    ) -> Iterator[DeliveryResource]:
        """Deliveries, the newest first."""
        filters = {
            "state": state,
            "simulation_id": simulation_id,
            "study_id": study_id,
            "destination_id": destination_id,
        }
        return self._pages(lambda cursor: calls.deliveries(filters, page_size, cursor))

    def delivery_instances(self, delivery_id: str, state: InstanceState | None = None) -> Iterator[InstanceResource]:
        """The files of a delivery and how far each has come."""
        return self._pages(lambda after: calls.delivery_instances(delivery_id, state, after))

    def wait_for_delivery(self, delivery_id: str, timeout_seconds: float | None = None) -> DeliveryResource:
        """The delivery in its final state, whichever that is. raises: TimeoutError"""
        deadline = Deadline(timeout_seconds)
        while (delivery := self.delivery(delivery_id)).state not in FINAL_STATES:
            deadline.check(delivery_id)
            time.sleep(common.LOOK_SECONDS)
        return delivery

    def cancel_delivery(self, delivery_id: str) -> DeliveryResource:
        """Stops a delivery; what was stored stays stored."""
        return self._do(calls.cancel_delivery(delivery_id))

    def retry_delivery(self, delivery_id: str) -> DeliveryResource:
        """Sends again what was not stored."""
        return self._do(calls.retry_delivery(delivery_id))
