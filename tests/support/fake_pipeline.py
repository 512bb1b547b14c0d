"""A pipeline for tests of the service: two stages, and whatever misbehaviour the name of the case asks for.

slow      four seconds of work in steps       forever   does not come to an end
slower    ten seconds of it
brief     two seconds of it
silent    sleeps and tells nothing            noise     prints to standard output
crash     kills its own process (SIGSEGV)     memory    asks for more memory than there is
gigabyte  fills a gigabyte of memory          refuse    raises a SolverError
cpp       throws std::bad_alloc past Python   rust      aborts as Rust does without memory
mistake   raises a KeyError                   exit      ends its own process
large     writes 24 MB
"""

import ctypes
import json
import os
import signal
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from simcore.core.errors import SolverError
from simcore.store.hashing import FileRef
from simcore.store.store import Store

STAGES = ("dicom", "preview")

FILES = {
    "dicom": {"projections/0001.dcm": b"\0" * 128 + b"DICM" + bytes(range(256)) * 8, "volume.dcm": b"volume" * 1000},
    "preview": {"preview/phantom.png": b"\x89PNG\r\n\x1a\n picture"},
}


@dataclass
class Result:
    manifest: dict[str, Any]


def run(spec: Any, store: Store, progress: Any) -> Result:
    stages = []
    for stage in STAGES:
        progress(stage, 0.0, "started")
        record, cached = store.run(
            stage,
            1,
            {"name": spec.name, "seed": spec.seed},
            {},
            lambda folder, key, hashing, s=stage: work(s, spec, folder, progress),
        )
        progress(stage, 1.0, "done", cached=cached)
        stages.append((record, cached))
    files: dict[str, FileRef] = {name: ref for record, _ in stages for name, ref in record.outputs.items()}
    return Result(
        {
            "schema": "tomosim-manifest/1",
            "computed_stages": sum(not cached for _, cached in stages),
            "stages": [
                {"name": r.stage, "key": r.key, "outputs": {n: asdict(f) for n, f in r.outputs.items()}}
                for r, _ in stages
            ],
            "results": {"volume_ml": 700.0},
            "files": {name: asdict(ref) for name, ref in files.items()},
        }
    )


def work(stage: str, spec: Any, folder: Path, progress: Any) -> tuple[dict[str, Any], float, int]:
    if stage == STAGES[-1]:
        misbehave(spec.name, progress)
        if spec.name == "large":
            (folder / "large").write_bytes(os.urandom(24 << 20))
    for name, content in FILES[stage].items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content + str(spec.seed).encode())
    return {}, 0.0, 0


def misbehave(name: str, progress: Any) -> None:
    if name == "noise":
        print(json.dumps({"type": "failed", "error": "printed"}), flush=True)
        os.write(1, b"printed by a library\n")
    if name == "refuse":
        raise SolverError("compression.percent = 90: the solver did not converge; use less")
    if name == "mistake":
        raise KeyError("lost")
    if name == "memory":
        bytearray(1 << 50)
    if name == "gigabyte":
        bytearray(1_000_000_000)
    if name == "cpp":
        ctypes.CDLL("libstdc++.so.6")._ZSt17__throw_bad_allocv()
    if name == "rust":
        os.write(2, b"memory allocation of 8589934592 bytes failed\n")
        os.abort()
    if name == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    if name == "exit":
        os._exit(3)
    if name == "silent":
        time.sleep(600)
    steps = {"brief": 20, "slow": 40, "slower": 100, "forever": sys.maxsize}.get(name, 0)
    for step in range(1, steps + 1):
        progress(STAGES[-1], min(0.99, step / steps), f"step {step}, process {os.getpid()}")
        time.sleep(0.1)
