"""Settings that a case has no use for: refused where they ask for another result, told where they change none."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel

from simcore.core.errors import SpecError
from simcore.core.tissues import Tissue
from simcore.fem.laws.by_tissue import ByTissue
from simcore.fem.spec import CompressionSpec
from simcore.phantom.lesions import Mass
from simcore.reconstruction.spec import FilteredBackprojection, IterativeSpec
from simcore.spec import SimulationSpec


def refuse(spec: SimulationSpec) -> None:
    """raises: SpecError for a compression of a phantom that is compressed already, and for a force beyond its limit"""
    problems: list[dict[str, Any]] = []
    c = spec.compression
    if spec.phantom.compressed:
        plates = {"thickness_mm": "; the distance of its plates is phantom.thickness_mm"}
        plates["force_N"] = "; a force that is known is phantom.force_N"
        for name in _changed(c):
            message = "the phantom is compressed already (phantom.compressed = true): leave compression out"
            problems.append(_problem(c, f"compression.{name}", name, message + plates.get(name, "")))
    elif c.force_N is not None and c.force_limit_N is not None and c.force_limit_N < c.force_N:
        message = f"the force to be reached is {c.force_N:g} N: a limit of at least that, or none"
        problems.append(_problem(c, "compression.force_limit_N", "force_limit_N", message))
    if problems:
        text = "; ".join(f"{p['field']}{_shown(p['value'])}: {p['message']}" for p in problems)
        raise SpecError(text, code="setting-not-used", problems=problems)


def remarks(spec: SimulationSpec) -> list[str]:
    """One sentence for every setting that is not the default and changes nothing."""
    return [f"{field} is not used: {why}" for field, why in _unused(spec)]


def _unused(spec: SimulationSpec) -> Iterator[tuple[str, str]]:
    yield from _of_phantom(spec)
    yield from _of_compression(spec.compression, spec.phantom.compressed)
    yield from _of_material(spec)
    yield from _of_physics(spec)
    if spec.export.view == "CC":
        yield from _named("export", spec.export, ("oblique_angle_degrees",), "export.view is 'CC'")
    yield from _of_reconstruction(spec)


def _of_physics(spec: SimulationSpec) -> Iterator[tuple[str, str]]:
    physics, detector = spec.physics, spec.acquisition.detector
    if physics.kind == "xray":
        why = "physics.kind is 'xray': the values of pixels are those of physics.detector"
        yield from _named("acquisition.detector", detector, ("bits", "open_field_value"), why)
        if physics.tube.measured is not None:
            why = "physics.tube.measured is behind all filters"
            yield from _named("physics.tube", physics.tube, ("anode", "kVp", "filters", "inherent"), why)
    elif physics.sampling == "exact":
        yield from _named("physics", physics, ("step_voxels",), "physics.sampling is 'exact'")


def _of_phantom(spec: SimulationSpec) -> Iterator[tuple[str, str]]:
    phantom = spec.phantom
    if phantom.kind == "uploaded":
        yield from _named("", spec, ("seed",), "nothing is random about an uploaded phantom")
        if phantom.compressed:
            compressed = "the phantom is compressed already"
            if not (spec.reproducible and spec.mesh.kind == "lattice"):
                yield from _named("", spec, ("mesh",), compressed)
            yield from _named("", spec, ("warp",), compressed)
        return
    if phantom.texture.amplitude_mm == 0:
        why = "phantom.texture.amplitude_mm is 0"
        yield from _named("phantom.texture", phantom.texture, ("scale_mm", "octaves"), why)
    for number, lesion in enumerate(phantom.lesions):
        if isinstance(lesion, Mass) and lesion.lobulation == 0:
            yield from _named(f"phantom.lesions.{number}", lesion, ("lobes",), "its lobulation is 0")


def _of_compression(c: CompressionSpec, compressed: bool) -> Iterator[tuple[str, str]]:
    if not compressed and c.chest_wall == "free_in_plane":
        yield from _named("compression", c, ("plate_edge_mm",), "compression.chest_wall is 'free_in_plane'")


def _of_material(spec: SimulationSpec) -> Iterator[tuple[str, str]]:
    material = spec.compression.material
    if isinstance(material, ByTissue) and not spec.phantom.compressed:
        for tissue in sorted(set(Tissue) - spec.phantom.possible_tissues()):
            name = tissue.name.lower()
            if getattr(material, name, None) is not None:
                yield f"compression.material.{name}", f"the phantom has no {name}"


def _of_reconstruction(spec: SimulationSpec) -> Iterator[tuple[str, str]]:
    r = spec.reconstruction
    if isinstance(r, FilteredBackprojection):
        if r.filter in ("none", "ramp"):
            without = ("hann_cutoff",) if r.filter == "ramp" else ("hann_cutoff", "regularisation_mm")
            yield from _named("reconstruction", r, without, f"reconstruction.filter is {r.filter!r}")
        if not r.slice_thickness_filter:
            why = "reconstruction.slice_thickness_filter is false"
            yield from _named("reconstruction", r, ("slice_cutoff",), why)
    elif isinstance(r, IterativeSpec) and r.total_variation == 0:
        yield from _named("reconstruction", r, ("total_variation_steps",), "reconstruction.total_variation is 0")


def _named(path: str, part: BaseModel, fields: tuple[str, ...], why: str) -> Iterator[tuple[str, str]]:
    changed = _changed(part)
    yield from ((f"{path}.{name}" if path else name, why) for name in fields if name in changed)


def _changed(part: BaseModel) -> list[str]:
    """Fields that are not as they are by default."""
    fields = type(part).model_fields
    return [
        name for name, field in fields.items() if getattr(part, name) != field.get_default(call_default_factory=True)
    ]


def _problem(part: BaseModel, field: str, name: str, message: str) -> dict[str, Any]:
    value = getattr(part, name)
    return {"field": field, "value": value if isinstance(value, str | int | float) else None, "message": message}


def _shown(value: object) -> str:
    return "" if value is None else f" = {value}"
