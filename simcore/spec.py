"""The specification of one case: what a client posts. Frozen data; every field has a default."""

from __future__ import annotations

import json
from typing import Annotated, Any, Self, get_args, get_origin

from pydantic import Field, ValidationError, model_validator

from simcore.core.errors import SpecError
from simcore.core.spec_base import Spec
from simcore.dicom.spec import ExportSpec
from simcore.fem.spec import CompressionSpec
from simcore.mesh.spec import LatticeMesh, MeshSpec, TetwildMesh
from simcore.phantom.spec import AnthropomorphicPhantom, PhantomSpec
from simcore.projection.spec import AcquisitionSpec, PhysicsSpec
from simcore.reconstruction.spec import FilteredBackprojection, ReconstructionSpec
from simcore.warp.spec import WarpSpec
from simcore.xray import AnyPhysicsSpec


class SimulationSpec(Spec):
    """One case, from phantom to DICOM."""

    name: str = Field("", max_length=64, description="a label for people; changes no result")
    seed: int = Field(1, ge=0, le=2**63 - 1, description="seed of every random stream [1]")
    reproducible: bool = Field(
        False,
        description="whether every byte must be the same again: then the mesh is a lattice where none is asked for, "
        "and a mesher that is not reproducible is refused",
    )
    phantom: PhantomSpec = AnthropomorphicPhantom()
    mesh: MeshSpec = TetwildMesh()
    compression: CompressionSpec = CompressionSpec()
    warp: WarpSpec = WarpSpec()
    acquisition: AcquisitionSpec = AcquisitionSpec()
    physics: AnyPhysicsSpec = PhysicsSpec()
    reconstruction: ReconstructionSpec = FilteredBackprojection()
    export: ExportSpec = ExportSpec()

    @model_validator(mode="before")
    @classmethod
    def _reproducible_mesh(cls, data: Any) -> Any:
        if isinstance(data, dict) and data.get("reproducible") is True and "mesh" not in data:
            return {**data, "mesh": LatticeMesh()}
        return data

    @model_validator(mode="after")
    def _mesh_fits(self) -> Self:
        if self.reproducible and self.mesh.kind == "tetwild":
            raise ValueError("mesh.kind = 'tetwild' is not reproducible: leave mesh out, or take 'lattice'")
        return self

    @model_validator(mode="after")
    def _muscle_to_hold(self) -> Self:
        if self.compression.chest_wall == "fixed_muscle" and self.phantom.kind == "anthropomorphic":
            raise ValueError(
                "compression.chest_wall = 'fixed_muscle': a phantom of kind 'anthropomorphic' has no muscle; take "
                "'free_in_plane' or 'fixed', or an uploaded phantom that has muscle"
            )
        return self

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


def _members(annotation: Any) -> dict[str, type[Spec]]:
    """The models of a union by their ``kind``; empty where it is no union."""
    return {m.model_fields["kind"].default: m for m in get_args(annotation) if "kind" in getattr(m, "model_fields", {})}


def _item(annotation: Any) -> Any:
    """What a list holds, without what is annotated to it; None where that is not known."""
    content = get_args(annotation)[0] if get_args(annotation) else None
    return get_args(content)[0] if get_origin(content) is Annotated else content


def _value(annotation: Any) -> Any:
    """What an object with free keys holds, without what is annotated to it."""
    content = get_args(annotation)[1]
    return get_args(content)[0] if get_origin(content) is Annotated else content


def _walk(model: type[Spec], location: tuple[int | str, ...]) -> tuple[list[str], Any]:
    """The path of a field as the client wrote it (pydantic adds the kind of a union's member), and what stands there.

    The model is None where the path leads to no model.
    """
    path: list[str] = []
    current: Any = model
    for step in location:
        if (member := _members(current).get(str(step))) is not None:
            current = member
            continue
        path.append(str(step))
        if isinstance(step, int):
            current = _item(current)
            continue
        if get_origin(current) is dict:
            current = _value(current)
            continue
        field = getattr(current, "model_fields", {}).get(step)
        current = field.annotation if field is not None else None
    return path, current


def spec_error(model: type[Spec], error: ValidationError, what: str = "specification") -> SpecError:
    """A pydantic error as a SpecError with one line a problem: field, value, what is allowed."""
    problems: list[dict[str, Any]] = []
    lines: list[str] = []
    for item in error.errors(include_url=False):
        location = tuple(item["loc"])
        path = [step for step in _walk(model, location)[0] if step != "[key]"]
        field = ".".join(path) or f"(the whole {what})"
        message = item["msg"]
        if item["type"] == "extra_forbidden":
            valid = sorted(getattr(_walk(model, location[:-1])[1], "model_fields", {}))
            message = "unknown field" + (f"; valid here: {', '.join(valid)}" if valid else "")
        elif item["type"] == "union_tag_not_found":
            kinds = sorted(_members(_walk(model, location)[1]))
            message = f"the field 'kind' is missing; valid kinds: {', '.join(kinds)}"
        entry = item.get("input") if item["type"] not in ("missing", "json_invalid") else None
        value = entry if isinstance(entry, str | int | float | bool) else None
        problems.append({"field": field, "value": value, "message": message})
        if any("." in step or "/" in step for step in path):
            escaped = (step.replace("~", "~0").replace("/", "~1") for step in path)
            problems[-1]["pointer"] = "/" + "/".join(escaped)
        lines.append(f"{field}{'' if value is None else f' = {value!r}'}: {message}")
    head = f"the {what} is not valid" if len(lines) == 1 else f"{len(lines)} fields are not valid"
    return SpecError(f"{head}: " + "; ".join(lines), problems=problems)
