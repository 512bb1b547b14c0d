"""What a client accepts: media types, multipart or not, transfer syntaxes (PS3.18, sections 8.7 and 8.8)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from fastapi import Request
from pydicom.uid import ExplicitVRLittleEndian, JPEGLSLossless, JPEGLSNearLossless, RLELossless

from api.http.errors import ApiError

DICOM = "application/dicom"
JSON = "application/dicom+json"
OCTETS = "application/octet-stream"
RELATED = "multipart/related"

MAX_HEADER = 4000
DEFAULT_SYNTAX = str(ExplicitVRLittleEndian)

COMPRESSED_TYPES = {
    str(RLELossless): ("image/dicom-rle", "image/x-dicom-rle", "image/dicom+rle"),
    str(JPEGLSLossless): ("image/jls", "image/x-jls"),
    str(JPEGLSNearLossless): ("image/jls", "image/x-jls"),
}
"""Media types of a compressed frame, by transfer syntax; the first one is that of the standard."""

_TOKEN = r"[^\s;,=\"]+"
_PARAMETER = re.compile(rf'\s*;\s*({_TOKEN})\s*=\s*(?:"((?:[^"\\]|\\.)*)"|([^\s;,"]*))')
_TYPE = re.compile(rf"\s*({_TOKEN})")


@dataclass(frozen=True)
class MediaRange:
    """One acceptable media type; of a multipart one, ``type`` is that of the parts."""

    type: str
    multipart: bool
    transfer_syntax: str | None
    quality: float

    def covers(self, *types: str) -> bool:
        """Whether one of ``types`` lies in the range."""
        if self.type in ("*/*", "*"):
            return True
        kind, _, rest = self.type.partition("/")
        if rest in ("*", ""):  # "image/" is what dicomweb-client allows as well
            return any(t.startswith(kind + "/") for t in types)
        return self.type in types


@dataclass(frozen=True)
class Representation:
    """How a resource is sent.

    stored: as it lies in the file; else uncompressed, explicit VR, little endian. media_type: of a part.
    """

    media_type: str
    multipart: bool
    stored: bool


def parse(header: str) -> list[MediaRange]:
    """The acceptable media types, the most wanted first. What is malformed is passed over."""
    if len(header) > MAX_HEADER:
        raise ApiError(400, "bad-accept", f"Accept has {len(header)} characters; at most {MAX_HEADER} are read")
    ranges = []
    position = 0
    while position < len(header):
        match = _TYPE.match(header, position)
        if match is None:
            position += 1
            continue
        position = match.end()
        parameters: dict[str, str] = {}
        while parameter := _PARAMETER.match(header, position):
            position = parameter.end()
            quoted = parameter[2]
            value = parameter[3] if quoted is None else re.sub(r"\\(.)", r"\1", quoted)
            parameters.setdefault(parameter[1].lower(), value.strip())
        end = header.find(",", position)
        position = len(header) if end < 0 else end + 1
        ranges.append(_range(match[1].lower(), parameters))
    acceptable = [r for r in ranges if r.quality > 0]
    return sorted(acceptable, key=lambda r: -r.quality)


def _range(name: str, parameters: Mapping[str, str]) -> MediaRange:
    multipart = name.startswith("multipart/")
    try:
        quality = min(max(float(parameters.get("q", "1")), 0.0), 1.0)
    except ValueError:
        quality = 1.0
    kind = parameters.get("type", "*/*").lower() if multipart else name
    return MediaRange(kind or "*/*", multipart, parameters.get("transfer-syntax") or None, quality)


def acceptable(request: Request) -> list[MediaRange]:
    """What the request accepts: the query parameter ``accept`` or else the header; everything where neither is."""
    header = ", ".join(request.query_params.getlist("accept")) or ", ".join(request.headers.getlist("accept"))
    return parse(header) if header.strip() else parse("*/*")


def choose_json(request: Request) -> str:
    """The media type of metadata and search results. raises: ApiError 406"""
    for accepted in acceptable(request):
        if not accepted.multipart:
            for kind in (JSON, "application/json"):
                if accepted.covers(kind):
                    return kind
    raise not_acceptable(f"{JSON} (application/json as well)")


def choose_dicom(request: Request, syntaxes: set[str], count: int) -> Representation:
    """How whole objects are sent.

    syntaxes: transfer syntaxes they are stored in. count: of objects; only one alone can be sent without multipart.
    raises: ApiError 406
    """
    for accepted in acceptable(request):
        multipart = accepted.multipart or accepted.type in ("*/*", "*", "application/*")
        if not accepted.covers(DICOM) or (not multipart and count > 1):
            continue
        syntax = accepted.transfer_syntax or DEFAULT_SYNTAX
        if syntax == "*" or syntaxes == {syntax}:
            return Representation(DICOM, multipart, stored=True)
        if syntax == DEFAULT_SYNTAX:
            return Representation(DICOM, multipart, stored=False)
    single = f", {DICOM}" if count == 1 else ""
    raise not_acceptable(f'{RELATED}; type="{DICOM}"{single}, with transfer-syntax={DEFAULT_SYNTAX} (default) or *')


def choose_pixels(request: Request, syntax: str, count: int) -> Representation:
    """How frames and other bulk data are sent.

    syntax: transfer syntax of the file. count: of parts; only one alone can be sent without multipart.
    raises: ApiError 406
    """
    compressed = COMPRESSED_TYPES.get(syntax, ())
    for accepted in acceptable(request):
        multipart = accepted.multipart or accepted.type in ("*/*", "*")
        if not multipart and count > 1:
            continue
        transfer_syntax = accepted.transfer_syntax
        if accepted.covers(OCTETS):
            if transfer_syntax in (None, DEFAULT_SYNTAX) or (transfer_syntax == "*" and not compressed):
                return Representation(OCTETS, multipart, stored=not compressed)
            if transfer_syntax in ("*", syntax):
                kind = OCTETS if accepted.type == OCTETS else compressed[0]
                return Representation(kind, multipart, stored=True)
        elif accepted.covers(*compressed) and transfer_syntax in (None, "*", syntax):
            kind = accepted.type if accepted.type in compressed else compressed[0]
            return Representation(kind, multipart, stored=True)
    kinds = ", ".join(f'{RELATED}; type="{kind}"' for kind in (OCTETS, *compressed[:1]))
    raise not_acceptable(f"{kinds}; without multipart for one frame")


def choose_picture(request: Request) -> tuple[str, bool]:
    """(media type, whether multipart) of a rendered frame. raises: ApiError 406"""
    for accepted in acceptable(request):
        for kind in ("image/jpeg", "image/png"):
            if accepted.covers(kind):
                return kind, accepted.multipart
    raise not_acceptable("image/jpeg, image/png")


def not_acceptable(offered: str) -> ApiError:
    """The answer where nothing that is accepted can be made."""
    return ApiError(406, "not-acceptable", f"nothing that Accept allows can be sent; there is: {offered}")
