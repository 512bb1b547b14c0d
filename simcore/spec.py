"""The specification of one case: what a client posts. Frozen data; every field has a default."""

from __future__ import annotations

import json
from typing import Any, Self

from pydantic import Field, ValidationError

from simcore.core.errors import SpecError
from simcore.core.spec_base import Spec
from simcore.dicom.spec import ExportSpec
from simcore.fem.spec import CompressionSpec
from simcore.mesh.spec import MeshSpec, TetwildMesh
from simcore.phantom.spec import AnthropomorphicPhantom, PhantomSpec
from simcore.projection.spec import AcquisitionSpec, PhysicsSpec
from simcore.reconstruction.spec import FilteredBackprojection, ReconstructionSpec
from simcore.warp.spec import WarpSpec


class SimulationSpec(Spec):
    """One case, from phantom to DICOM."""

    name: str = Field("", max_length=64, description="a label for people; changes no result")
    seed: int = Field(1, ge=0, le=2**63 - 1, description="seed of every random stream [1]")
    phantom: PhantomSpec = AnthropomorphicPhantom()
    mesh: MeshSpec = TetwildMesh()
    compression: CompressionSpec = CompressionSpec()
    warp: WarpSpec = WarpSpec()
    acquisition: AcquisitionSpec = AcquisitionSpec()
    physics: PhysicsSpec = PhysicsSpec()
    reconstruction: ReconstructionSpec = FilteredBackprojection()
    export: ExportSpec = ExportSpec()

    @classmethod
    def parse(cls, text: str | bytes) -> Self:
        """From JSON.

        raises: SpecError naming every wrong field, its value and what is allowed.
        """
        try:
            return cls.model_validate_json(text)
        except ValidationError as error:
            raise spec_error(cls, error) from None

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Self:
        """From JSON-like data; as ``parse``."""
        return cls.parse(json.dumps(data))


def _fields_at(model: type[Spec], path: tuple[int | str, ...]) -> list[str]:
    """The valid field names of the (sub-)model at ``path``; empty where it is not a model."""
    current: Any = model
    for step in path:
        field = getattr(current, "model_fields", {}).get(step)
        if field is None:
            return []
        current = field.annotation
    return sorted(getattr(current, "model_fields", {}))


def spec_error(model: type[Spec], error: ValidationError) -> SpecError:
    """A pydantic error as a SpecError with one line a problem: field, value, what is allowed."""
    problems: list[dict[str, Any]] = []
    lines: list[str] = []
    for item in error.errors(include_url=False):
        path = tuple(item["loc"])
        field = ".".join(map(str, path)) or "(the whole specification)"
        message = item["msg"]
        if item["type"] == "extra_forbidden":
            valid = _fields_at(model, path[:-1])
            message = "unknown field" + (f"; valid here: {', '.join(valid)}" if valid else "")
        given = item.get("input") if item["type"] not in ("missing", "json_invalid") else None
        value = given if isinstance(given, str | int | float | bool) else None
        problems.append({"field": field, "value": value, "message": message})
        lines.append(f"{field}{'' if value is None else f' = {value!r}'}: {message}")
    head = "the specification is not valid" if len(lines) == 1 else f"{len(lines)} fields are not valid"
    return SpecError(f"{head}: " + "; ".join(lines), problems=problems)
