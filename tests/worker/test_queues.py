"""Queues: a slot that is free takes what somebody waits for before what nobody waits for."""

import pytest

from tomosim_contract.names import queue_of
from worker.messages import CeleryMessenger, create_celery
from worker.settings import SettingsError


def taken(settings, number: int) -> list[str]:
    """The first messages that a worker of these settings takes, one at a time."""
    app = create_celery(settings)
    seen = []

    def take(body, message):
        seen.append(body[0][0])
        message.ack()

    with app.connection_for_read() as connection:
        channel = connection.default_channel
        channel.basic_qos(0, 1, False)
        app.amqp.queues.select(settings.queue_names)
        with app.amqp.TaskConsumer(channel, callbacks=[take], accept=["json"]):
            for _ in range(number):
                connection.drain_events(timeout=10)
    return seen


@pytest.mark.needs_redis
def test_interactive_goes_before_batch(make_settings, redis_url):
    settings = make_settings(broker_url=redis_url)
    messenger = CeleryMessenger(settings)
    for name, queue in [("a", "batch"), ("b", "batch"), ("c", "interactive"), ("d", "interactive")]:
        messenger.send(name, queue)
    assert messenger.waiting("batch") == 2
    assert taken(settings, 4) == ["c", "d", "a", "b"]


@pytest.mark.needs_redis
def test_a_worker_takes_from_its_own_queues_alone(make_settings, redis_url):
    settings = make_settings(broker_url=redis_url, queues="gpu.batch")
    messenger = CeleryMessenger(settings)
    messenger.send("a", "interactive")
    messenger.send("b", "gpu.batch")
    assert taken(settings, 1) == ["b"]
    assert messenger.waiting("interactive") == 1


def test_names():
    assert [queue_of(p, d) for d in ("cpu", "gpu") for p in ("interactive", "batch")] == [
        "interactive",
        "batch",
        "gpu.interactive",
        "gpu.batch",
    ]


@pytest.mark.parametrize("queues", ["", "fast", "batch,batch", "interactive,,fast", "delivery"])
def test_unknown_queues(make_settings, queues):
    with pytest.raises(SettingsError, match="TOMOSIM_QUEUES"):
        make_settings(queues=queues)
