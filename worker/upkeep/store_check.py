"""``tomosim store check``: whether the store of the settings does what the service asks of it."""

from __future__ import annotations

import contextlib
import uuid

from simcore.core.errors import StoreError
from simcore.store.bucket import Bucket
from worker.settings import Settings
from worker.storage import location, open_store


def check(settings: Settings, make: bool) -> str:
    """Tries the store out; what it is, in a line. make: makes the bucket where there is none.

    raises: StoreError
    """
    if not settings.store_url:
        store = open_store(settings)
        store.check()
        store.require_space(0)
        return f"the folder {store.root} can be used"
    bucket = Bucket(location(settings))
    if make:
        bucket.make()
    bucket.check()
    _try_out(bucket)
    return f"{settings.store_url} can be used: it writes, reads ranges, and refuses what would overwrite"


def _try_out(bucket: Bucket) -> None:
    name = f"check/{uuid.uuid4().hex}"
    try:
        tag = bucket.put(name, b"first", fresh=True)
        if bucket.put(name, b"second", fresh=True) is not None:
            raise _unfit(bucket, "If-None-Match")
        if bucket.put(name, b"third", tag='"0123456789abcdef0123456789abcdef"') is not None:
            raise _unfit(bucket, "If-Match")
        if tag is None or bucket.put(name, b"fourth", tag=tag) is None or b"".join(bucket.stream(name, 1, 3)) != b"our":
            raise StoreError(f"{bucket.location.url} does not give back what was written", code="store-unfit")
    finally:
        with contextlib.suppress(StoreError):
            bucket.delete(name)


def _unfit(bucket: Bucket, condition: str) -> StoreError:
    return StoreError(
        f"{bucket.location.url} writes although {condition} forbids it: machines could not tell one another what they "
        "compute, and what they use could be collected; take a service with conditional writes",
        code="store-unfit",
    )
