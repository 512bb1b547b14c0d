"""docker-compose.yml and Dockerfile: what can be known of them without a container engine."""

import importlib.util
import re
from pathlib import Path

import pytest
import yaml

from tomosim.cli import _parser
from worker.settings import ENV_PREFIX, SECRETS, Settings

ROOT = Path(__file__).parent.parent
COMPOSE = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
SERVICES = COMPOSE["services"]
OURS = ("api", "worker", "delivery", "migrate")
RUNNING = ("api", "worker", "delivery")

# Of the compose specification; a word that is not here is a typing mistake.
SERVICE_KEYS = {
    "build", "cap_drop", "command", "depends_on", "environment", "healthcheck", "image", "init", "networks", "ports",
    "read_only", "restart", "secrets", "security_opt", "shm_size", "stop_grace_period", "tmpfs", "user", "volumes",
}  # fmt: skip
HEALTH_KEYS = {"test", "interval", "timeout", "retries", "start_period"}
DURATION = re.compile(r"\d+(s|m)")
VARIABLE = re.compile(r"\$\{(\w+)(?::([-?])([^}]*))?\}")


def substituted(text: str) -> str:
    """A value as compose sees it where no variable is set."""
    return VARIABLE.sub(lambda m: m.group(3) or "", text)


def test_top_level():
    assert {k for k in COMPOSE if not k.startswith("x-")} == {"name", "services", "networks", "volumes", "secrets"}
    assert set(SERVICES) == {"migrate", "api", "worker", "delivery", "redis", "postgres"}


@pytest.mark.parametrize("name", SERVICES)
def test_service(name):
    service = SERVICES[name]
    assert set(service) <= SERVICE_KEYS
    assert "image" in service
    for other, condition in service.get("depends_on", {}).items():
        if other == "migrate":
            assert condition == {"condition": "service_completed_successfully"}
            continue
        assert condition == {"condition": "service_healthy"}
        assert "healthcheck" in SERVICES[other]
    if name == "migrate":
        assert "healthcheck" not in service
        assert service["restart"] == "no"
    else:
        health = service["healthcheck"]
        assert set(health) <= HEALTH_KEYS
        assert health["test"][0] == "CMD"
        assert all(DURATION.fullmatch(health[k]) for k in ("interval", "timeout"))
        assert service["restart"] == "unless-stopped"
    assert set(service.get("secrets", ())) <= set(COMPOSE["secrets"])
    for volume in service.get("volumes", ()):
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


def test_nothing_of_ours_starts_before_the_migration():
    assert all("migrate" in SERVICES[name]["depends_on"] for name in RUNNING)
    assert set(SERVICES["migrate"]["depends_on"]) == {"postgres"}


def test_no_secret_stands_in_the_file():
    for name, service in SERVICES.items():
        for variable, value in service.get("environment", {}).items():
            if re.search("PASSWORD|SECRET|ADMIN_KEY", variable):
                assert variable.endswith("_FILE"), (name, variable)
                assert str(value).removeprefix("/run/secrets/") in service["secrets"]
    for secret in COMPOSE["secrets"].values():
        assert substituted(secret["file"]).startswith("./secrets/")


@pytest.mark.parametrize("name", OURS)
def test_environment_is_known_and_valid(name, monkeypatch, tmp_path):
    known = {ENV_PREFIX + field.upper() for field in Settings.model_fields}
    known |= {f"{ENV_PREFIX}{field.upper()}_FILE" for field in SECRETS}
    environment = SERVICES[name]["environment"]
    assert set(environment) <= known
    for variable, value in environment.items():
        text = substituted(str(value))
        if text.startswith("/run/secrets/"):
            secret = tmp_path / text.rpartition("/")[2]
            secret.write_text("0123456789abcdef" * 3)
            text = str(secret)
        monkeypatch.setenv(variable, text)
    settings = Settings.load()
    password = "0123456789abcdef" * 3
    assert settings.resolved_database_url == f"postgresql+pg8000://tomosim:{password}@postgres:5432/tomosim"
    assert settings.admin_secret == password
    assert settings.store_url == ""
    assert settings.broker_url == "redis://redis:6379/0"
    if name in RUNNING:
        assert str(settings.data_folder) == SERVICES[name]["volumes"][0].partition(":")[2]


def test_api_and_worker_share_what_they_must():
    for key in ("TOMOSIM_DATABASE_URL", "TOMOSIM_BROKER_URL", "TOMOSIM_DATA_FOLDER", "TOMOSIM_MEMORY_LIMIT_BYTES"):
        assert len({SERVICES[name]["environment"][key] for name in OURS}) == 1
    assert all(SERVICES[name]["volumes"] == SERVICES["api"]["volumes"] for name in RUNNING)


@pytest.mark.parametrize(
    "command", [*(SERVICES[n]["command"] for n in RUNNING), SERVICES["worker"]["healthcheck"]["test"][1:]]
)
def test_commands_are_modules_of_ours(command):
    assert command[:2] == ["python", "-m"]
    assert importlib.util.find_spec(command[2]) is not None


def test_object_storage_is_added_to_what_is_there(monkeypatch, tmp_path):
    s3 = yaml.safe_load((ROOT / "docker-compose.s3.yml").read_text())
    assert set(s3["services"]) == set(RUNNING)
    (tmp_path / "key").write_text("secret")
    for name, service in s3["services"].items():
        assert set(service["secrets"]) == {*SERVICES[name]["secrets"], *s3["secrets"]}
        assert set(service["networks"]) <= set(COMPOSE["networks"])
        for variable, value in service["environment"].items():
            known = {"URL": "s3://bucket/prefix", "FILE": str(tmp_path / "key")}.get(variable.rpartition("_")[2])
            monkeypatch.setenv(variable, known or substituted(value) or "https://s3.example.org")
    assert Settings.load().store_url == "s3://bucket/prefix"
    assert Settings.load().store_secret_key == "secret"


def test_the_migration_is_a_command_of_ours():
    program, *words = SERVICES["migrate"]["command"]
    assert program == "tomosim"
    assert callable(_parser().parse_args(words).run)


def test_the_image_installs_what_was_locked():
    text = (ROOT / "Dockerfile").read_text()
    assert "--require-hashes -r requirements.lock" in text
    for copied in re.findall(r"^COPY (?!--from)(.+) \S+$", text, re.MULTILINE):
        for name in copied.split():
            assert (ROOT / name).exists(), name
            assert f"!{name}" in (ROOT / ".dockerignore").read_text().split()
    lock = (ROOT / "requirements.lock").read_text()
    for package in ("pg8000", "boto3", "celery", "uvicorn", "setuptools"):
        assert re.search(rf"^{package}==", lock, re.MULTILINE), package
