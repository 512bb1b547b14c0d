"""The stage store of the settings: a folder, or object storage with a folder as its cache."""

from __future__ import annotations

from functools import partial

from simcore.store.bucket import Location
from simcore.store.bucket_backend import BucketBackend
from simcore.store.store import Store
from worker.settings import Settings


def open_store(settings: Settings) -> Store:
    """raises: StoreError where the folder cannot be made or the URL is none"""
    if not settings.store_url:
        return Store(settings.store_folder, settings.min_free_bytes)
    backend = partial(
        BucketBackend,
        location=location(settings),
        cache_bytes=settings.store_cache_bytes,
        touch_seconds=settings.gc_grace_seconds / 2,
    )
    return Store(settings.store_folder, settings.min_free_bytes, backend)


def location(settings: Settings) -> Location:
    """Where the object storage of the settings is."""
    return Location(settings.store_url, settings.store_endpoint, settings.store_access_key, settings.store_secret_key)
