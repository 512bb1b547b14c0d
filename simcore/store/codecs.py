"""Artifacts as files: one meta.json and one file an array.

Arrays are .npy and read by memory map, so what is not needed is not read. Label volumes are uint8 with long runs:
they are zstandard-compressed (.npy.zst), a thirtieth of the size and faster than the disk.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from simcore.core.artifacts import Compression, Phantom, Primary, ProjectionStack, TetMesh, TransportResult, Volume
from simcore.core.canonical import canonical
from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid

Locate = Callable[[str], Path]
"""Where an output of the stage lies, by name."""


def _write_meta(folder: Path, meta: dict[str, Any]) -> None:
    (folder / "meta.json").write_bytes(canonical(meta))


def _read_meta(locate: Locate) -> dict[str, Any]:
    return json.loads(locate("meta.json").read_bytes())  # type: ignore[no-any-return]


def _save(folder: Path, name: str, array: NDArray[Any]) -> None:
    np.save(folder / f"{name}.npy", array, allow_pickle=False)


def _load(locate: Locate, name: str) -> NDArray[Any]:
    array: NDArray[Any] = np.load(locate(f"{name}.npy"), mmap_mode="r", allow_pickle=False)
    return array


def save_phantom(folder: Path, phantom: Phantom) -> None:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": "|u1", "fortran_order": False, "shape": phantom.labels.shape}
    )
    compressor = zstandard.ZstdCompressor(level=1, threads=2)
    labels = np.ascontiguousarray(phantom.labels)
    with open(folder / "labels.npy.zst", "wb") as f, compressor.stream_writer(f) as z:
        z.write(header.getvalue())
        for plane in labels:
            z.write(memoryview(plane).cast("B"))  # type: ignore[arg-type]
    _write_meta(folder, {"grid": phantom.grid.to_dict(), "truth": list(phantom.truth), "report": phantom.report})


def load_phantom(locate: Locate) -> Phantom:
    meta = _read_meta(locate)
    with open(locate("labels.npy.zst"), "rb") as f, zstandard.ZstdDecompressor().stream_reader(f) as z:
        np.lib.format.read_magic(z)
        shape, _, dtype = np.lib.format.read_array_header_1_0(z)
        labels = np.empty(shape, dtype)
        view = memoryview(labels).cast("B")  # type: ignore[arg-type]
        done = 0
        while done < len(view):
            n = z.readinto(view[done:])  # type: ignore[arg-type]
            if not n:
                raise ValueError("the stored label volume is cut short")
            done += n
    return Phantom(labels, Grid.from_dict(meta["grid"]), tuple(meta["truth"]), meta["report"])


def save_mesh(folder: Path, mesh: TetMesh) -> None:
    for name in ("nodes", "tets", "wall", "skin"):
        _save(folder, name, getattr(mesh, name))
    _write_meta(folder, {"report": mesh.report})


def load_mesh(locate: Locate) -> TetMesh:
    arrays = {name: np.array(_load(locate, name)) for name in ("nodes", "tets", "wall", "skin")}
    return TetMesh(**arrays, report=_read_meta(locate)["report"])


def save_compression(folder: Path, compression: Compression) -> None:
    _save(folder, "displacement", compression.displacement)
    _write_meta(
        folder,
        {
            "plate_z": list(compression.plate_z),
            "force_N": compression.force_N,
            "outcome": compression.outcome,
            "report": compression.report,
        },
    )


def load_compression(locate: Locate) -> Compression:
    meta = _read_meta(locate)
    return Compression(
        np.array(_load(locate, "displacement")),
        tuple(meta["plate_z"]),
        meta["force_N"],
        meta["outcome"],
        meta["report"],
    )


def save_stack(folder: Path, stack: ProjectionStack) -> None:
    _save(folder, "projections", stack.data)
    (folder / "geometry.json").write_text(json.dumps(stack.geometry.to_dict(), indent=1) + "\n")
    slabs = {"slab_integral": stack.slab_integral} if stack.slab_integral else {}
    _write_meta(folder, {"open_field": stack.open_field, "report": stack.report, **slabs})


def load_stack(locate: Locate) -> ProjectionStack:
    meta = _read_meta(locate)
    geometry = AcquisitionGeometry.from_dict(json.loads(locate("geometry.json").read_bytes()))
    return ProjectionStack(
        _load(locate, "projections"), meta["open_field"], geometry, meta["report"], meta.get("slab_integral", 0.0)
    )


def save_primary(folder: Path, primary: Primary) -> None:
    for name in ("signal", "variance", "open_signal", "open_variance"):
        _save(folder, name, getattr(primary, name))
    _write_meta(folder, {"geometry": primary.geometry.to_dict(), "report": primary.report})


def load_primary(locate: Locate) -> Primary:
    meta = _read_meta(locate)
    arrays = [_load(locate, name) for name in ("signal", "variance", "open_signal", "open_variance")]
    signal, variance, open_signal, open_variance = arrays
    geometry = AcquisitionGeometry.from_dict(meta["geometry"])
    return Primary(signal, variance, open_signal, open_variance, geometry, meta["report"])


def save_transport(folder: Path, result: TransportResult) -> None:
    for name in ("scatter", "scatter_variance"):
        _save(folder, name, getattr(result, name))
    _write_meta(folder, {"report": result.report})


def load_transport(locate: Locate) -> TransportResult:
    scatter, variance = (np.array(_load(locate, name)) for name in ("scatter", "scatter_variance"))
    return TransportResult(scatter, variance, _read_meta(locate)["report"])


def save_volume(folder: Path, volume: Volume) -> None:
    _save(folder, "volume", volume.data)
    save_volume_facts(folder, volume)


def save_volume_facts(folder: Path, volume: Volume) -> None:
    """Everything but the voxels, for a volume that is made again where it is asked for."""
    _write_meta(
        folder,
        {
            "grid": volume.grid.to_dict(),
            "slope": volume.slope,
            "intercept": volume.intercept,
            "report": volume.report,
        },
    )


def load_volume(locate: Locate) -> Volume:
    meta = _read_meta(locate)
    return Volume(
        _load(locate, "volume"),
        Grid.from_dict(meta["grid"]),
        meta["slope"],
        meta["intercept"],
        meta["report"],
    )
