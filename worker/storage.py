"""The stage store of the settings: a folder, or object storage with a folder as its cache."""

from __future__ import annotations

from simcore.core.bucket import Location
from simcore.core.store import Store
from worker.settings import Settings


def open_store(settings: Settings) -> Store:
    """raises: StoreError where the folder cannot be made or the URL is none"""
    if not settings.store_url:
        return Store(settings.store_folder, settings.min_free_bytes)
    from simcore.core.object_store import ObjectStore

    return ObjectStore(
        settings.store_folder,
        location(settings),
        settings.min_free_bytes,
        settings.store_cache_bytes,
        settings.gc_grace_seconds / 2,
    )


def location(settings: Settings) -> Location:
    """Where the object storage of the settings is."""
    return Location(settings.store_url, settings.store_endpoint, settings.store_access_key, settings.store_secret_key)
