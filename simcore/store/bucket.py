"""What the store asks of S3-compatible object storage, with errors that say what to change.

Conditional writes (``If-None-Match: *``, ``If-Match``) are what locks and marks of use are made of: AWS, MinIO, Ceph
and others have them. Needs boto3: the extra ``s3``.
"""

from __future__ import annotations

import random
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from email.utils import parsedate_to_datetime
from pathlib import Path
from typing import Any

from simcore.core.errors import StoreError

PART_BYTES = 16 << 20
"""Larger files go up and come down in parts of this size, several at a time."""

PARTS_AT_A_TIME = 8
PIECE_BYTES = 1 << 20
CONNECT_SECONDS = 5
READ_SECONDS = 60
ATTEMPTS = 4

_MISSING = ("404", "NoSuchKey", "NotFound")
_OVERTAKEN = ("412", "PreconditionFailed")
_CONFLICT = ("409", "ConditionalRequestConflict")
"""Another write is under way; whether the condition holds is not known yet."""

CONFLICT_SECONDS = 20.0
"""A conditional write is asked for again for so long while others are under way."""


@dataclass(frozen=True)
class Location:
    """Where a store lies.

    url: s3://bucket/prefix. endpoint: URL of the service; empty: AWS. access_key, secret_key: empty: those that
    boto3 finds (AWS_ACCESS_KEY_ID, AWS_SHARED_CREDENTIALS_FILE, the role of the machine).
    """

    url: str
    endpoint: str = ""
    access_key: str = ""
    secret_key: str = field(default="", repr=False)

    @property
    def bucket(self) -> str:
        return self._parts()[0]

    @property
    def prefix(self) -> str:
        """Begin of every key: empty, or with a slash at its end."""
        return self._parts()[1]

    def _parts(self) -> tuple[str, str]:
        match = re.fullmatch(r"s3://([a-z0-9][a-z0-9.-]{1,61}[a-z0-9])(?:/(.*))?", self.url)
        if match is None:
            raise StoreError(f"{self.url!r} is no store: s3://bucket or s3://bucket/prefix", code="invalid-store-url")
        prefix = (match[2] or "").strip("/")
        return match[1], f"{prefix}/" if prefix else ""


@dataclass(frozen=True)
class Head:
    """What is known of an object. age: seconds since it was written, by the clock of the service."""

    name: str
    size: int
    tag: str
    modified: float
    age: float


class Bucket:
    """Objects below the prefix of a location; names are without it. Safe for many threads."""

    def __init__(self, location: Location) -> None:
        self.location = location
        self._name = location.bucket
        self._prefix = location.prefix
        self._client = _client(location)

    def get(self, name: str) -> tuple[bytes, Head] | None:
        """Content of a small object; None where there is none."""
        with self._errors():
            try:
                answer = self._client.get_object(Bucket=self._name, Key=self._prefix + name)
                return answer["Body"].read(), _head(name, answer)
            except self._client.exceptions.ClientError as error:
                _only_if(error, _MISSING)
                return None

    def head(self, name: str) -> Head | None:
        """None where there is no such object."""
        with self._errors():
            try:
                return _head(name, self._client.head_object(Bucket=self._name, Key=self._prefix + name))
            except self._client.exceptions.ClientError as error:
                _only_if(error, _MISSING)
                return None

    def put(self, name: str, content: bytes, tag: str | None = None, fresh: bool = False) -> str | None:
        """Writes a small object; its tag.

        tag: only over an object with this tag. fresh: only where there is none. None: that was not so.
        """
        condition = {"IfNoneMatch": "*"} if fresh else {"IfMatch": tag} if tag is not None else {}
        with self._errors():
            try:
                arguments = {"Body": content, "ChecksumAlgorithm": "SHA256", **condition}
                return str(self._settled(self._client.put_object, name, arguments)["ETag"])
            except self._client.exceptions.ClientError as error:
                _only_if(error, _OVERTAKEN + (_MISSING if tag is not None else ()))
                return None

    def delete(self, name: str, tag: str | None = None) -> bool:
        """Removes an object. tag: only where it has this tag; False: it had another one."""
        condition = {} if tag is None else {"IfMatch": tag}
        with self._errors():
            try:
                self._settled(self._client.delete_object, name, condition)
            except self._client.exceptions.ClientError as error:
                _only_if(error, _OVERTAKEN + _MISSING)
                return _code(error) in _MISSING
        return True

    def _settled(self, write: Callable[..., Any], name: str, arguments: dict[str, Any]) -> Any:
        """The answer to a write, asked for again as long as it only says that another one is under way."""
        end = time.monotonic() + CONFLICT_SECONDS
        while True:
            try:
                return write(Bucket=self._name, Key=self._prefix + name, **arguments)
            except self._client.exceptions.ClientError as error:
                if _code(error) not in _CONFLICT or time.monotonic() > end:
                    raise
            time.sleep(random.uniform(0.02, 0.1))

    def upload(self, path: Path, name: str) -> None:
        """Writes a file of any size; the service compares the SHA-256 of what it received."""
        with self._errors():
            extra = {"ChecksumAlgorithm": "SHA256"}
            self._client.upload_file(str(path), self._name, self._prefix + name, ExtraArgs=extra, Config=_transfer())

    def download(self, name: str, path: Path) -> bool:
        """Reads an object into a file; False where there is none."""
        with self._errors():
            try:
                self._client.download_file(self._name, self._prefix + name, str(path), Config=_transfer())
            except self._client.exceptions.ClientError as error:
                _only_if(error, _MISSING)
                return False
        return True

    def stream(self, name: str, start: int, length: int) -> Iterator[bytes]:
        """Some bytes of an object, piece by piece. raises: StoreError "object-missing" """
        if length == 0:
            return
        with self._errors():
            try:
                span = f"bytes={start}-{start + length - 1}"
                answer = self._client.get_object(Bucket=self._name, Key=self._prefix + name, Range=span)
            except self._client.exceptions.ClientError as error:
                _only_if(error, _MISSING)
                raise StoreError(f"{name} is not in {self.location.url} any more", code="object-missing") from None
            yield from answer["Body"].iter_chunks(PIECE_BYTES)

    def list(self, prefix: str) -> Iterator[Head]:
        """All objects whose name begins so. Their age is not asked for: 0."""
        with self._errors():
            pages = self._client.get_paginator("list_objects_v2")
            for page in pages.paginate(Bucket=self._name, Prefix=self._prefix + prefix):
                for item in page.get("Contents", ()):
                    name = item["Key"].removeprefix(self._prefix)
                    yield Head(name, item["Size"], item["ETag"], item["LastModified"].timestamp(), 0.0)

    def abort_uploads(self, before: float) -> None:
        """Removes the parts of uploads that were begun before then and never came to an end."""
        with self._errors():
            answer = self._client.list_multipart_uploads(Bucket=self._name, Prefix=self._prefix)
            for upload in answer.get("Uploads", ()):
                if upload["Initiated"].timestamp() < before:
                    self._client.abort_multipart_upload(
                        Bucket=self._name, Key=upload["Key"], UploadId=upload["UploadId"]
                    )

    def make(self) -> None:
        """Makes the bucket where there is none."""
        with self._errors():
            try:
                region = self._client.meta.region_name
                elsewhere = {} if region == "us-east-1" else {"LocationConstraint": region}
                where = {"CreateBucketConfiguration": elsewhere} if elsewhere else {}
                self._client.create_bucket(Bucket=self._name, **where)
            except (
                self._client.exceptions.BucketAlreadyOwnedByYou,
                self._client.exceptions.BucketAlreadyExists,
            ):
                pass

    def check(self) -> None:
        """raises: StoreError where the bucket is not there or may not be used."""
        with self._errors():
            self._client.head_bucket(Bucket=self._name)

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """What botocore raises as a StoreError "store-unavailable"."""
        from boto3.exceptions import Boto3Error
        from botocore.exceptions import BotoCoreError, ClientError, HTTPClientError, NoCredentialsError

        where = f"the store {self.location.url}" + (f" at {self.location.endpoint}" if self.location.endpoint else "")
        try:
            yield
        except NoCredentialsError as error:
            raise StoreError(
                f"{where}: no credentials; set TOMOSIM_STORE_ACCESS_KEY and TOMOSIM_STORE_SECRET_KEY (or ..._FILE), "
                "or what boto3 reads (AWS_ACCESS_KEY_ID, AWS_SHARED_CREDENTIALS_FILE)",
                code="store-unavailable",
            ) from error
        except ClientError as error:
            advice = _ADVICE.get(_code(error), "")
            raise StoreError(f"{where} refused: {error}{advice}", code="store-unavailable") from error
        except (Boto3Error, BotoCoreError, HTTPClientError) as error:
            raise StoreError(f"{where} cannot be used: {error}", code="store-unavailable") from error


_ADVICE = {
    "404": ": there is no such bucket; make it, or change TOMOSIM_STORE_URL",
    "NoSuchBucket": ": make the bucket, or change TOMOSIM_STORE_URL",
    "403": ": the credentials may not use this bucket",
    "AccessDenied": ": the credentials may not do that in this bucket",
    "InvalidAccessKeyId": ": check TOMOSIM_STORE_ACCESS_KEY",
    "SignatureDoesNotMatch": ": check TOMOSIM_STORE_SECRET_KEY",
}


def _client(location: Location) -> Any:
    try:
        import boto3
        from botocore.config import Config
    except ImportError:
        raise StoreError(
            f"the store {location.url} needs boto3: pip install 'tomosim[s3]'", code="store-unavailable"
        ) from None
    config = Config(
        connect_timeout=CONNECT_SECONDS,
        read_timeout=READ_SECONDS,
        retries={"mode": "standard", "max_attempts": ATTEMPTS},
        max_pool_connections=2 * PARTS_AT_A_TIME,
        s3={"addressing_style": "path" if location.endpoint else "auto"},
        # Not every service knows the checksums that newer clients send unasked.
        request_checksum_calculation="when_required",
        response_checksum_validation="when_required",
    )
    keys = {"aws_access_key_id": location.access_key, "aws_secret_access_key": location.secret_key}
    session = boto3.Session(**(keys if location.access_key else {}))
    region = session.region_name or "us-east-1"
    return session.client("s3", endpoint_url=location.endpoint or None, region_name=region, config=config)


def _transfer() -> Any:
    from boto3.s3.transfer import TransferConfig

    return TransferConfig(
        multipart_threshold=PART_BYTES, multipart_chunksize=PART_BYTES, max_concurrency=PARTS_AT_A_TIME
    )


def _head(name: str, answer: dict[str, Any]) -> Head:
    modified = answer["LastModified"].timestamp()
    headers = answer["ResponseMetadata"]["HTTPHeaders"]
    now = parsedate_to_datetime(headers["date"]).timestamp() if "date" in headers else modified
    return Head(name, answer["ContentLength"], answer["ETag"], modified, max(0.0, now - modified))


def _code(error: Any) -> str:
    return str(error.response.get("Error", {}).get("Code", ""))


def _only_if(error: Any, codes: tuple[str, ...]) -> None:
    """raises: the error, where it has none of these codes."""
    # A bucket that is not there answers a HEAD as an object that is not there does; ``Bucket.check`` tells them apart.
    if _code(error) not in codes:
        raise error
