"""What the service costs: over ``tomosim simulate``, in answers a second, for a large study, for what is in the store.

    python -m bench.service [--runs 8] [--part small | paper] [--preset paper-cup-c-50] [--pause 0]

One ``tomosim serve`` on a fresh folder. Overhead: seconds from submission to the final state as a client sees it, less
the seconds that the pipeline itself took, of new cases on a warm worker; beside it the whole command ``tomosim
simulate`` on the same specifications. Answers: GET of one case, and of a list, over 8 connections that ask as fast as
they can. The last case has the paper's size: a second acquisition of a breast that is already compressed.

Last line: one JSON object. Times mean something on an idle machine only.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx

from bench.support.timing import Stolen, machine_load
from simcore import presets
from simcore.mesh.spec import LatticeMesh
from simcore.spec import SimulationSpec
from tests.support.ports import free_port
from tomosim.client import Client
from worker.serve import processes

CONNECTIONS = 8
LOAD_SECONDS = 4.0
STUDY_CASES = 1000
ACQUISITIONS = ((15, 24.0), (15, 20.0), (15, 30.0), (15, 36.0), (13, 30.0), (11, 30.0))
"""(views, degrees) of the paper's breast, once it is compressed and in the store."""

Json = dict[str, Any]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=8, help="cases of which the median is taken")
    parser.add_argument(
        "--part", choices=("all", "small", "paper"), default="all", help="paper: the paper's size alone"
    )
    parser.add_argument("--preset", default="paper-cup-c-50", help="the case of the paper's size")
    parser.add_argument("--pause", type=float, default=0.0, help="seconds of rest before cases of the paper's size")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="bench-service-") as folder, served(Path(folder)) as url:
        result: Json = {"load": machine_load()}
        with Client(url) as client:
            if args.part != "paper":
                result |= overhead(client, args.runs, Path(folder))
                result |= answers(client, url)
                result |= study(client)
            if args.part != "small":
                result |= paper(client, args.preset, args.pause)
    print(json.dumps(result))
    return 0


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """The address of a running service."""
    port = free_port()
    data = str(folder / "data")
    command = [sys.executable, "-m", "tomosim", "serve", "--data", data, "--port", str(port)]
    process = processes.start(command, dict(os.environ), subprocess.PIPE)
    assert process.stdout is not None
    try:
        if b"ready" not in process.stdout.readline():
            raise RuntimeError("the service did not start")
        yield f"http://127.0.0.1:{port}"
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(60)


def tiny(seed: int) -> SimulationSpec:
    """A small case that is computed in about a second."""
    return presets.get("tiny").with_(seed=seed, reproducible=True, mesh=LatticeMesh(edge_length_mm=12.0))


def through(client: Client, spec: SimulationSpec) -> tuple[float, Json]:
    """Seconds from submission to success as a client sees it, and the manifest."""
    start = time.perf_counter()
    case = client.wait(client.submit(spec).id)
    seconds = time.perf_counter() - start
    if case.state != "succeeded":
        raise RuntimeError(f"the case was {case.state}: {case.error}")
    return seconds, client.manifest(case.id)


def overhead(client: Client, runs: int, folder: Path) -> Json:
    """New cases through the service and by command, in turns; then the same cases again, from the store."""
    for seed in (1, 2):  # code is loaded
        through(client, tiny(seed))
    over, whole, again, command, own = [], [], [], [], []
    for seed in range(100, 100 + runs):
        seconds, manifest = through(client, tiny(seed))
        whole.append(seconds)
        over.append(seconds - manifest["seconds"])
        again.append(through(client, tiny(seed))[0])
        start = time.perf_counter()
        manifest = simulate(tiny(seed), folder)
        command.append(time.perf_counter() - start)
        own.append(manifest["seconds"])
    return {
        "overhead_seconds": median(over),
        "overhead_seconds_max": round(max(over), 3),
        "service_seconds": median(whole),
        "simulate_seconds": median(command),
        "simulate_pipeline_seconds": median(own),
        "cached_rerun_seconds": median(again),
    }


def simulate(spec: SimulationSpec, folder: Path) -> Json:
    """The manifest of a case that the command computed."""
    (folder / "spec.json").write_text(spec.model_dump_json())
    command = [sys.executable, "-m", "tomosim", "simulate", str(folder / "spec.json"), "--out", str(folder / "out")]
    subprocess.run([*command, "--data", str(folder / "local")], check=True, capture_output=True)
    manifest: Json = json.loads((folder / "out" / "manifest.json").read_text())
    return manifest


def answers(client: Client, url: str) -> Json:
    """Answers a second, and how long they take, of one case and of a list of 50."""
    case = next(client.simulations(page_size=1))
    result = {}
    for name, path in (("get", case.links["self"]), ("list", "/v1/simulations?limit=50")):
        times = sorted(asyncio.run(load(httpx.URL(url), path)))
        result[name] = {
            "per_second": round(len(times) / LOAD_SECONDS),
            "median_ms": round(1000 * statistics.median(times), 2),
            "p99_ms": round(1000 * times[int(0.99 * len(times))], 2),
        }
    return result


async def load(url: httpx.URL, path: str) -> list[float]:
    """Seconds of every answer, from several connections at once."""
    request = f"GET {path} HTTP/1.1\r\nHost: {url.netloc.decode()}\r\n\r\n".encode()
    end = time.perf_counter() + LOAD_SECONDS
    series = await asyncio.gather(*(_ask(url, request, end) for _ in range(CONNECTIONS)))
    return [seconds for times in series for seconds in times]


async def _ask(url: httpx.URL, request: bytes, end: float) -> list[float]:
    # A client library would take more of the machine than the service does.
    reader, writer = await asyncio.open_connection(url.host, url.port)
    times = []
    while (start := time.perf_counter()) < end:
        writer.write(request)
        head = await reader.readuntil(b"\r\n\r\n")
        if not head.startswith(b"HTTP/1.1 200 "):
            raise RuntimeError(head.decode())
        length = next(line for line in head.lower().split(b"\r\n") if line.startswith(b"content-length:"))
        await reader.readexactly(int(length.partition(b":")[2]))
        times.append(time.perf_counter() - start)
    writer.close()
    return times


def study(client: Client) -> Json:
    """Seconds until a study of a thousand cases is accepted; it is cancelled then."""
    axes = [{"kind": "grid", "field": "seed", "values": list(range(STUDY_CASES))}]
    body = {"name": "bench", "base": tiny(0).model_dump(mode="json"), "axes": axes}
    start = time.perf_counter()
    response = httpx.post(f"{client.url}/v1/studies", json=body, timeout=120)
    seconds = time.perf_counter() - start
    response.raise_for_status()
    httpx.post(client.url + response.json()["links"]["cancel"], timeout=120).raise_for_status()
    while httpx.get(client.url + response.json()["links"]["self"]).json()["finished_at"] is None:
        time.sleep(0.2)
    return {"study_cases": STUDY_CASES, "study_submission_seconds": round(seconds, 3)}


def paper(client: Client, preset: str, pause_seconds: float) -> Json:
    """The paper's case, then acquisitions of the same breast: phantom, mesh, compression and warp are in the store."""
    spec = presets.get(preset)
    first, _ = through(client, spec)
    seconds = []
    for views, degrees in ACQUISITIONS:
        other = spec.with_(acquisition=spec.acquisition.with_(views=views, angular_range_degrees=degrees))
        time.sleep(pause_seconds)
        with Stolen() as taken:
            took, manifest = through(client, other)
        seconds.append((round(took, 2), taken.share))
    stages = {stage["name"]: stage["seconds"] for stage in manifest["stages"]}
    return {
        "paper_first_seconds": round(first, 1),
        "paper_other_acquisition_seconds_and_stolen": seconds,
        "paper_pipeline_seconds": manifest["seconds"],
        "paper_stage_seconds": stages,
    }


def median(values: list[float]) -> float:
    return round(statistics.median(values), 3)


if __name__ == "__main__":
    sys.exit(main())
