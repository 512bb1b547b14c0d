"""Ready specifications: the paper's cups and acquisitions, and clinical systems (sources in docs/presets.md)."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from typing import Any

from simcore.core.errors import SpecError
from simcore.detection.systems import detector_of
from simcore.fem.spec import CompressionSpec
from simcore.mesh.spec import TetwildMesh
from simcore.phantom.spec import AnthropomorphicPhantom, CompartmentSpec
from simcore.projection.spec import AcquisitionSpec, DetectorSpec, SlabSpec
from simcore.reconstruction.spec import FilteredBackprojection
from simcore.spec import SimulationSpec
from simcore.xray import XraySpec

# Volumes of the paper, section 5.1 (bra cup sizes, rounded), ml, and a number of compartments in its range 350..550.
CUPS = {"a": (250.0, 350), "b": (450.0, 400), "c": (700.0, 450), "d": (950.0, 500), "dd": (1500.0, 550)}
PERCENTS = (20, 50)

# Angular range [degree] and views of the paper, section 5.4; 40 degrees in 30 is its non-clinical setup.
PAPER_ACQUISITIONS = [(r, v) for r in (20, 30, 40) for v in (7, 11, 13, 15)] + [(40, 30)]


@dataclass(frozen=True)
class Preset:
    """A name, one line for people, and how the specification is made."""

    name: str
    description: str
    make: Callable[[], SimulationSpec]


def paper_case(cup: str, percent: float, angular_range: float = 40.0, views: int = 15) -> SimulationSpec:
    """The paper's case: GE Senographe DS prototype geometry, monoenergetic 20 keV, neo-Hookean breast."""
    volume, compartments = CUPS[cup]
    return SimulationSpec(
        name=f"cup {cup.upper()}, {percent:g} %",
        phantom=AnthropomorphicPhantom(volume_ml=volume, compartments=CompartmentSpec(count=compartments)),
        compression=CompressionSpec(percent=float(percent)),
        # The largest breasts leave the detector of the paper at the outer tube angles.
        acquisition=AcquisitionSpec(
            angular_range_degrees=float(angular_range),
            views=views,
            truncation="allow" if cup in ("d", "dd") else "refuse",
        ),
    )


def _system(title: str, acquisition: AcquisitionSpec) -> SimulationSpec:
    return paper_case("c", 50).with_(name=title, acquisition=acquisition)


def _rows(name: str) -> list[dict[str, str]]:
    with resources.files("simcore.data").joinpath(f"{name}.csv").open(encoding="utf-8") as lines:
        return list(csv.DictReader(lines))


def _fields(rows: list[dict[str, str]]) -> dict[str, dict[str, Any]]:
    """What the rows of each system say, in the JSON of a specification."""
    systems: dict[str, dict[str, Any]] = {}
    for row in rows:
        *parents, name = row["field"].split(".")
        part = systems.setdefault(row["system"], {})
        for parent in parents:
            part = part.setdefault(parent, {})
        part[name] = json.loads(row["value"])
    return systems


def _systems() -> dict[str, tuple[str, AcquisitionSpec]]:
    """Title and geometry of every system of simcore/data/systems.csv.

    raises: pydantic.ValidationError where a row is no field of an acquisition, or its value is out of range
    """
    rows = _rows("systems")
    titles = {row["system"]: row["title"] for row in rows if row["title"]}
    return {
        system: (titles[system], AcquisitionSpec.model_validate(fields)) for system, fields in _fields(rows).items()
    }


def _with_xrays(system: str, technique: dict[str, Any]) -> SimulationSpec:
    """A system with its tube, plates, detector and dose (simcore/data/techniques.csv)."""
    case = get(system)
    return case.with_(
        name=f"{case.name} with X-rays",
        acquisition=case.acquisition.with_(
            paddle=SlabSpec(material="polycarbonate", thickness_mm=2.5),
            support=SlabSpec(material="carbon-fibre", thickness_mm=1.5),
        ),
        physics=XraySpec.model_validate({**technique, "detector": detector_of(system)}),
    )


def _tiny() -> SimulationSpec:
    return SimulationSpec(
        name="tiny",
        phantom=AnthropomorphicPhantom(
            volume_ml=60.0,
            voxel_mm=1.0,
            compartments=CompartmentSpec(count=60, retromammary_mm=4.0, ligament_mm=1.0),
        ),
        mesh=TetwildMesh(edge_length_mm=16.0, epsilon=3e-3),
        compression=CompressionSpec(percent=30.0),
        acquisition=AcquisitionSpec(views=5, detector=DetectorSpec(pixels_x=160, pixels_y=256, pixel_mm=0.7)),
        reconstruction=FilteredBackprojection(slice_mm=2.0),
    )


def _build() -> dict[str, Preset]:
    presets = []
    for cup, (volume, _) in CUPS.items():
        for percent in PERCENTS:
            presets.append(
                Preset(
                    f"paper-cup-{cup}-{percent}",
                    f"the paper's cup {cup.upper()} ({volume:g} ml) at {percent} %, 15 views over 40 degrees",
                    lambda cup=cup, percent=percent: paper_case(cup, percent),  # type: ignore[misc]
                )
            )
    for r, v in PAPER_ACQUISITIONS:
        presets.append(
            Preset(
                f"paper-cup-c-20-{r}x{v}",
                f"the paper's cup C at 20 %, {v} views over {r} degrees",
                lambda r=r, v=v: paper_case("c", 20, r, v).with_(name=f"cup C, 20 %, {r}/{v}"),  # type: ignore[misc]
            )
        )
    for name, (title, acquisition) in _systems().items():
        presets.append(
            Preset(
                name,
                title,
                lambda title=title, a=acquisition: _system(title.split(":")[0], a),  # type: ignore[misc]
            )
        )
    for name, technique in _fields(_rows("techniques")).items():
        presets.append(
            Preset(
                f"{name}-xray",
                f"{name} with spectrum, scatter, detector noise and dose",
                lambda name=name, technique=technique: _with_xrays(name, technique),  # type: ignore[misc]
            )
        )
    presets.append(Preset("tiny", "a 60 ml breast with 1 mm voxels: seconds, for trying things out", _tiny))
    return {p.name: p for p in presets}


_PRESETS = _build()


def names() -> list[str]:
    """All preset names, the paper's first."""
    return list(_PRESETS)


def describe(name: str) -> str:
    """One line for people."""
    return _find(name).description


def get(name: str) -> SimulationSpec:
    """The specification of a preset.

    raises: SpecError where there is no such preset, with the names there are.
    """
    return _find(name).make()


def _find(name: str) -> Preset:
    try:
        return _PRESETS[name]
    except KeyError:
        raise SpecError(
            f"preset = {name!r}: unknown preset; there are: {', '.join(_PRESETS)}", code="unknown-preset"
        ) from None
