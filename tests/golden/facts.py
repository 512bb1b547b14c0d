"""What is kept of a case: digests of what is the same on every processor, small arrays of what is not.

Last bits of sums, roots and exponentials differ between processors, and so does all that follows the compression:
there digests of bytes are worth nothing. Means over a few blocks of an array tell as much, within a tolerance.
"""

from __future__ import annotations

import csv
import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pydicom
from numpy.typing import ArrayLike, NDArray
from PIL import Image
from pydicom.dataset import Dataset

from simcore import pipeline
from simcore.core.artifacts import TetMesh
from simcore.core.canonical import canonical
from simcore.core.tissues import Tissue
from simcore.store import codecs
from simcore.store.hashing import FileRef

BLOCKS = 5
"""Into how many blocks an axis is parted."""
UNSTEADY = re.compile(r"iteration|seconds|misfit|curve|memory|digest|sha256")
"""Entries of reports that a last bit may change a lot, or that are digests of what it changes."""
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+(?:e-?\d+)?|e-?\d+)(?![\w.])")
"""One that may have a fraction, in a text."""
UID_ROOT = "2.25."
SHORT = 12
"""Digits of a case's identity in names."""
PIXELS = {"PixelData", "FloatPixelData", "DoubleFloatPixelData"}
SIZES = {"PixelData", "ExtendedOffsetTable", "ExtendedOffsetTableLengths", "CompressedPixelData"}


@dataclass
class Facts:
    """One stage of one case.

    exact: {what: text or digest}. means: {what: means over blocks of an array}, with the tolerance of each.
    """

    exact: dict[str, str] = field(default_factory=dict)
    means: dict[str, list[float]] = field(default_factory=dict)
    tolerances: dict[str, float] = field(default_factory=dict)

    def keep(self, name: str, values: ArrayLike, tolerance: float) -> None:
        """tolerance: absolute, of a mean."""
        array = np.asarray(values, np.float64)
        self.exact[f"{name}: shape"] = str(array.shape)
        self.means[name] = [float(f"{v:.7g}") for v in block_means(array).ravel()]
        self.tolerances[name] = tolerance


def block_means(array: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means over at most BLOCKS blocks an axis; not finite values count as 0."""
    means = np.nan_to_num(array, posinf=0.0, neginf=0.0)
    for axis, size in enumerate(array.shape):
        if size > BLOCKS:
            bounds = np.linspace(0, size, BLOCKS + 1).astype(np.int64)
            parts = [means.take(range(a, b), axis).mean(axis, keepdims=True) for a, b in pairwise(bounds)]
            means = np.concatenate(parts, axis)
    return means


def facts_of(case: pipeline.CaseResult) -> dict[str, Facts]:
    """Facts of every stage that the case has, in their order."""
    stages = {s["name"]: s for s in case.manifest["stages"]}
    facts = {name: Facts() for name in stages}
    for name, stage in stages.items():
        _keep_report(facts[name], stage["report"])
        READERS[name](case, stage, facts[name])
    for name in ("phantom", "mesh"):  # what follows is keyed by last bits
        if name in stages:
            facts[name].exact["key"] = stages[name]["key"]
    return facts


def _locate(case: pipeline.CaseResult, stage: dict[str, Any]) -> codecs.Locate:
    return lambda name: case.store.path(FileRef(**stage["outputs"][name]))


def _keep_report(facts: Facts, report: dict[str, Any]) -> None:
    numbers: list[tuple[str, float]] = []
    for name, value in _leaves(report):
        if UNSTEADY.search(name):
            continue
        if isinstance(value, int | float) and not isinstance(value, bool):
            numbers.append((name, value))
        else:
            facts.exact[f"report: {name}"] = str(value)
    for name, number in numbers:
        facts.means[f"report: {name}"] = [float(f"{number:.7g}")]
        facts.tolerances[f"report: {name}"] = 1e-3 * abs(number) + 1e-5


def _leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    children = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list | tuple) else ()
    if not isinstance(value, dict | list | tuple):
        yield name, value
    for key, child in children:
        yield from _leaves(child, f"{name}.{key}".lstrip("."))


def _phantom(case: pipeline.CaseResult, stage: dict[str, Any], facts: Facts) -> None:
    phantom = codecs.load_phantom(_locate(case, stage))
    facts.exact["labels"] = digest(phantom.labels)
    facts.exact["grid"] = hashlib.sha256(canonical(phantom.grid.to_dict())).hexdigest()
    facts.exact["lesions"] = str([t.get("kind") for t in phantom.truth])


def _warp(case: pipeline.CaseResult, stage: dict[str, Any], facts: Facts) -> None:
    labels = codecs.load_phantom(_locate(case, stage)).labels
    for tissue in Tissue:
        if np.any(labels == tissue):
            facts.keep(f"labels: {tissue.name.lower()}", labels == tissue, 0.005)


class Order:
    """Nodes and tetrahedra of a case's mesh by their coordinates: the order that nodes are numbered in hangs on the
    processor (scipy's reverse Cuthill-McKee begins where an unstable sort puts first)."""

    def __init__(self, mesh: TetMesh) -> None:
        self.nodes = np.lexsort(mesh.nodes.T[::-1])
        self._renumbered = np.argsort(self.nodes)
        corners = np.sort(self._renumbered[mesh.tets], axis=1)
        self.tets = np.lexsort(corners.T[::-1])

    def renumbered(self, ids: NDArray[np.int64]) -> NDArray[np.int64]:
        """Node numbers, or sets of them, in this order."""
        new = self._renumbered[ids]
        if new.ndim == 1:
            return np.sort(new)
        new = np.sort(new, axis=1)
        return np.asarray(new[np.lexsort(new.T[::-1])])


def _mesh_of(case: pipeline.CaseResult) -> TetMesh | None:
    stages = {s["name"]: s for s in case.manifest["stages"]}
    return codecs.load_mesh(_locate(case, stages["mesh"])) if "mesh" in stages else None


def _mesh(case: pipeline.CaseResult, stage: dict[str, Any], facts: Facts) -> None:
    mesh = codecs.load_mesh(_locate(case, stage))
    order = Order(mesh)
    facts.exact["nodes"] = digest(mesh.nodes[order.nodes])
    for name in ("tets", "wall", "skin"):
        facts.exact[name] = digest(order.renumbered(getattr(mesh, name)))


def _fem(case: pipeline.CaseResult, stage: dict[str, Any], facts: Facts) -> None:
    compression = codecs.load_compression(_locate(case, stage))
    mesh = _mesh_of(case)
    displacement = compression.displacement
    facts.exact["outcome"] = compression.outcome
    facts.keep("displacement [mm]", displacement if mesh is None else displacement[Order(mesh).nodes], 1e-4)
    facts.keep("plates [mm]", compression.plate_z, 1e-4)


def _projection(case: pipeline.CaseResult, stage: dict[str, Any], facts: Facts) -> None:
    stack = codecs.load_stack(_locate(case, stage))
    facts.keep("pixels", stack.data, 3e-4 * stack.open_field)
    geometry = stack.geometry.to_dict()
    facts.exact["geometry: names"] = str(sorted(geometry))
    facts.keep("geometry", [v for _, v in _leaves(geometry) if isinstance(v, int | float)], 1e-6)


def _reconstruction(case: pipeline.CaseResult, stage: dict[str, Any], facts: Facts) -> None:
    """The voxels are looked at in the DICOM volume: not every kind stores them by themselves."""
    facts.exact["outputs"] = str(sorted(stage["outputs"]))


def _mechanics(case: pipeline.CaseResult, stage: dict[str, Any], facts: Facts) -> None:
    grid = meshio.read(_locate(case, stage)("compression.vtu"), file_format="vtu")
    mesh = _mesh_of(case)
    assert mesh is not None
    order = Order(mesh)
    facts.keep("points", grid.points[order.nodes], 1e-4)
    cells = {name: np.concatenate(blocks)[order.tets] for name, blocks in grid.cell_data.items()}
    points = {name: np.asarray(values)[order.nodes] for name, values in grid.point_data.items()}
    for kind, arrays in (("point", points), ("cell", cells)):
        facts.exact[f"{kind} data"] = str(sorted(arrays))
        for name, values in arrays.items():
            largest = float(np.abs(block_means(np.asarray(values, np.float64))).max())
            facts.keep(f"{kind}: {name}", values, 1e-3 * largest + 1e-9)


def _preview(case: pipeline.CaseResult, stage: dict[str, Any], facts: Facts) -> None:
    for name in sorted(stage["outputs"]):
        with Image.open(_locate(case, stage)(name)) as picture:
            facts.keep(name, np.asarray(picture.convert("L")), 1.5)


def _dicom(case: pipeline.CaseResult, stage: dict[str, Any], facts: Facts) -> None:
    locate = _locate(case, stage)
    facts.exact["files"] = str(sorted(stage["outputs"]))
    identity = str(pydicom.dcmread(locate("projections.dcm"), stop_before_pixels=True).StudyID)
    if "mesh" not in {s["name"] for s in case.manifest["stages"]}:
        facts.exact["identity"] = identity  # without a compression, no key hangs on last bits
    header = Header(identity[:SHORT])
    _keep_table(facts, "truth.csv", locate("truth.csv"))
    for name in sorted(stage["outputs"]):
        if not name.endswith(".dcm"):
            continue
        dataset = pydicom.dcmread(locate(name))
        lines, numbers = header.read(dataset)
        facts.exact[f"{name}: header"] = hashlib.sha256("\n".join(lines).encode()).hexdigest()
        facts.keep(f"{name}: numbers of the header", numbers, 1e-2)
        if PIXELS & set(dataset.dir()):
            pixels = np.asarray(dataset.pixel_array, np.float64)
            facts.keep(f"{name}: pixels", pixels, 3e-4 * max(1.0, float(pixels.max())))


def _keep_table(facts: Facts, name: str, path: Path) -> None:
    """Text and numbers of a CSV file, without unique identifiers."""
    cells = [c for row in csv.reader(path.read_text().splitlines()) for c in row if not c.startswith(UID_ROOT)]
    numbers = [float(c) for c in cells if c.isdigit()]
    facts.exact[f"{name}: text"] = str([c for c in cells if not c.isdigit()])
    facts.keep(f"{name}: numbers", numbers, 0.5)


class Header:
    """Headers of one study as text, without what hangs on the pixels: identifiers become their place in the study,
    numbers that may have a fraction stand apart."""

    def __init__(self, identity: str) -> None:
        """identity: how the names begin that hang on it."""
        self._identity = re.compile(f"{identity}[0-9a-f]*")
        self._identifiers: dict[str, str] = {}

    def read(self, dataset: Dataset) -> tuple[list[str], list[float]]:
        """(lines, numbers)."""
        lines: list[str] = []
        numbers: list[float] = []
        for part in (dataset.file_meta, dataset):
            self._read(part, "", lines, numbers)
        return lines, numbers

    def _read(self, dataset: Dataset, path: str, lines: list[str], numbers: list[float]) -> None:
        for element in dataset:
            name = f"{path}{element.keyword or element.tag}"
            if element.keyword in PIXELS | SIZES or element.keyword == "FileMetaInformationGroupLength":
                lines.append(f"{name} {element.VR}")
            elif element.VR == "SQ":
                for index, item in enumerate(element.value):
                    self._read(item, f"{name}[{index}].", lines, numbers)
            elif element.VR in ("DS", "FD", "FL"):
                values = element.value if element.VM > 1 else [element.value] if element.VM else []
                lines.append(f"{name} {element.VR} x{len(values)}")
                numbers.extend(float(v) for v in values)
            else:
                lines.append(f"{name} {element.VR} {self._text(element, numbers)}")

    def _text(self, element: pydicom.DataElement, numbers: list[float]) -> str:
        if isinstance(element.value, bytes):
            return hashlib.sha256(element.value).hexdigest()
        text = str(element.value)
        if element.VR == "UI":
            unseen = f"identifier {len(self._identifiers)}"
            return self._identifiers.setdefault(text, unseen) if text.startswith(UID_ROOT) else text
        numbers.extend(float(number) for number in NUMBER.findall(text))
        return NUMBER.sub("number", self._identity.sub("identity", text))


READERS = {
    "phantom": _phantom,
    "mesh": _mesh,
    "fem": _fem,
    "warp": _warp,
    "projection": _projection,
    "reconstruction": _reconstruction,
    "dicom": _dicom,
    "mechanics": _mechanics,
    "preview": _preview,
}


def digest(array: NDArray[Any]) -> str:
    """sha256 of shape, type and values."""
    head = f"{array.shape} {array.dtype.str} ".encode()
    return hashlib.sha256(head + np.ascontiguousarray(array).tobytes()).hexdigest()
