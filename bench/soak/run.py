"""Does the service lose anything? Small cases through two workers, while processes are killed at random.

    python -m bench.soak [--cases 200] [--seconds 300] [--seed 1] [--pause 3]

Compute processes, workers, the broker and the API get SIGKILL every few seconds, drawn from the seed. In the end every
case must have succeeded with the files of an undisturbed run, or failed by its own fault; every object of the store
must hold what its name says; no case may have ended twice; no process may be left. Some cases are made to fail, some
are cancelled on the way.

Last line: {"cases", "lost", "torn", "duplicates", "kills", ...}; exit code 1 where anything of it is wrong.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import random
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

from bench.soak.check import Finding, check, left_running, reference_files
from bench.soak.service import Service
from simcore import presets
from simcore.mesh.spec import LatticeMesh
from simcore.spec import SimulationSpec
from tomosim.client import Client, ConflictError, Retrying
from tomosim_contract.names import FINAL_STATES

ACQUISITIONS = (3, 4, 5, 6, 7)
"""Views of the acquisitions of one breast: stages before the projection are shared."""

FAILING_EVERY = 20
CANCELLED_EVERY = 16
KILLS = {"compute": 4, "worker": 2, "broker": 1, "api": 1}
"""How often each is killed, relative to the others."""

PATIENCE_SECONDS = 900.0
"""Cases that have not ended so long after the last kill are lost."""

Json = dict[str, Any]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=300.0, help="for so long processes are killed")
    parser.add_argument("--pause", type=float, default=3.0, help="mean time between two kills [s]")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="soak-", ignore_cleanup_errors=True) as folder:
        result, findings = soak(Path(folder), args.cases, args.seconds, args.pause, args.seed)
    for finding in findings:
        print(f"{finding.kind}: {finding.text}", file=sys.stderr)
    print(json.dumps(result))
    return 1 if findings else 0


def soak(folder: Path, cases: int, seconds: float, pause: float, seed: int) -> tuple[Json, list[Finding]]:
    """The figures of one run, and everything that is wrong. folder: empty, on a disk with room."""
    start = time.monotonic()
    specs = {f"soak-{number:03d}": specification(number) for number in range(cases)}
    # Kernels are compiled once before: a process that is killed every few seconds would never get through with it.
    reference_files({"first": specification(0)}, folder / "warm")
    service = Service(folder / "data")
    try:
        service.start()
        say("service ready")
        posting = Posting(service.url, specs, seconds * 0.8, seed)
        posting.start()
        kills = kill_at_random(service, posting, seconds, pause, seed)
        say(f"{sum(kills.values())} kills: {dict(kills)}")
        wait_for_the_end(service, posting)
        findings = [Finding("posting", repr(error)) for error in posting.errors]
        service.stop()
        findings += left_running(service.marker)
    finally:
        service.kill()
    say("comparing with an undisturbed run")
    expected = reference_files(specs, folder / "reference")
    checked = check(service.settings, specs, expected, posting.cancelled)
    findings += checked.findings
    count = Counter(finding.kind for finding in findings)
    return {
        "cases": cases,
        "lost": count["lost"],
        "torn": count["torn"],
        "duplicates": count["duplicate"],
        "kills": sum(kills.values()),
        "killed": dict(kills),
        "orphans": count["orphan"],
        "states": checked.states,
        "attempts": checked.attempts,
        "seed": seed,
        "seconds": round(time.monotonic() - start, 1),
    }, findings


def specification(number: int) -> SimulationSpec:
    """The tiny case number ``number``: several acquisitions of each breast; now and then one that must fail."""
    tiny = presets.get("tiny")
    spec = tiny.with_(
        name=f"soak-{number:03d}",
        seed=1 + number // len(ACQUISITIONS),
        reproducible=True,
        mesh=LatticeMesh(edge_length_mm=12.0),
        acquisition=tiny.acquisition.with_(views=ACQUISITIONS[number % len(ACQUISITIONS)]),
    )
    if must_fail(number):
        spec = spec.with_(compression=tiny.compression.with_(force_N=2000.0))  # more than the plates may press
    return spec


def must_fail(number: int) -> bool:
    return number % FAILING_EVERY == FAILING_EVERY // 2


class Posting(threading.Thread):
    """Posts the cases one after the other as a patient client does, and cancels some of them."""

    def __init__(self, url: str, specs: dict[str, SimulationSpec], seconds: float, seed: int) -> None:
        super().__init__(name="posting", daemon=True)
        self.url = url
        self.specs = specs
        self.pause = seconds / len(specs)
        self.random = random.Random(seed + 1)
        self.identifiers: dict[str, str] = {}
        self.cancelled: set[str] = set()
        self.errors: list[Exception] = []

    def run(self) -> None:
        retrying = Retrying(attempts=100, first_seconds=0.2, longest_seconds=2.0)
        try:
            with Client(self.url, retrying=retrying) as client:
                for number, (name, spec) in enumerate(self.specs.items()):
                    self.identifiers[name] = client.submit(spec).id
                    time.sleep(self.pause * self.random.uniform(0.5, 1.5))
                    if number % CANCELLED_EVERY == CANCELLED_EVERY - 1:
                        self._cancel(client, name)
        except Exception as error:
            self.errors.append(error)

    def _cancel(self, client: Client, name: str) -> None:
        self.cancelled.add(name)
        with contextlib.suppress(ConflictError):  # it was faster
            client.cancel(self.identifiers[name])


def kill_at_random(service: Service, posting: Posting, seconds: float, pause: float, seed: int) -> Counter[str]:
    """Kills one process after the other; how many of each kind."""
    chance = random.Random(seed)
    kills: Counter[str] = Counter()
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        kind = chance.choices(list(KILLS), list(KILLS.values()))[0]
        service.watch(min(left, chance.uniform(0.2, 2.0) * pause))
        if time.monotonic() < end and service.kill_one(kind, chance):
            kills[kind] += 1
            if sum(kills.values()) % 10 == 0:
                say(f"{sum(kills.values())} kills, {len(posting.identifiers)} posted, states {service.counts()}")
    return kills


def wait_for_the_end(service: Service, posting: Posting) -> None:
    """Until all cases are posted and have ended, or patience has."""
    deadline = time.monotonic() + PATIENCE_SECONDS
    while time.monotonic() < deadline:
        service.watch(0.2)
        counts = service.counts()
        if not posting.is_alive() and not set(counts) - set(FINAL_STATES):
            return
    say(f"not ended after {PATIENCE_SECONDS:g} s: {service.counts()}")


def say(text: str) -> None:
    print(f"soak: {text}", file=sys.stderr, flush=True)
