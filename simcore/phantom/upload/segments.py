"""Names of the segments of a 3D Slicer segmentation (.seg.nrrd), and the tissues they mean."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from typing import IO

from simcore.core.errors import SpecError
from simcore.phantom.upload.formats import nrrd
from simcore.phantom.upload.formats.decoding import head_of
from simcore.phantom.upload.tissue_maps import NAMES

WORDS = {
    "air": ("air", "background", "outside"),
    "adipose": ("adipose", "adipose tissue", "fat", "fatty tissue"),
    "gland": (
        "gland",
        "glandular",
        "glandular tissue",
        "fibroglandular",
        "fibroglandular tissue",
        "fgt",
        "dense tissue",
    ),
    "skin": ("skin",),
    "ligament": ("ligament", "ligaments", "coopers ligament", "coopers ligaments"),
    "mass": ("mass", "tumour", "tumor", "lesion", "cancer"),
    "calcification": ("calcification", "calcifications", "microcalcification", "microcalcifications"),
    "muscle": ("muscle", "pectoral muscle", "pectoralis", "chest wall"),
    "nipple": ("nipple",),
    "duct": ("duct", "ducts"),
    "tdlu": ("tdlu", "lobule", "lobules"),
    "artery": ("artery", "arteries"),
    "vein": ("vein", "veins"),
    "paddle": ("paddle", "paddles", "plate", "plates", "compression paddle", "compression plates"),
}
"""What people call each tissue, in lower case and without signs; with a number behind it, it is the same."""

_MEANT = {word: tissue for tissue, words in WORDS.items() for word in words}


def names(file: IO[bytes]) -> dict[int, str]:
    """The segments in the header of an NRRD file, packed as a whole or not, {value: name}; none where it is no
    segmentation."""
    head = head_of(file)
    if not head.startswith(nrrd.MAGIC):
        return {}
    head = re.split(rb"\r?\n\r?\n", head, maxsplit=1)[0]
    fields: dict[tuple[str, str], str] = {}
    for line in head.decode("utf-8", "replace").splitlines():
        match = re.fullmatch(r"Segment(\d+)_(Name|LabelValue)\s*:=\s*(.*?)\s*", line)
        if match:
            fields[match[1], match[2]] = match[3]
    return {
        int(value): fields[number, "Name"]
        for (number, what), value in fields.items()
        if what == "LabelValue" and value.isascii() and value.isdigit() and (number, "Name") in fields
    }


def tissue_of(name: str) -> str | None:
    """The tissue that a name means, or None."""
    words = " ".join(re.sub(r"[^a-z ]+", " ", name.lower().replace("'", "")).split())
    return _MEANT.get(words)


def tissue_map(segments: dict[int, str]) -> dict[str, str]:
    """The tissue map that the names mean, with 0 as air where no segment has it.

    raises: SpecError with a map to be completed, where a name means no tissue.
    """
    meant = {value: tissue_of(name) for value, name in sorted(segments.items())}
    proposal = {"0": "air"} | {str(value): tissue or "?" for value, tissue in meant.items()}
    unknown = [value for value, tissue in meant.items() if tissue is None]
    if unknown:
        message = (
            f"the file names its segments, but not all by a tissue: {_listed(segments, unknown)}; give the tissue map "
            f"{json.dumps(proposal)} with a tissue for each '?': {', '.join(NAMES)}"
        )
        raise SpecError(
            f"phantom.tissues: {message}",
            code="unknown-segment",
            problems=[{"field": "phantom.tissues", "value": unknown[0], "message": message}],
        )
    return proposal


def _listed(segments: dict[int, str], values: Iterable[int]) -> str:
    return ", ".join(f"{value} = {segments[value]!r}" for value in values)
