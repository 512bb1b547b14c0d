"""Settings of the service: one object, read from TOMOSIM_... environment variables and checked at start."""

from __future__ import annotations

import hashlib
import ipaddress
import os
import re
import tempfile
from pathlib import Path
from typing import Literal, Self

from pydantic import Field, SecretStr, ValidationError, field_validator, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from simcore.core.errors import SimulationError, StoreError
from simcore.core.memory import physical_bytes
from simcore.store.bucket import Location
from tomosim_contract.names import SIMULATION_QUEUES

ENV_PREFIX = "TOMOSIM_"

# A Unix socket address holds 108 bytes with the closing zero.
MAX_SOCKET_PATH = 100

HOUR = 3600.0

MIN_SECRET_LENGTH = 32


SECRETS = ("admin_key", "database_url", "database_password", "broker_url", "store_access_key", "store_secret_key")
"""Settings that may lie in a file, named by the variable with _FILE at its end."""


class SettingsError(SimulationError):
    """A setting is wrong; the message names its environment variable."""

    kind = "user"
    code = "invalid-settings"


class Settings(BaseSettings):
    """Every setting has a default; ``TOMOSIM_PORT=9000`` in the environment sets ``port``."""

    model_config = SettingsConfigDict(env_prefix=ENV_PREFIX, frozen=True, extra="forbid")

    data_folder: Path = Field(Path("data"), description="database, stage store and broker files lie below it")
    database_url: str = Field("", description="SQLAlchemy URL; empty: SQLite in the data folder")
    database_password: str = Field("", repr=False, description="put into the database URL, so that it can be a file")
    broker_url: str = Field("", description="Celery broker URL; empty: a broker of its own, in the data folder")
    host: str = Field("127.0.0.1", description="address the API binds to")
    port: int = Field(8080, ge=1, le=65535, description="port the API binds to")
    trusted_network: bool = Field(
        False,
        description="everybody who can reach the address may do everything as long as there is no API key: allows a "
        "host that is not loopback (inside a container whose port is published on loopback only, for instance)",
    )
    admin_key: SecretStr = Field(
        SecretStr(""), description="an API key that may do everything, of at least 32 characters; empty: none"
    )
    store_url: str = Field(
        "", description="s3://bucket/prefix: the stage store of several machines; empty: a folder in the data folder"
    )
    store_endpoint: str = Field("", description="URL of the S3-compatible service; empty: AWS")
    store_access_key: str = Field("", description="empty: the credentials that boto3 finds (AWS_...)")
    store_secret_key: str = Field("", repr=False, description="belongs to the access key")
    store_cache_bytes: int = Field(
        50_000_000_000, gt=0, description="what a machine keeps of an S3 store, besides what is in use [byte]"
    )
    min_free_bytes: int = Field(
        1 << 30, ge=0, description="no stage is started, no case or phantom taken, with less free space [byte]"
    )
    quota_active_cases: int = Field(
        0,
        ge=0,
        description="cases an API key may have queued or running at a time, unless it has its own quota; 0: any",
    )
    quota_cases_per_day: int = Field(
        0, ge=0, description="cases an API key may post within 24 hours, unless it has its own quota; 0: any"
    )
    rate_per_second: float = Field(
        50.0, ge=0, description="requests a second of an API key, or of an address whose key is refused; 0: any number"
    )
    rate_burst: int = Field(200, ge=1, description="requests that may come at once after a pause")
    worker_slots: int = Field(1, ge=1, le=64, description="cases one worker computes at a time")
    queues: str = Field(
        "interactive,batch", description="queues of cases that a worker serves, the first that has a message first"
    )
    gpu: bool = Field(False, description="whether cases may ask for a worker of the gpu queues")
    threads_per_slot: int = Field(0, ge=0, le=1024, description="threads of a case; 0: cores / worker slots")
    memory_limit_bytes: int = Field(
        0, ge=0, description="memory a case may use [byte]; 0: 0.8 of the machine / worker slots"
    )
    job_timeout_seconds: float = Field(6 * HOUR, gt=0, description="a case that runs longer is stopped [s]")
    max_attempts: int = Field(3, ge=1, description="times a case is started before a crash or a lost worker fails it")
    lease_seconds: float = Field(30.0, gt=0, description="a worker silent for longer has lost its case [s]")
    resend_seconds: float = Field(30.0, gt=0, description="a queued case without a message is sent again after [s]")
    sweep_seconds: float = Field(2.0, gt=0, description="interval of the sweep for lost cases [s]")
    cors_origins: str = Field(
        "",
        description="origins of pages that may read /dicomweb (viewers), separated by commas: "
        "https://viewer.example.org; empty: none",
    )
    retention_seconds: float = Field(
        0.0, ge=0, description="files of a case are kept so long after its end where it says nothing [s]; 0: for ever"
    )
    event_seconds: float = Field(86400.0, gt=0, description="progress events are kept so long after the end [s]")
    gc_interval_seconds: float = Field(3600.0, gt=0, description="interval of the collection of garbage [s]")
    gc_grace_seconds: float = Field(
        86400.0, gt=0, description="what was used within this time is never collected [s]; at least two job timeouts"
    )
    body_limit_bytes: int = Field(1_000_000, gt=0, description="largest body of a request [byte]")
    study_case_limit: int = Field(2000, ge=1, le=100_000, description="largest number of cases of a study")
    idempotency_seconds: float = Field(24 * HOUR, gt=0, description="an Idempotency-Key is remembered for [s]")
    upload_limit_bytes: int = Field(4_000_000_000, gt=0, description="largest label volume that is uploaded [byte]")
    webhook_private_hosts: str = Field(
        "",
        description="hosts, separated by commas, that webhooks may reach by http and at private addresses; of any "
        "other host only https at public addresses",
    )
    delivery_slots: int = Field(2, ge=1, le=64, description="deliveries one delivery worker makes at a time")
    commitment_address: str = Field(
        "",
        pattern=r"^$|^[^:\s]+:[0-9]{1,5}$|^\[[0-9A-Fa-f:]+\]:[0-9]{1,5}$",
        description="address and port (0.0.0.0:11113) at which the delivery worker hears reports of storage "
        "commitment; empty: only on the association of the request",
    )
    destination_hosts: str = Field(
        "",
        description="which hosts may be destinations, separated by commas: names, `*.domain`, addresses, networks "
        "(10.1.0.0/16); empty: any",
    )
    secrets_folder: str = Field(
        "", description="certificates and keys of destinations; empty: secrets in the data folder"
    )
    log_level: Literal["DEBUG", "INFO", "WARNING", "ERROR"] = Field("INFO", description="least level of log lines")
    pipeline: str = Field(
        "simcore.pipeline:run", description="module:function that runs a case; another one for tests only"
    )

    @field_validator("queues")
    @classmethod
    def _known_queues(cls, value: str) -> str:
        names = _names(value)
        if not names or len(set(names)) < len(names) or not set(names) <= set(SIMULATION_QUEUES):
            raise ValueError(f"names of queues with commas between them; there are: {', '.join(SIMULATION_QUEUES)}")
        return value

    @field_validator("data_folder")
    @classmethod
    def _absolute(cls, value: Path) -> Path:
        return value.expanduser().absolute()

    @field_validator("destination_hosts")
    @classmethod
    def _hosts(cls, value: str) -> str:
        for entry in _names(value):
            if network_of(entry) is None and ("/" in entry or not entry.removeprefix("*.").strip(".")):
                raise ValueError(
                    f"{entry!r} is neither a host name, '*.domain', an address nor a network such as 10.1.0.0/16"
                )
        return value

    @field_validator("admin_key")
    @classmethod
    def _long_enough(cls, value: SecretStr) -> SecretStr:
        if 0 < len(value) < MIN_SECRET_LENGTH:
            raise ValueError(
                f"{len(value)} characters; at least {MIN_SECRET_LENGTH} ('openssl rand -hex 32' makes one)"
            )
        return value

    @model_validator(mode="after")
    def _check_grace(self) -> Self:
        if self.gc_grace_seconds < 2 * self.job_timeout_seconds:
            raise ValueError(
                f"TOMOSIM_GC_GRACE_SECONDS = {self.gc_grace_seconds:g}: a running case needs what it has found; at "
                f"least 2 x TOMOSIM_JOB_TIMEOUT_SECONDS = {2 * self.job_timeout_seconds:g} s"
            )
        return self

    @model_validator(mode="after")
    def _check_store(self) -> Self:
        if self.store_url:
            try:
                _ = Location(self.store_url).bucket
            except StoreError as error:
                raise ValueError(f"TOMOSIM_STORE_URL = {error}") from None
        if bool(self.store_access_key) != bool(self.store_secret_key):
            raise ValueError("TOMOSIM_STORE_ACCESS_KEY and TOMOSIM_STORE_SECRET_KEY: both are needed, or none")
        return self

    @classmethod
    def load(cls, **changes: object) -> Settings:
        """Settings of this environment, some of them changed.

        raises: SettingsError naming the environment variable, its value and what is allowed.
        """
        try:
            return cls(**{**_from_files(), **changes})  # type: ignore[arg-type]
        except ValidationError as error:
            raise SettingsError("; ".join(_problem(item) for item in error.errors())) from None

    @property
    def admin_secret(self) -> str:
        """The administrator's key of the settings; empty: none."""
        return self.admin_key.get_secret_value()

    @field_validator("cors_origins")
    @classmethod
    def _only_origins(cls, value: str) -> str:
        for origin in _names(value):
            if not re.fullmatch(r"https?://(\[[0-9a-fA-F:.]+\]|[A-Za-z0-9.-]+)(:[0-9]{1,5})?", origin):
                raise ValueError(
                    f"{origin!r} is no origin: scheme, host and port alone are allowed, as in "
                    "https://viewer.example.org or http://localhost:3000"
                )
        return value

    @property
    def viewer_origins(self) -> list[str]:
        """The pages that may read /dicomweb."""
        return _names(self.cors_origins)

    @property
    def store_folder(self) -> Path:
        """Where stage results lie."""
        return self.data_folder / "store"

    @property
    def allowed_destinations(self) -> list[str]:
        """Entries of the allow-list of destinations; none: any host."""
        return _names(self.destination_hosts)

    @property
    def resolved_secrets_folder(self) -> Path:
        """Where certificates and keys of destinations lie."""
        return (
            Path(self.secrets_folder).expanduser().absolute() if self.secrets_folder else self.data_folder / "secrets"
        )

    @property
    def broker_folder(self) -> Path:
        """Where the embedded broker keeps its files."""
        return self.data_folder / "broker"

    @property
    def broker_socket(self) -> Path:
        """Unix socket of the embedded broker: in the data folder, or where its path is too long, in a folder of
        the temporary folder that belongs to the data folder and the user."""
        path = self.broker_folder / "socket"
        if len(os.fsencode(path)) <= MAX_SOCKET_PATH:
            return path
        name = hashlib.sha256(os.fsencode(self.data_folder)).hexdigest()[:16]
        return Path(tempfile.gettempdir()) / f"tomosim-{os.getuid()}-{name}" / "socket"

    @property
    def resolved_database_url(self) -> str:
        if not (self.database_url and self.database_password):
            return self.database_url or f"sqlite:///{self.data_folder / 'tomosim.db'}"
        from sqlalchemy import make_url  # 0.3 s, and a compute process needs no database

        url = make_url(self.database_url).set(password=self.database_password)
        return url.render_as_string(hide_password=False)

    @property
    def resolved_broker_url(self) -> str:
        return self.broker_url or f"redis+socket://{self.broker_socket}?virtual_host=0"

    @property
    def queue_names(self) -> list[str]:
        """The queues of a worker, the most urgent first."""
        return _names(self.queues)

    @property
    def threads(self) -> int:
        """Threads of one case."""
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        return self.threads_per_slot or max(1, cores // self.worker_slots)

    @property
    def memory_limit(self) -> int:
        """Memory one case may use, bytes."""
        return self.memory_limit_bytes or int(0.8 * physical_bytes() / self.worker_slots)

    @property
    def webhook_private_host_names(self) -> frozenset[str]:
        """Hosts that webhooks may reach by http and at private addresses."""
        return frozenset(name.strip().lower() for name in self.webhook_private_hosts.split(",") if name.strip())

    @property
    def visibility_timeout(self) -> float:
        """After this time the broker takes a message for lost; longer than any case [s]."""
        return self.job_timeout_seconds + HOUR

    def environment(self) -> dict[str, str]:
        """The variables that give a child process the same settings."""
        values = self.model_dump(mode="json")
        values["admin_key"] = self.admin_key.get_secret_value()
        return {ENV_PREFIX + name.upper(): str(value) for name, value in values.items()}


def _from_files() -> dict[str, str]:
    """Secrets that lie in files: TOMOSIM_DATABASE_PASSWORD_FILE names the file of TOMOSIM_DATABASE_PASSWORD.

    raises: SettingsError where one cannot be read
    """
    secrets = {}
    for name in SECRETS:
        variable = ENV_PREFIX + name.upper()
        path = os.environ.get(f"{variable}_FILE")
        if path and not os.environ.get(variable):
            try:
                secrets[name] = Path(path).read_text().strip()
            except (OSError, UnicodeDecodeError) as error:
                raise SettingsError(f"{variable}_FILE = {path!r} cannot be read: {error}") from None
    return secrets


def is_loopback(host: str) -> bool:
    """Whether an address can be reached from this machine only."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def network_of(entry: str) -> ipaddress.IPv4Network | ipaddress.IPv6Network | None:
    """The network (an address: of itself alone) that an entry of TOMOSIM_DESTINATION_HOSTS names; None: a name."""
    try:
        return ipaddress.ip_network(entry)
    except ValueError:
        return None


def _names(text: str) -> list[str]:
    return [name for part in text.split(",") if (name := part.strip())]


def _problem(item: object) -> str:
    assert isinstance(item, dict)
    if not item["loc"]:
        return str(item["msg"]).removeprefix("Value error, ")
    name = ENV_PREFIX + str(item["loc"][0]).upper()
    if item["loc"][0] in SECRETS:
        return f"{name}: {item['msg']}"
    return f"{name} = {item['input']!r}: {item['msg']}"
