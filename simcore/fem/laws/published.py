"""Published moduli of the tissues, from simcore/data/materials.csv (sources: simcore/data/SOURCES.md)."""

from __future__ import annotations

import csv
from importlib import resources
from typing import Any, Literal

from pydantic import Field, TypeAdapter

from simcore.core.spec_base import Spec
from simcore.core.tissues import Tissue
from simcore.fem.laws.by_tissue import with_fallbacks
from simcore.fem.laws.law import Law
from simcore.fem.laws.plain import PlainLaw

_PLAIN: TypeAdapter[Any] = TypeAdapter(PlainLaw)


class Published(Spec):
    """The laws of a publication, mixed in every tetrahedron as by ``by_tissue``."""

    kind: Literal["published"] = "published"
    source: Literal["bakic-1998", "wellman-1999", "victre", "aspiration"] = Field(
        description="bakic-1998: adipose tissue everywhere, 48.6 kPa. wellman-1999: 4.46 and 15.1 kPa, small strain. "
        "victre: fat 5, gland 15, mass 20 kPa. aspiration: 3.04 kPa everywhere, in vivo, small strain"
    )

    @classmethod
    def example(cls) -> Published:
        return cls(source="victre")

    def laws(self) -> dict[Tissue, Law]:
        return with_fallbacks({tissue: spec.law() for tissue, spec in published_laws()[self.source].items()})


def published_laws() -> dict[str, dict[Tissue, Any]]:
    """Every set of the table: {set: {tissue: specification of its law}}.

    raises: pydantic.ValidationError where a row is not a parameter of its law
    """
    rows: dict[tuple[str, Tissue], dict[str, Any]] = {}
    with resources.files("simcore.data").joinpath("materials.csv").open(encoding="utf-8") as lines:
        for row in csv.DictReader(lines):
            parameters = rows.setdefault((row["set"], Tissue[row["tissue"].upper()]), {"kind": row["kind"]})
            parameters[row["parameter"]] = float(row["value"])
    sets: dict[str, dict[Tissue, Any]] = {}
    for (name, tissue), parameters in rows.items():
        sets.setdefault(name, {})[tissue] = _PLAIN.validate_python(parameters)
    return sets
