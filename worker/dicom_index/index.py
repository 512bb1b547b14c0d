"""Index of the DICOM objects of all cases: what DICOMweb searches, and where it finds an instance.

Unique identifiers hang on the content, so two cases that hold the same study hold the same files: the newest one
that has not expired is shown.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError

from simcore.store.hashing import FileRef
from worker.records.database import Repository, reading, simulations
from worker.records.dicom import KEYS, TABLES, Level, indexed, instances, series, studies
from worker.records.retention import ExpiredError, unexpired

Json = dict[str, Any]

Conditions = tuple[sa.ColumnElement[bool], ...]

LEVELS: tuple[Level, ...] = ("study", "series", "instance")


@dataclass(frozen=True)
class Condition:
    """One attribute must have one of ``values``, lie within ``span`` (either end may be open), or both are empty.

    Text values may hold the wildcards * and ?; letters match in both cases.
    """

    keyword: str
    values: tuple[str, ...] = ()
    span: tuple[str | None, str | None] | None = None


@dataclass(frozen=True)
class Found:
    """One result of a search: the attributes of its level and of those above, and its identifiers."""

    attributes: Json
    study: str
    series: str | None = None
    instance: str | None = None


@dataclass(frozen=True)
class Pixels:
    """Where the pixel data lies and how it is laid out.

    tag, vr: of the element, "7FE00010" and "OW" for instance. offset: of its value in the file, bytes.
    length: of its value, bytes; None where it is encapsulated. bits: allocated for one sample.
    """

    tag: str
    vr: str
    offset: int
    length: int | None
    frames: int
    rows: int
    columns: int
    samples: int
    bits: int

    @property
    def frame_bits(self) -> int:
        """Bits of an uncompressed frame."""
        return self.rows * self.columns * self.samples * self.bits

    @property
    def frame_bytes(self) -> int:
        """Bytes of an uncompressed frame that stands alone."""
        return (self.frame_bits + 7) // 8


@dataclass(frozen=True)
class Instance:
    """One stored object."""

    study: str
    series: str
    uid: str
    sop_class: str
    name: str
    file: FileRef
    transfer_syntax: str
    pixels: Pixels | None


@dataclass(frozen=True)
class Entry:
    """A file of a case as it goes into the index.

    columns: what is searched, by level. attributes: those of every level in the DICOM JSON model.
    """

    name: str
    file: FileRef
    columns: dict[Level, Json]
    attributes: dict[Level, Json]
    transfer_syntax: str
    pixels: Pixels | None


class DicomIndex(Repository):
    """Repository of the index."""

    def missing(self) -> tuple[str, Json] | None:
        """(identifier, manifest) of the oldest case that succeeded and is not in the index; None where all are."""
        known = sa.select(indexed.c.simulation_id)
        query = (
            sa.select(simulations.c.id, simulations.c.manifest)
            .where(simulations.c.state == "succeeded", unexpired(self.clock()), simulations.c.id.not_in(known))
            .order_by(simulations.c.created)
            .limit(1)
        )
        with reading(self.engine) as connection:
            row = connection.execute(query).one_or_none()
        return None if row is None else (row.id, row.manifest)

    def add(self, simulation_id: str, entries: Iterable[Entry], problem: str | None = None) -> bool:
        """Puts the objects of a case into the index; False where another process has, or the case is gone."""
        grouped: dict[str, dict[str, list[Entry]]] = defaultdict(lambda: defaultdict(list))
        for entry in entries:
            grouped[entry.columns["study"]["uid"]][entry.columns["series"]["uid"]].append(entry)
        try:
            with self.engine.begin() as connection:
                case = sa.select(simulations.c.id, sa.literal(problem, sa.Text)).where(
                    simulations.c.id == simulation_id
                )
                marked = indexed.insert().from_select(["simulation_id", "problem"], case)
                if not connection.execute(marked).rowcount:
                    return False
                for by_series in grouped.values():
                    _add_study(connection, simulation_id, by_series)
        except IntegrityError:
            return False
        return True

    def search(self, level: Level, conditions: Sequence[Condition], limit: int, offset: int) -> tuple[list[Found], int]:
        """The results number offset .. offset + limit, the newest study first, and how many there are in all."""
        clauses = [_clause(level, condition) for condition in conditions]
        base = _joined(level).where(*_shown(self.clock()), *clauses)
        columns: list[sa.ColumnElement[Any]] = [
            TABLES[name].c.attributes.label(f"{name}_attributes") for name in _down_to(level)
        ]
        columns += [TABLES[name].c.uid.label(f"{name}_uid") for name in _down_to(level)]
        if level == "study":
            columns += [studies.c.modalities, studies.c.series_count, studies.c.instance_count]
        if level == "series":
            columns += [series.c.instance_count]
        order = [studies.c.id.desc(), *([series.c.number, series.c.id] if level != "study" else [])]
        order += [instances.c.number, instances.c.id] if level == "instance" else []
        # The rows are long: which ones they are is found by the indexes alone.
        own = TABLES[level].c.id
        chosen = base.with_only_columns(own).order_by(*order).limit(limit).offset(offset).subquery()
        query = _joined(level).where(own.in_(sa.select(chosen.c.id))).with_only_columns(*columns).order_by(*order)
        with reading(self.engine) as connection:
            results = [_found(level, row) for row in connection.execute(query).mappings()]
            total = offset + len(results)
            if len(results) == limit or not results:
                total = connection.scalar(base.with_only_columns(sa.func.count())) or 0
        return results, total

    def instances(self, study: str, series_uid: str | None = None, instance: str | None = None) -> list[Instance]:
        """The objects of a study, of one of its series or one object; empty where there is none.

        raises: ExpiredError where there was.
        """
        objects = self._instances(_shown(self.clock()), study, series_uid, instance)
        if not objects and self._instances((), study, series_uid, instance):
            raise ExpiredError(f"the files of study {study}")
        return objects

    def _instances(self, which: Conditions, study: str, series_uid: str | None, instance: str | None) -> list[Instance]:
        query = _joined("instance").where(*which, studies.c.uid == study)
        if series_uid is not None:
            query = query.where(series.c.uid == series_uid)
        if instance is not None:
            query = query.where(instances.c.uid == instance)
        query = query.with_only_columns(
            *[c for c in instances.c if c.name not in ("attributes", "id", "series")],
            series.c.uid.label("series_uid"),
        ).order_by(series.c.number, series.c.id, instances.c.number, instances.c.id)
        with reading(self.engine) as connection:
            return [
                Instance(
                    study=study,
                    series=row.series_uid,
                    uid=row.uid,
                    sop_class=row.sop_class,
                    name=row.name,
                    file=FileRef(row.sha256, row.size),
                    transfer_syntax=row.transfer_syntax,
                    pixels=Pixels(**row.pixels) if row.pixels else None,
                )
                for row in connection.execute(query)
            ]


def _down_to(level: Level) -> tuple[Level, ...]:
    return LEVELS[: LEVELS.index(level) + 1]


def _joined(level: Level) -> sa.Select[Any]:
    query: sa.Select[Any] = sa.select().select_from(studies)
    if level == "study":
        return query
    joined = sa.join(studies, series, series.c.study == studies.c.id)
    if level == "instance":
        joined = sa.join(joined, instances, instances.c.series == series.c.id)
    return sa.select().select_from(joined)


def _shown(now: float) -> Conditions:
    """Of the cases that hold the same study and have not expired, the one that came last."""
    later = studies.alias()
    kept = sa.exists().where(simulations.c.id == studies.c.simulation_id, unexpired(now))
    replaced = sa.exists().where(
        later.c.uid == studies.c.uid,
        later.c.id > studies.c.id,
        simulations.c.id == later.c.simulation_id,
        unexpired(now),
    )
    return kept, ~replaced


def _clause(level: Level, condition: Condition) -> sa.ColumnElement[bool]:
    key = KEYS[condition.keyword]
    if condition.keyword == "ModalitiesInStudy":
        other = series.alias()
        return sa.exists().where(other.c.study == studies.c.id, _compare(other.c.modality, key.kind, condition))
    return _compare(key.column, key.kind, condition)


def _compare(column: sa.ColumnElement[Any], kind: str, condition: Condition) -> sa.ColumnElement[bool]:
    if condition.span is not None:
        low, high = condition.span
        ends = [column != ""]  # an object without a date lies in no range of dates
        ends += [column >= low] if low is not None else []
        ends += [column <= high] if high is not None else []
        return sa.and_(*ends)
    if kind == "number":
        return column.in_([int(value) for value in condition.values])
    if kind == "text":
        return sa.or_(*(sa.func.lower(column).like(_pattern(value), escape="\\") for value in condition.values))
    return column.in_(condition.values)


def _pattern(value: str) -> str:
    """The SQL pattern of a value with the wildcards of DICOM."""
    escaped = value.lower().replace("\\", "\\\\").replace("%", "\\%").replace("_", "\\_")
    return escaped.replace("*", "%").replace("?", "_")


def _found(level: Level, row: sa.RowMapping) -> Found:
    attributes: Json = {}
    for name in _down_to(level):
        attributes |= row[f"{name}_attributes"]
    if level == "study":
        attributes["00080061"] = {"vr": "CS", "Value": row["modalities"]}
        attributes["00201206"] = {"vr": "IS", "Value": [row["series_count"]]}
        attributes["00201208"] = {"vr": "IS", "Value": [row["instance_count"]]}
    if level == "series":
        attributes["00201209"] = {"vr": "IS", "Value": [row["instance_count"]]}
    return Found(attributes, row["study_uid"], row.get("series_uid"), row.get("instance_uid"))


def _add_study(connection: sa.Connection, simulation_id: str, by_series: dict[str, list[Entry]]) -> None:
    entries = [entry for group in by_series.values() for entry in group]
    study = connection.execute(
        studies.insert()
        .values(
            simulation_id=simulation_id,
            modalities=sorted({entry.columns["series"]["modality"] for entry in entries}),
            series_count=len(by_series),
            instance_count=len(entries),
            attributes=entries[0].attributes["study"],
            **entries[0].columns["study"],
        )
        .returning(studies.c.id)
    ).scalar_one()
    for group in by_series.values():
        _add_series(connection, study, group)


def _add_series(connection: sa.Connection, study: int, entries: list[Entry]) -> None:
    parent = connection.execute(
        series.insert()
        .values(
            study=study,
            instance_count=len(entries),
            attributes=entries[0].attributes["series"],
            **entries[0].columns["series"],
        )
        .returning(series.c.id)
    ).scalar_one()
    rows = [
        {
            "series": parent,
            "name": entry.name,
            **asdict(entry.file),
            "transfer_syntax": entry.transfer_syntax,
            "pixels": asdict(entry.pixels) if entry.pixels else None,
            "attributes": entry.attributes["instance"],
            **entry.columns["instance"],
        }
        for entry in entries
    ]
    connection.execute(instances.insert(), rows)
