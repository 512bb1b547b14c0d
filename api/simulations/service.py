"""What a posted case needs before it is taken into the queue."""

from __future__ import annotations

from api.http.deps import Services
from api.http.errors import ApiError
from simcore import estimate, phantom
from simcore.needs import Estimate
from simcore.spec import SimulationSpec
from tomosim_contract.names import Device, Priority, Queue, queue_of


def chosen_queue(served: Services, priority: Priority, device: Device) -> Queue:
    """raises: ApiError 422 where there is no such worker"""
    if device == "gpu" and not served.settings.gpu:
        item = {"parameter": "device", "value": device, "detail": "allowed here: cpu"}
        raise ApiError(422, "invalid-request", "device = 'gpu': there is no worker with one; use cpu", errors=[item])
    return queue_of(priority, device)


def check(specification: SimulationSpec, served: Services) -> Estimate:
    phantom.require(specification.phantom, served.store)
    return estimate.check(specification, served.settings.memory_limit)
