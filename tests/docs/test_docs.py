"""What the documentation says is there: settings, links, presets, commands."""

import csv
import json
import re
from importlib.util import find_spec
from pathlib import Path

import pytest

from simcore import presets
from tomosim.cli import _parser
from worker.settings import SECRETS, Settings

ROOT = Path(__file__).parents[2]
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_lead_somewhere(page: Path):
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text()):
        if "://" not in target:
            assert (page.parent / target).exists(), target


def test_every_setting_is_documented_with_its_default_and_meaning():
    text = (ROOT / "docs" / "service" / "settings.md").read_text()
    rows = {
        name.lower(): row for name, *row in re.findall(r"^\| `TOMOSIM_([A-Z_]+)` \| `(.*)` \| (.+) \|$", text, re.M)
    }
    assert rows == {
        name: ["" if name == "admin_key" else str(field.default), field.description]
        for name, field in Settings.model_fields.items()
    }


def test_every_setting_that_may_lie_in_a_file_is_named():
    text = (ROOT / "docs" / "service" / "settings.md").read_text()
    assert set(re.findall(r"`TOMOSIM_([A-Z_]+)_FILE`", text)) == {name.upper() for name in SECRETS}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_commands_on_the_pages_exist(page: Path):
    blocks = re.findall(r"```sh\n(.*?)```", page.read_text(), re.DOTALL)
    for line in "\n".join(blocks).splitlines():
        words = line.split("#")[0].replace(".venv/bin/", "").split()
        if not words or words[0] != "tomosim":
            continue
        arguments = words[1 : words.index(">")] if ">" in words else words[1:]
        args = _parser().parse_args(arguments)
        if words[1] == "presets" and args.name:
            assert args.name in presets.names()


def test_the_python_example_of_the_readme_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    code = re.search(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert code is not None
    monkeypatch.chdir(tmp_path)
    exec(compile(code[1], "README.md", "exec"), {})
    assert re.fullmatch(r"\d+\.\d+ N\n", capsys.readouterr().out)
    assert (tmp_path / "case" / "manifest.json").exists()


def test_the_page_of_presets_shows_the_geometries_and_cups_of_the_data_with_their_sources():
    text = (ROOT / "docs" / "presets.md").read_text()
    data = ROOT / "simcore" / "data"
    rows = list(csv.DictReader((data / "systems.csv").read_text().splitlines()))
    lines = [f"| `{r['system']}` | `{r['field']}` | {json.loads(r['value'])} | {r['source']} |" for r in rows]
    for cup, (volume, compartments) in presets.CUPS.items():
        names = ", ".join(f"`paper-cup-{cup}-{percent}`" for percent in presets.PERCENTS)
        lines.append(f"| {names} | {cup.upper()} | {volume:g} ml | {compartments} |")
    shown = [line for line in text.splitlines() if line.startswith("| `")]
    assert sorted(shown) == sorted(lines)
    section = (data / "SOURCES.md").read_text().partition("## systems.csv")[2].partition("\n## ")[0]
    assert {row["source"] for row in rows} == set(re.findall(r"^\| ([A-Z]\d?) \|", section, re.MULTILINE))


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_benches_on_the_pages_exist(page: Path):
    for name in re.findall(r"python -m\s+(bench[.\w]*\w)", page.read_text()):
        assert find_spec(name) is not None, name


def test_the_page_of_performance_is_one_table_that_says_of_every_figure_when_it_was_measured():
    text = (ROOT / "docs" / "performance.md").read_text()
    head, line, *rows = [row for row in text.splitlines() if row.startswith("|")]
    assert set(line) == {"|", "-", " "}
    assert all(row.count("|") == head.count("|") for row in rows)
    assert all(re.search(r"\| \d{1,2} (Nov|Dec)[^|]* \|$", row) for row in rows)
    assert text.count("\n| ---") == 1
