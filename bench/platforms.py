"""python -m bench.platforms [--lock FILE]: which packages of the lock have no wheel for which Python and system.

Resolves the lock for every promised platform with pip, without building or installing anything, and compares what the
index offers with the hashes of the lock. Wants network. The last line is JSON; exit code 1 where something is missing.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from packaging.markers import Marker
from packaging.specifiers import SpecifierSet

ROOT = Path(__file__).parents[1]
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
GLIBC = (28, 27, 26, 24, 17, 12, 5)
"""Of manylinux tags: Debian 10, RHEL 8, Ubuntu 20.04 and later have them all."""


@dataclass(frozen=True)
class System:
    """A system to resolve for. markers: what its Python says of it."""

    name: str
    tags: tuple[str, ...]
    markers: dict[str, str]


def _linux(machine: str) -> System:
    tags = (*(f"manylinux_2_{n}_{machine}" for n in GLIBC), f"manylinux2014_{machine}", f"linux_{machine}")
    words = {"sys_platform": "linux", "platform_system": "Linux", "platform_machine": machine, "os_name": "posix"}
    return System(f"Linux {machine}", tags, words | {"platform_version": "#1 SMP", "platform_release": "6.1.0"})


def _macos(version: int) -> System:
    words = {"sys_platform": "darwin", "platform_system": "Darwin", "platform_machine": "arm64", "os_name": "posix"}
    kernel = f"{version + 9 if version < 26 else version - 1}.0.0"
    words |= {"platform_version": f"Darwin Kernel Version {kernel}: root", "platform_release": kernel}
    return System(f"macOS {version} arm64", (f"macosx_{version}_0_arm64",), words)


SYSTEMS = (_linux("x86_64"), _linux("aarch64"), _macos(14), _macos(15))


@dataclass(frozen=True)
class Pin:
    """A line of the lock."""

    name: str
    version: str
    marker: Marker | None
    hashes: frozenset[str]


def pins(lock: str) -> list[Pin]:
    """The lines of a lock that ``make lock`` wrote."""
    lines = []
    for entry in re.sub(r"\\\n", " ", lock).splitlines():
        if "==" not in entry or entry.startswith("#"):
            continue
        requirement, *hashes = entry.split("--hash=sha256:")
        pinned, _, marker = requirement.partition(" ;")
        name, _, version = pinned.strip().partition("==")
        digests = frozenset(h.strip() for h in hashes)
        lines.append(Pin(name, version, Marker(marker.strip()) if marker.strip() else None, digests))
    return lines


def wanted(lines: list[Pin], system: System, python: str) -> list[Pin]:
    """The lines that hold for a system and a Python."""
    words = {"python_version": python, "python_full_version": f"{python}.0", "implementation_name": "cpython"}
    words |= {"platform_python_implementation": "CPython", "implementation_version": f"{python}.0", "extra": ""}
    return [line for line in lines if line.marker is None or line.marker.evaluate(words | system.markers)]


def missing(lines: list[Pin], system: System, python: str) -> list[str]:
    """What has no wheel, or none that the lock knows, with its version.

    raises: RuntimeError with what pip said, where it says something else
    """
    left, absent = list(lines), []
    while True:
        with tempfile.TemporaryDirectory() as folder:
            ended, report = _resolve(left, system, python, Path(folder))
        if ended.returncode == 0:
            break
        name = re.search(r"No matching distribution found for ([A-Za-z0-9_.\-]+)==", ended.stderr)
        if name is None:
            raise RuntimeError(ended.stderr.strip()[-2000:])
        gone = next(line for line in left if line.name.lower() == name.group(1).lower())
        left.remove(gone)
        absent.append(f"{gone.name}=={gone.version}")
    hashes = {line.name.lower(): line.hashes for line in left}
    for item in report["install"]:
        digest = item["download_info"].get("archive_info", {}).get("hashes", {}).get("sha256")
        name = re.sub(r"[-_.]+", "-", item["metadata"]["name"]).lower()
        needed = item["metadata"].get("requires_python") or ">=3"
        if not SpecifierSet(needed).contains(f"{python}.20"):  # a late patch release
            absent.append(f"{name}=={item['metadata']['version']} (needs Python {needed})")
        if digest is not None and digest not in hashes[name]:
            absent.append(f"{name}=={item['metadata']['version']} (not among the hashes of the lock)")
    return absent


def _resolve(
    lines: list[Pin], system: System, python: str, folder: Path
) -> tuple[subprocess.CompletedProcess[str], dict[str, list[dict[str, Any]]]]:
    requirements, report = folder / "requirements.txt", folder / "report.json"
    requirements.write_text("".join(f"{line.name}=={line.version}\n" for line in lines))
    command = [sys.executable, "-m", "pip", "install", "--dry-run", "--quiet", "--disable-pip-version-check"]
    command += [
        "--no-deps",
        "--only-binary=:all:",
        "--ignore-installed",
        "--ignore-requires-python",
        "--target",
        str(folder / "target"),
    ]
    command += ["--python-version", python, "--implementation", "cp", "--report", str(report), "-r", str(requirements)]
    command += [word for tag in system.tags for word in ("--platform", tag)]
    ended = subprocess.run(command, capture_output=True, text=True)
    return ended, json.loads(report.read_text()) if ended.returncode == 0 else {"install": []}


def left_out(lines: list[Pin], chosen: list[Pin], system: System) -> list[str]:
    """What the markers leave out on a system that has it on another Python or version: said by name."""
    names = {line.name for line in chosen}
    rest = {line.name for line in lines if line.name not in names}
    return sorted(rest & {"pyjpegls", "pytetwild"})


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lock", type=Path, default=ROOT / "requirements.lock")
    args = parser.parse_args()
    lines = pins(args.lock.read_text())
    cases = [(system, python) for system in SYSTEMS for python in PYTHONS]

    def resolve(case: tuple[System, str]) -> dict[str, object]:
        system, python = case
        chosen = wanted(lines, system, python)
        absent = missing(chosen, system, python)
        without = left_out(lines, chosen, system)
        said = ", ".join(absent) or "nothing is missing"
        note = f"; by its marker without {', '.join(without)}" if without else ""
        print(f"{system.name:<14} Python {python}: {len(chosen)} packages, {said}{note}", flush=True)
        return {"system": system.name, "python": python, "missing": absent, "left_out": without}

    with ThreadPoolExecutor(2) as pool:
        rows = list(pool.map(resolve, cases))
    complete = not any(row["missing"] for row in rows)
    print(json.dumps({"complete": complete, "packages": len(lines), "platforms": rows}))
    return 0 if complete else 1


if __name__ == "__main__":
    sys.exit(main())
