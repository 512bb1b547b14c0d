"""Metadata of an instance in the DICOM JSON model: bulk data stands as its address."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

from pydicom.dataelem import DataElement
from pydicom.dataset import Dataset

from simcore.store.hashing import FileRef
from simcore.store.store import Store
from worker.dicom_index.files import open_stored, read_header
from worker.dicom_index.index import Pixels

BULK_BYTES = 1023
"""Binary values that are longer stand as an address."""

_BULK_CHARACTERS = 4 * BULK_BYTES // 3
"""The same limit for base64 text, by which pydicom measures."""

_BINARY = ("OB", "OD", "OF", "OL", "OV", "OW", "UN")


@lru_cache(maxsize=128)
def metadata_json(store: Store, ref: FileRef, url: str) -> bytes:
    """The metadata of a file as JSON text.

    ref: of a stored file, whose content never changes. url: address of the instance.
    raises: OSError
    """
    with open_stored(store, ref) as file:
        header = read_header(file)
    addresses = {id(element): f"{url}/bulkdata/{where}" for where, element in bulk_elements(header.dataset)}
    model: dict[str, Any] = header.dataset.to_json_dict(_BULK_CHARACTERS, lambda element: addresses[id(element)])
    model["00083002"] = {"vr": "UI", "Value": [header.transfer_syntax]}
    if header.pixels is not None:
        model[header.pixels.tag] = {"vr": header.pixels.vr, "BulkDataURI": f"{url}/bulkdata/{header.pixels.tag}"}
    return json.dumps(dict(sorted(model.items()))).encode()


def bulk_elements(dataset: Dataset, prefix: str = "") -> Iterator[tuple[str, DataElement]]:
    """The long binary elements with their place: tag, or tag/item/tag and so on."""
    for element in dataset:
        where = f"{prefix}{element.tag:08X}"
        if element.VR == "SQ":
            for number, item in enumerate(element.value, 1):
                yield from bulk_elements(item, f"{where}/{number}/")
        elif element.VR in _BINARY and len(element.value or b"") > BULK_BYTES:
            yield where, element


def bulk_value(store: Store, ref: FileRef, where: str) -> bytes | None:
    """The value of a long binary element that is not the pixel data; None where there is none at that place."""
    with open_stored(store, ref) as file:
        dataset = read_header(file).dataset
    return next((bytes(element.value) for place, element in bulk_elements(dataset) if place == where), None)


def is_pixel_data(pixels: Pixels | None, where: str) -> bool:
    """Whether ``where`` is the place of the pixel data."""
    return pixels is not None and pixels.tag == where.upper()
