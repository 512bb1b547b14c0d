"""What a destination is, as an administrator says it."""

from __future__ import annotations

import re
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from simcore.core.spec_base import Spec, quantity

TransferSyntax = Literal["explicit", "implicit", "jpeg-ls", "rle"]

TRANSFER_SYNTAX_UIDS: dict[TransferSyntax, str] = {
    "explicit": "1.2.840.10008.1.2.1",
    "implicit": "1.2.840.10008.1.2",
    "jpeg-ls": "1.2.840.10008.1.2.4.80",
    "rle": "1.2.840.10008.1.2.5",
}

_LABEL = re.compile(r"(?!-)[A-Za-z0-9_-]{1,63}(?<!-)")


def _ae_title(value: str) -> str:
    if not 1 <= len(value) <= 16 or value != value.strip() or not re.fullmatch(r"[ -\[\]-~]+", value):
        raise ValueError(
            "an AE title has 1 to 16 ASCII characters, no backslash, no space at its beginning or end (capitals matter)"
        )
    return value


def _name(value: str) -> str:
    if not re.fullmatch("[A-Za-z0-9][A-Za-z0-9._-]{0,63}", value) or re.fullmatch("[0-9a-f]{32}", value):
        raise ValueError("1 to 64 letters, digits, '.', '_' or '-', the first a letter or digit; not an identifier")
    return value


def _host(value: str) -> str:
    is_name = len(value) <= 253 and all(_LABEL.fullmatch(label) for label in value.rstrip(".").split("."))
    is_ipv6 = ":" in value and re.fullmatch(r"[0-9A-Fa-f:.]{2,45}", value)
    if not (is_name or is_ipv6):
        raise ValueError("a host name or an IP address, without scheme, port or path")
    return value


def _file(value: str) -> str:
    if not value or "\0" in value or ".." in value.split("/"):
        raise ValueError("the name of a file in the secrets folder, or an absolute path; '..' is not allowed")
    return value


AeTitle = Annotated[str, AfterValidator(_ae_title)]
Host = Annotated[str, AfterValidator(_host)]
SecretFile = Annotated[str, AfterValidator(_file)]


class Tls(Spec):
    """An association over TLS. Files: names in the secrets folder (TOMOSIM_SECRETS_FOLDER), or absolute paths."""

    verify: bool = Field(True, description="whether the peer's certificate must be valid for its name")
    ca_file: SecretFile | None = Field(None, description="PEM: who signs the peer's certificate; null: the system's")
    certificate_file: SecretFile | None = Field(None, description="PEM: our certificate, where the peer asks for one")
    key_file: SecretFile | None = Field(None, description="PEM: its private key; null: in the certificate's file")
    server_name: Host | None = Field(None, description="name in the peer's certificate; null: the host")

    @model_validator(mode="after")
    def _key_has_certificate(self) -> Self:
        if self.key_file is not None and self.certificate_file is None:
            raise ValueError("key_file is given without certificate_file: name both, or neither")
        return self


class Limits(Spec):
    """What a destination is asked for at most."""

    bandwidth_MBps: float | None = quantity("sent a second, all associations together; null: as fast as it goes",
                                            unit="MB/s", default=None, gt=0.001, le=10_000)  # fmt: skip
    associations: int = Field(1, ge=1, le=16, description="associations open at the same time")
    connect_seconds: float = quantity("for the connection and its TLS", unit="s", default=10.0, ge=0.1, le=300)
    negotiate_seconds: float = quantity("for the answer to the association request", unit="s", default=30.0, ge=0.1,
                                        le=300)  # fmt: skip
    response_seconds: float = quantity("for the answer to a stored instance", unit="s", default=180.0, ge=0.1, le=3600)
    stall_seconds: float = quantity("a peer that takes no byte for longer has stalled", unit="s", default=60.0, ge=0.1,
                                    le=3600)  # fmt: skip
    maximum_pdu: int = quantity("largest PDU that is sent, where the peer allows it", unit="byte", default=262_144,
                                ge=4096, le=1_048_576)  # fmt: skip
    attempts: int = Field(8, ge=1, le=100, description="how often is tried without any success before it has failed")
    backoff_seconds: float = quantity("until the second attempt; doubled for every further one, at most 600 s",
                                      unit="s", default=5.0, ge=0.1, le=600)  # fmt: skip


class Destination(Spec):
    """What an administrator says of a destination."""

    name: Annotated[str, AfterValidator(_name)] = Field(description="unique; for people and commands")
    host: Host = Field(description="host name or IP address")
    port: int = Field(ge=1, le=65535)
    called_aet: AeTitle = Field(description="AE title of the peer")
    calling_aet: AeTitle = Field("TOMOSIM", description="our AE title; many peers store only from titles they know")
    tls: Tls | None = Field(None, description="null: without TLS")
    limits: Limits = Limits()
    transfer_syntaxes: list[TransferSyntax] = Field(
        [],
        max_length=len(TRANSFER_SYNTAX_UIDS),
        description="what may be sent, the preferred first; files are sent as they are or decompressed, never "
        "compressed on the way; empty: as they are, decompressed where the peer refuses that",
    )

    commitment_seconds: float | None = quantity(
        "storage commitment is asked for, and its report waited for so long; null: not asked for", unit="s",
        default=None, ge=0.1, le=86_400,
    )  # fmt: skip

    @model_validator(mode="after")
    def _something_can_be_sent(self) -> Self:
        if self.transfer_syntaxes and not {"explicit", "implicit"} & set(self.transfer_syntaxes):
            raise ValueError("transfer_syntaxes: name 'explicit' or 'implicit' too; most files are not compressed")
        return self
