"""QIDO-RS query strings: what is searched for, what is wanted of a result, how many (PS3.18, section 8.3.4)."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from pydicom.datadict import keyword_for_tag, tag_for_keyword
from pydicom.tag import Tag

from api.http.errors import MAX_SHOWN, ApiError
from worker.dicom_index.index import Condition
from worker.records.dicom import KEYS, Key, Level

MAX_RESULTS = 1000
"""Results of one answer, at most; also where no limit is given."""

MAX_OFFSET = 10**9
MAX_VALUE = 1024
MAX_WILDCARDS = 8
MAX_VALUES = 2000

COMMA_LISTS = ("Modality", "ModalitiesInStudy", "PatientSex")
"""Codes: they hold no comma, and clients (OHIF) separate several by one."""

UID = re.compile(r"[0-9.]{1,64}")
FRAMES = re.compile(r"[0-9]{1,9}(,[0-9]{1,9})*")
_TAG = re.compile(r"[0-9A-Fa-f]{8}")
_NUMBER = re.compile(r"[+-]?[0-9]{1,9}")
_DATE = re.compile(r"[0-9]{8}")
_TIME = re.compile(r"[0-9]{2}(?:[0-9]{2}(?:[0-9]{2}(?:\.[0-9]{1,6})?)?)?")
_CONTROL = re.compile(r"[\x00-\x1f\x7f]")

_DEPTH: dict[Level, int] = {"study": 0, "series": 1, "instance": 2}

_UNSUPPORTED = {
    "fuzzymatching": "The fuzzymatching parameter is not supported. Only literal matching has been performed.",
    "emptyvaluematching": "The emptyvaluematching parameter is not supported. Empty Value Matching has not been "
    "performed.",
    "multiplevaluematching": "The multiplevaluematching parameter is not supported. Multiple Value Matching has not "
    "been performed.",
}
"""Texts of the standard for what is asked for and not done."""


@dataclass
class Query:
    """A search. include: tags wanted beside the usual ones, all of them where ``include_all``."""

    level: Level
    conditions: list[Condition] = field(default_factory=list)
    include: set[str] = field(default_factory=set)
    include_all: bool = False
    limit: int = MAX_RESULTS
    offset: int = 0
    warnings: list[str] = field(default_factory=list)


def parse(level: Level, parameters: Iterable[tuple[str, str]]) -> Query:
    """The query of the parameters of a URL.

    raises: ApiError 400 naming the parameter, its value and what is allowed
    """
    query = Query(level)
    merged: dict[str, list[str]] = {}
    for name, value in parameters:
        if _CONTROL.search(value):
            raise bad_query(name, value, "text without control characters")
        lower = name.lower()
        if lower in _UNSUPPORTED:
            if _boolean(name, value):
                query.warnings.append(_UNSUPPORTED[lower])
        elif lower == "limit":
            query.limit = min(_integer(name, value, 1, MAX_OFFSET), MAX_RESULTS)
        elif lower == "offset":
            query.offset = _integer(name, value, 0, MAX_OFFSET)
        elif lower == "includefield":
            _include(query, name, value)
        elif lower not in ("accept", "charset"):
            merged.setdefault(_attribute(name), []).append(value)
    for keyword, values in merged.items():
        _add(query, keyword, values)
    return query


def _add(query: Query, keyword: str, values: list[str]) -> None:
    """The condition that one attribute must meet; none where every value of it is wanted."""
    if query.level == "study" and keyword == "Modality":
        keyword = "ModalitiesInStudy"
    key = KEYS.get(keyword)
    if key is None or _DEPTH[key.level] > _DEPTH[query.level]:
        query.warnings.append(
            f"Matching by {keyword} is not supported for this resource. The parameter has been ignored."
        )
        return
    query.include.add(_hexadecimal(keyword))
    if key.kind != "uid" and any(len(value) > MAX_VALUE for value in values):
        raise bad_query(keyword, max(values, key=len), f"at most {MAX_VALUE} characters")
    parts = [part for value in values for part in _split(keyword, key, value)]
    if not parts or any(part.strip("*") == "" for part in parts):
        return
    if len(parts) > MAX_VALUES:
        raise bad_query(keyword, f"{len(parts)} values", f"at most {MAX_VALUES} values")
    query.conditions.append(_condition(keyword, key, parts))


def _split(keyword: str, key: Key, value: str) -> list[str]:
    separators = r"[\\,]" if key.kind == "uid" or keyword in COMMA_LISTS else r"\\"
    return [part.strip() for part in re.split(separators, value)]


def _condition(keyword: str, key: Key, parts: list[str]) -> Condition:
    match key.kind:
        case "uid":
            _require(keyword, parts, UID, "unique identifiers of digits and dots, separated by commas")
        case "number":
            _require(keyword, parts, _NUMBER, "whole numbers")
        case "date":
            return Condition(keyword, span=_span(keyword, parts, _DATE, "YYYYMMDD"))
        case "time":
            return Condition(keyword, span=_time_span(_span(keyword, parts, _TIME, "HHMMSS")))
        case "text":
            parts = [re.sub(r"\*+", "*", part) for part in parts]
            for part in parts:
                if part.count("*") > MAX_WILDCARDS:
                    raise bad_query(keyword, part, f"at most {MAX_WILDCARDS} wildcards *")
    return Condition(keyword, values=tuple(parts))


def _span(keyword: str, parts: list[str], form: re.Pattern[str], name: str) -> tuple[str | None, str | None]:
    """One value, or first-last with either end left out."""
    allowed = f"{name}, {name}-{name}, {name}- or -{name}"
    if len(parts) != 1:
        raise bad_query(keyword, "\\".join(parts), allowed)
    low, dash, high = (part.strip() for part in parts[0].partition("-"))
    ends = [low, high] if dash else [low, low]
    if not any(ends) or any(end and not form.fullmatch(end) for end in ends):
        raise bad_query(keyword, parts[0], allowed)
    return ends[0] or None, ends[1] or None


def _time_span(span: tuple[str | None, str | None]) -> tuple[str | None, str | None]:
    """The first and the last moment of times that may leave out minutes, seconds and fractions."""
    low, high = span
    first = None if low is None else low.split(".")[0].ljust(6, "0") + low[6:]
    last = None if high is None else high + "235959.999999"[len(high) :]
    return first, last


def _include(query: Query, name: str, value: str) -> None:
    for part in (p.strip() for p in value.split(",")):
        if part.lower() == "all":
            query.include_all = True
        elif part:
            query.include.add(_hexadecimal(_attribute(part, of=name)))


def _attribute(name: str, of: str | None = None) -> str:
    """The keyword (or for one that has none, the tag) that a name stands for; of a path only the first part counts."""
    first = name.split(".")[0]
    if _TAG.fullmatch(first):
        return keyword_for_tag(Tag(int(first, 16))) or first.upper()
    if len(first) <= 64 and tag_for_keyword(first) is not None:
        return first
    raise bad_query(of or "parameter", name, "a DICOM keyword (PatientID) or tag (00100020)", "unknown-attribute")


def _hexadecimal(keyword: str) -> str:
    tag = tag_for_keyword(keyword)
    return keyword if tag is None else f"{tag:08X}"


def _require(keyword: str, values: list[str], form: re.Pattern[str], allowed: str) -> None:
    for value in values:
        if not form.fullmatch(value):
            raise bad_query(keyword, value, allowed)


def _boolean(name: str, value: str) -> bool:
    if value.lower() not in ("true", "false"):
        raise bad_query(name, value, "true or false")
    return value.lower() == "true"


def _integer(name: str, value: str, least: int, most: int) -> int:
    # What int() takes is too much: "1_000", digits of other scripts.
    if not re.fullmatch("[0-9]{1,10}", value) or not least <= int(value) <= most:
        raise bad_query(name, value, f"a whole number from {least} to {most}")
    return int(value)


def bad_query(name: str, value: Any, allowed: str, code: str = "bad-query") -> ApiError:
    """The answer to a query parameter that cannot be understood."""
    shown = str(value)[:MAX_SHOWN]
    return ApiError(
        400,
        code,
        f"{name[:MAX_SHOWN]} = {shown!r}: {allowed}",
        errors=[{"parameter": name[:MAX_SHOWN], "value": shown, "detail": f"allowed: {allowed}"}],
    )
