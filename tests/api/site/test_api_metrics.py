"""/metrics: read by a Prometheus parser, from the database, and complete as far as it can be."""

from prometheus_client.parser import text_string_to_metric_families

from api.site import metrics
from worker.upkeep.reaper import Reaper


def scraped(client) -> dict[tuple[str, str], float]:
    """{(sample, label values): value}."""
    response = client.get("/metrics")
    assert response.status_code == 200
    assert response.headers["content-type"].startswith("text/plain")
    families = text_string_to_metric_families(response.text)
    return {(s.name, ",".join(s.labels.values())): s.value for family in families for s in family.samples}


def test_states_and_queues(client, post, done, served, monkeypatch):
    post()
    client.post("/v1/simulations?priority=batch", json={})
    now = served.jobs.clock()
    monkeypatch.setattr(served.fleet, "clock", lambda: now + 100)
    served.fleet.beat("one", 1)
    values = scraped(client)
    assert values["tomosim_simulations", "queued"] == 2
    assert values["tomosim_simulations", "succeeded"] == 1
    assert values["tomosim_simulations", "failed"] == 0
    assert values["tomosim_queued", "batch"] == 1
    assert 100 <= values["tomosim_queue_age_seconds", "batch"] < 200
    assert values["tomosim_queue_age_seconds", "gpu.batch"] == 0
    assert values["tomosim_workers", ""] == 1
    assert values["tomosim_free_bytes", ""] > 0


def test_stages_and_the_cache(client, post, served):
    for cached in (False, True):
        case = post()
        served.jobs.claim(case["id"], "test")
        stages = [
            {"name": "phantom", "cached": cached, "seconds": 2.5},
            {"name": "mesh", "cached": False, "seconds": 1},
        ]
        assert served.jobs.succeed(case["id"], "test", {"stages": stages, "files": {}})
    client.delete(case["links"]["self"])
    values = scraped(client)
    assert values["tomosim_stages_computed_total", "phantom"] == 1
    assert values["tomosim_stages_cached_total", "phantom"] == 1
    assert values["tomosim_stages_computed_total", "mesh"] == 2
    assert values["tomosim_stage_seconds_total", "phantom"] == 2.5
    assert values["tomosim_simulations_ended_total", "succeeded"] == 2  # a case that was forgotten too


def test_lost_workers(client, post, served, broker, settings, monkeypatch):
    case = post()
    served.jobs.claim(case["id"], "test")
    now = served.jobs.clock()
    monkeypatch.setattr(served.jobs, "clock", lambda: now + 2 * settings.lease_seconds)
    Reaper(settings, served.jobs, served.fleet, broker).sweep()
    assert scraped(client)["tomosim_lease_expiries_total", "simulation"] == 1


def test_a_collector_that_fails_hides_no_other(client, monkeypatch):
    def broken(served):
        raise RuntimeError

    monkeypatch.setattr(metrics, "COLLECTORS", [broken, *metrics.COLLECTORS])
    values = scraped(client)
    assert values["tomosim_collector_failed", "broken"] == 1
    assert values["tomosim_collector_failed", "disk"] == 0
    assert values["tomosim_simulations", "queued"] == 0


def test_openmetrics_where_asked_for(client):
    response = client.get("/metrics", headers={"Accept": "application/openmetrics-text; version=1.0.0"})
    assert response.headers["content-type"].startswith("application/openmetrics-text")
    assert response.text.endswith("# EOF\n")
