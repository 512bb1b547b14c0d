"""docker-compose.yml and Dockerfile: what can be known of them without a container engine."""

import importlib.util
import re
from pathlib import Path

import pytest
import yaml

from worker.settings import ENV_PREFIX, Settings

ROOT = Path(__file__).parent.parent
COMPOSE = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
SERVICES = COMPOSE["services"]
OURS = ("api", "worker", "delivery")

# Of the compose specification; a word that is not here is a typing mistake.
SERVICE_KEYS = {
    "build", "cap_drop", "command", "depends_on", "environment", "healthcheck", "image", "init", "networks", "ports",
    "read_only", "restart", "security_opt", "shm_size", "stop_grace_period", "tmpfs", "user", "volumes",
}  # fmt: skip
HEALTH_KEYS = {"test", "interval", "timeout", "retries", "start_period"}
DURATION = re.compile(r"\d+(s|m)")
VARIABLE = re.compile(r"\$\{(\w+)(?::([-?])([^}]*))?\}")


def substituted(text: str) -> str:
    """A value as compose sees it where no variable is set."""
    return VARIABLE.sub(lambda m: m.group(3) or "", text)


def test_top_level():
    assert {k for k in COMPOSE if not k.startswith("x-")} == {"name", "services", "networks", "volumes"}
    assert set(SERVICES) == {"api", "worker", "delivery", "redis", "postgres"}


@pytest.mark.parametrize("name", SERVICES)
def test_service(name):
    service = SERVICES[name]
    assert set(service) <= SERVICE_KEYS
    assert "image" in service
    for other, condition in service.get("depends_on", {}).items():
        assert condition == {"condition": "service_healthy"}
        assert "healthcheck" in SERVICES[other]
    health = service["healthcheck"]
    assert set(health) <= HEALTH_KEYS
    assert health["test"][0] == "CMD"
    assert all(DURATION.fullmatch(health[k]) for k in ("interval", "timeout"))
    for volume in service["volumes"]:
        assert volume.split(":")[0] in COMPOSE["volumes"]
    assert set(service["networks"]) <= set(COMPOSE["networks"])


@pytest.mark.parametrize("name", SERVICES)
def test_service_has_no_rights(name):
    service = SERVICES[name]
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    if name in OURS:
        assert re.search(r"^USER (\d+):(\d+)$", (ROOT / "Dockerfile").read_text(), re.MULTILINE)
    else:
        assert re.fullmatch(r"[1-9]\d*:[1-9]\d*", service["user"])


def test_only_loopback_is_published():
    published = {name: s["ports"] for name, s in SERVICES.items() if "ports" in s}
    assert set(published) == {"api"}
    assert all(port.startswith("127.0.0.1:") for port in published["api"])
    assert COMPOSE["networks"]["inside"] == {"internal": True}
    assert SERVICES["redis"]["networks"] == SERVICES["postgres"]["networks"] == ["inside"]


@pytest.mark.parametrize("name", OURS)
def test_environment_is_known_and_valid(name, monkeypatch):
    known = {ENV_PREFIX + field.upper() for field in Settings.model_fields}
    environment = SERVICES[name]["environment"]
    assert set(environment) <= known
    for variable, value in environment.items():
        monkeypatch.setenv(variable, substituted(str(value)))
    settings = Settings.load()
    assert settings.resolved_database_url == "postgresql+pg8000://tomosim:tomosim@postgres:5432/tomosim"
    assert settings.broker_url == "redis://redis:6379/0"
    assert str(settings.data_folder) == SERVICES[name]["volumes"][0].partition(":")[2]


def test_api_and_worker_share_what_they_must():
    for key in ("TOMOSIM_DATABASE_URL", "TOMOSIM_BROKER_URL", "TOMOSIM_DATA_FOLDER", "TOMOSIM_MEMORY_LIMIT_BYTES"):
        assert len({SERVICES[name]["environment"][key] for name in OURS}) == 1
    assert all(SERVICES[name]["volumes"] == SERVICES["api"]["volumes"] for name in OURS)


@pytest.mark.parametrize(
    "command", [*(SERVICES[n]["command"] for n in OURS), SERVICES["worker"]["healthcheck"]["test"][1:]]
)
def test_commands_are_modules_of_ours(command):
    assert command[:2] == ["python", "-m"]
    assert importlib.util.find_spec(command[2]) is not None


def test_the_image_installs_what_was_locked():
    text = (ROOT / "Dockerfile").read_text()
    assert "--require-hashes -r requirements.lock" in text
    for copied in re.findall(r"^COPY (?!--from)(.+) \S+$", text, re.MULTILINE):
        for name in copied.split():
            assert (ROOT / name).exists(), name
            assert f"!{name}" in (ROOT / ".dockerignore").read_text().split()
    lock = (ROOT / "requirements.lock").read_text()
    for package in ("pg8000", "celery", "uvicorn", "setuptools"):
        assert re.search(rf"^{package}==", lock, re.MULTILINE), package
