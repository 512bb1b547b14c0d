"""The command line: what it prints, its exit codes, its messages."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from simcore import presets, warmup
from simcore.spec import SimulationSpec
from tomosim import cli
from tomosim.cli import _summary


def tomosim(*arguments: str, stdin: str = "", **kwargs) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "tomosim", *arguments],
        input=stdin,
        capture_output=True,
        text=True,
        timeout=300,
        **kwargs,
    )


def test_presets_lists_one_name_a_line_in_the_first_column():
    done = tomosim("presets")
    assert done.returncode == 0
    assert [line.split()[0] for line in done.stdout.splitlines()] == presets.names()
    assert "paper-cup-c-20" in done.stdout


def test_a_preset_is_printed_as_a_specification_to_edit():
    done = tomosim("presets", "paper-cup-c-20")
    assert SimulationSpec.parse(done.stdout) == presets.get("paper-cup-c-20")


def test_an_unknown_preset_names_those_there_are():
    done = tomosim("presets", "cup-z")
    assert done.returncode == 2
    assert "'cup-z'" in done.stderr
    assert "paper-cup-c-20" in done.stderr


def test_estimate_from_standard_input():
    done = tomosim("estimate", "-", stdin=presets.get("tiny").model_dump_json())
    assert done.returncode == 0
    assert json.loads(done.stdout)["memory_bytes"] > 0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"phantom": {"voxel_mm": 0.01}}', "phantom.voxel_mm = 0.01"),
        ('{"acquisition": {"views": 1000}}', "acquisition.views = 1000"),
        ("{", "not valid"),
        ('{"acquisition": {"detector": {"pixels_y": 500}}}', "at least"),
    ],
)
def test_a_bad_specification_is_refused_before_anything_runs(text: str, said: str, tmp_path: Path):
    (tmp_path / "spec.json").write_text(text)
    done = tomosim("simulate", str(tmp_path / "spec.json"), "--out", str(tmp_path / "out"), cwd=tmp_path)
    assert done.returncode == 2
    assert said in done.stderr
    assert "Traceback" not in done.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == ["spec.json"]


def test_a_missing_file_says_how_to_begin(tmp_path: Path):
    done = tomosim("simulate", "nothing.json", "--out", "out", cwd=tmp_path)
    assert done.returncode == 2
    assert "nothing.json" in done.stderr
    assert "tomosim presets NAME" in done.stderr


def test_submit_without_a_service_says_so(tmp_path: Path):
    done = tomosim("submit", "-", "--url", "http://127.0.0.1:9", stdin=presets.get("tiny").model_dump_json())
    assert done.returncode == 4
    assert "tomosim serve" in done.stderr


@pytest.mark.parametrize("arguments", [["simulate"], ["nonsense"], ["simulate", "s", "--out", "o", "--threads", "0"]])
def test_wrong_usage_exits_with_2(arguments: list[str]):
    assert tomosim(*arguments).returncode == 2


def test_a_phantom_of_ones_own_is_added_and_used(tmp_path: Path):
    z, y, x = np.meshgrid(np.arange(-10, 11), np.arange(-12, 13), np.arange(20), indexing="ij")
    labels = np.where((x / 18) ** 2 + (y / 11) ** 2 + (z / 9) ** 2 <= 1, 5, 0).astype("u1")
    (tmp_path / "p.raw").write_bytes(labels.tobytes())
    (tmp_path / "p.json").write_text(json.dumps({"shape": labels.shape, "spacing_mm": [2.0, 2.0, 2.0]}))
    (tmp_path / "map.json").write_text('{"0": "air", "5": "adipose"}')
    add = ["phantom", "add", "p.raw", "--header", "p.json", "--data", "here"]
    refused = tomosim(*add, cwd=tmp_path)
    assert refused.returncode == 2
    assert "no tissue for 5" in refused.stderr
    done = tomosim(*add, "--tissue-map", "map.json", "--axes", "+z,-y,+x", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    part = SimulationSpec.parse(done.stdout).phantom
    assert (part.kind, part.shape, part.axes) == ("uploaded", labels.shape, ("+z", "-y", "+x"))
    listed = tomosim("phantom", "list", "--data", "here", cwd=tmp_path)
    assert listed.stdout.split() == [part.sha256, "nrrd", *["21", "x", "25", "x", "20"], "p.raw"]
    case = presets.get("tiny").with_(phantom=part).model_dump_json()
    (tmp_path / "case.json").write_text(case)
    missing = tomosim("simulate", "case.json", "--out", "out", "--data", "elsewhere", cwd=tmp_path)
    assert missing.returncode == 2
    assert "tomosim phantom add" in missing.stderr


def test_axes_and_size_of_a_phantom_are_said_on_the_command_line(tmp_path: Path):
    z, y, x = np.meshgrid(np.arange(-10, 11), np.arange(-12, 13), np.arange(20), indexing="ij")
    labels = np.where((x / 18) ** 2 + (y / 11) ** 2 + (z / 9) ** 2 <= 1, 1, 0).astype("u1")
    labels[(labels == 1) & (x > 2) & (abs(y) < 5)] = 29
    head = "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 20 25 21\nencoding: raw\nspacings: 0.2 0.2 0.2\n"
    (tmp_path / "a.nrrd").write_bytes(head.encode() + b"\n" + labels.tobytes())
    add = ["phantom", "add", "a.nrrd", "--data", "here"]
    refused = tomosim(*add, cwd=tmp_path)
    assert refused.returncode == 2
    assert re.search("the tissue is 0.0.* ml .* a breast has from 20 ml to 5 l.* ml in cm", refused.stderr)
    for axes in (["--axes", "-z,-y,+x"], ["--axes=-z,-y,+x"]):
        done = tomosim(*add, *axes, "--confirm-size", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert SimulationSpec.parse(done.stdout).phantom.axes == ("-z", "-y", "+x")
        assert "axes: -z,-y,+x as given, not +z,+y,+x as in the file" in done.stderr
    right = tomosim(*add, "--spacing-mm", "2,2,2", cwd=tmp_path)
    assert SimulationSpec.parse(right.stdout).phantom.spacing_mm == (2.0, 2.0, 2.0)


@pytest.mark.parametrize("wrong", [["--axes", "+x,+x,+z"], ["--header", "gone.json"], ["--tissue-map", "a.nrrd"]])
def test_a_wrong_option_of_phantom_add_is_named(wrong: list[str], tmp_path: Path):
    (tmp_path / "a.nrrd").write_bytes(b"NRRD")
    done = tomosim("phantom", "add", "a.nrrd", *wrong, cwd=tmp_path)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert wrong[0].strip("-") in done.stderr or wrong[1] in done.stderr


def test_the_summary_of_a_run_shows_what_became_of_the_volume(capsys: pytest.CaptureFixture[str]) -> None:
    results = {"thickness_mm": 30.0, "volume_ml": 60.0, "glandularity": 0.3, "force_N": 50.0}
    manifest = {"results": results, "computed_stages": 9, "stages": [{}] * 9, "seconds": 1.0}
    _summary(manifest, Path("out"))
    assert "volume 60.0 ml, glandularity 30.0 %" in capsys.readouterr().out
    results["volume_after_ml"] = 59.2
    results["cautions"] = ["1 objects of calcification touch another one after compression"]
    _summary(manifest, Path("out"))
    output = capsys.readouterr()
    assert "volume 60.0 ml (59.2 ml compressed), glandularity" in output.out
    assert output.err == "tomosim: 1 objects of calcification touch another one after compression\n"


@pytest.mark.parametrize(("cold", "threads", "processes"), [(True, None, 2), (True, 1, None), (False, None, None)])
def test_the_first_case_of_an_installation_compiles_with_several_processes(monkeypatch, cold, threads, processes):
    compiled = []
    monkeypatch.setattr(warmup, "cores", lambda: 2)
    monkeypatch.setattr(warmup, "is_cold", lambda: cold)
    monkeypatch.setattr(warmup, "compile_all", lambda count, tell, names: compiled.append((count, names)))
    cli._compile_if_cold(threads)
    assert compiled == ([(processes, warmup.OF_MOST_CASES)] if processes else [])
