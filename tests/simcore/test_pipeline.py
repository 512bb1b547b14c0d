"""The whole way from specification to DICOM with a tiny breast: caching, continuing, determinism, failures."""

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from simcore import dicom, fem, mesh, pipeline, presets, preview, reconstruction
from simcore.core.errors import SimulationError
from simcore.core.tissues import Tissue
from simcore.dicom import check
from simcore.fem.laws.by_tissue import ByTissue
from simcore.fem.laws.published import Published
from simcore.mesh.spec import LatticeMesh
from simcore.phantom.lesions import Mass
from simcore.reconstruction.spec import Sart
from simcore.store import codecs
from simcore.store.hashing import FileRef
from simcore.store.store import Store

SPEC = presets.get("tiny")
STAGES = pipeline.stages_of(SPEC)
KEPT = Sart(iterations=1)
"""A reconstruction whose volume is stored."""


@pytest.fixture(scope="module")
def first(tmp_path_factory) -> pipeline.CaseResult:
    return pipeline.run(SPEC, Store(tmp_path_factory.mktemp("store"), min_free_bytes=0))


def digests(folder: Path) -> dict[str, str]:
    return {
        p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in folder.rglob("*")
        if p.is_file()
    }


def cached(result: pipeline.CaseResult) -> list[str]:
    return [s["name"] for s in result.manifest["stages"] if s["cached"]]


def test_the_manifest_tells_what_was_done(first):
    stages = first.manifest["stages"]
    assert [s["name"] for s in stages] == list(STAGES)
    for s in stages:
        assert len(s["key"]) == 64
        assert s["cached"] is False
        assert s["seconds"] >= 0
        assert s["peak_memory_bytes"] > 0
        assert s["outputs"]
    results = first.manifest["results"]
    assert results["volume_ml"] == pytest.approx(SPEC.phantom.volume_ml, rel=0.01)
    assert results["glandularity"] == pytest.approx(SPEC.phantom.glandularity, abs=0.02)
    assert results["force_N"] > 0
    assert 0 < results["thickness_mm"] < results["uncompressed_thickness_mm"]
    assert results["min_det_F"] > 0
    json.dumps(first.manifest)


def test_a_report_without_lesions_is_told_to_be_left_out(first, tmp_path):
    """It was asked for; the study holds no lesion to report."""
    assert first.manifest["results"]["left_out"] == {"lesions.dcm": "the volume holds no lesion"}
    spec = SPEC.with_(export=SPEC.export.with_(extra_objects=["report"]))
    again = pipeline.run(spec, first.store)
    assert again.manifest["results"]["left_out"] == dict.fromkeys(
        ["lesions.dcm", "report.dcm"], "the volume holds no lesion"
    )
    assert "report.dcm" not in again.manifest["files"]
    spotted = SPEC.phantom.with_(lesions=(Mass(),))
    result = pipeline.run(spec.with_(phantom=spotted), first.store)
    assert "left_out" not in result.manifest["results"]
    assert {"report.dcm", "lesions.dcm", "truth.csv", "file_paths.csv"} <= set(result.manifest["files"])


def test_all_files_are_written(first, tmp_path):
    first.write(tmp_path)
    names = set(digests(tmp_path))
    views = {f"projections/{k + 1:04d}.dcm" for k in range(SPEC.acquisition.views)}
    assert {
        "manifest.json",
        "geometry.json",
        "projections.dcm",
        "tomosynthesis.dcm",
        "labels.dcm",
        "compression.vtu",
        *views,
    } <= names
    assert any(n.startswith("preview/") and n.endswith(".png") for n in names)
    listed = {n: ref["sha256"] for n, ref in first.manifest["files"].items()}
    assert listed == {n: d for n, d in digests(tmp_path).items() if n != "manifest.json"}


def test_the_dicom_files_conform(first, tmp_path):
    first.write(tmp_path)
    wrong = [str(v) for v in check.verdicts(sorted(tmp_path.rglob("*.dcm"))) if not v.ok]
    assert wrong == []


def test_a_second_run_computes_nothing_and_gives_the_same_files(first):
    reports = []
    again = pipeline.run(
        SPEC, first.store, lambda stage, fraction, message, *, cached=False: reports.append((stage, cached))
    )
    assert again.manifest["computed_stages"] == 0
    assert again.files == first.files
    assert {stage for stage, cached in reports if cached} == set(STAGES)


def test_another_acquisition_of_the_same_breast_computes_only_what_differs(first):
    other = SPEC.with_(acquisition=SPEC.acquisition.with_(views=3))
    result = pipeline.run(other, first.store)
    assert cached(result) == ["phantom", "mesh", "fem", "warp", "mechanics"]


def test_another_seed_is_another_breast_of_the_same_outline(first):
    result = pipeline.run(SPEC.with_(seed=SPEC.seed + 1), first.store)
    assert cached(result) == ["mesh", "fem"]


def test_another_volume_is_another_outline(first):
    result = pipeline.run(SPEC.with_(phantom=SPEC.phantom.with_(volume_ml=61.0)), first.store)
    assert cached(result) == []


def labels_of(result, stage):
    refs = next(s["outputs"] for s in result.manifest["stages"] if s["name"] == stage)
    return codecs.load_phantom(lambda name: result.store.path(FileRef(**refs[name]))).labels


def test_a_pair_with_and_without_a_lesion_shares_its_anatomy(first):
    lesion = Mass(size_mm=(6.0, 6.0, 6.0))
    present = pipeline.run(SPEC.with_(phantom=SPEC.phantom.with_(lesions=(lesion,))), first.store)
    assert cached(present) == ["mesh", "fem"]
    for stage in ("phantom", "warp"):
        without, with_lesion = labels_of(first, stage), labels_of(present, stage)
        mass = with_lesion == Tissue.MASS
        assert 10 < mass.sum() < 1000
        assert np.array_equal(with_lesion[~mass], without[~mass])
        assert not np.any(without == Tissue.MASS)


def test_stages_that_read_tissues_share_nothing(first):
    spec = SPEC.with_(
        compression=SPEC.compression.with_(material=ByTissue.example()), mesh=SPEC.mesh.with_(border_refinement=1.5)
    )
    pipeline.run(spec, first.store)
    assert cached(pipeline.run(spec.with_(seed=SPEC.seed + 7), first.store)) == []


def test_which_stages_read_tissues():
    assert not mesh.reads_tissues(SPEC.mesh)
    assert mesh.reads_tissues(SPEC.mesh.with_(border_refinement=1.5))
    assert not mesh.reads_tissues(LatticeMesh())
    assert not fem.reads_tissues(SPEC.compression)
    for law in (ByTissue.example(), Published.example()):
        assert fem.reads_tissues(SPEC.compression.with_(material=law))


def test_the_name_changes_no_result(first):
    assert pipeline.run(SPEC.with_(name="another"), first.store).manifest["computed_stages"] == 0


def test_one_and_two_threads_give_the_same_bytes(first, threads):
    """With the same mesh: all but it is forgotten and computed again with another number of threads."""
    outputs = []
    for count in (1, 2):
        threads(count)
        forget(first.store, set(pipeline.STAGES) - {"mesh"})
        again = pipeline.run(SPEC, first.store)
        assert cached(again) == ["mesh"]
        outputs.append({s["name"]: s["outputs"] for s in again.manifest["stages"]})
    assert outputs[0] == outputs[1]


def forget(store: Store, stages: set[str]) -> None:
    for path in (store.root / "stages").rglob("*.json"):
        if json.loads(path.read_bytes())["stage"] in stages:
            path.unlink()


def test_a_failing_stage_keeps_what_was_computed(first, monkeypatch):
    def fail(*arguments, **keywords):
        raise SimulationError("no picture today: change nothing")

    forget(first.store, {"reconstruction"})
    monkeypatch.setattr(reconstruction, "reconstruct", fail)
    with pytest.raises(SimulationError, match="no picture"):
        pipeline.run(SPEC, first.store)
    monkeypatch.undo()
    result = pipeline.run(SPEC, first.store)
    assert [s["name"] for s in result.manifest["stages"] if not s["cached"]] == ["reconstruction"]


def test_a_volume_that_is_quickly_made_is_made_again_where_it_is_asked_for(first):
    outputs = {s["name"]: s["outputs"] for s in first.manifest["stages"]}
    assert list(outputs["reconstruction"]) == ["meta.json"]
    forget(first.store, {"dicom", "preview"})
    again = pipeline.run(SPEC, first.store)
    assert [s["name"] for s in again.manifest["stages"] if not s["cached"]] == ["dicom", "preview"]
    assert {s["name"]: s["outputs"] for s in again.manifest["stages"]} == outputs


def test_a_volume_that_takes_long_is_kept(first, monkeypatch):
    spec = SPEC.with_(reconstruction=KEPT)
    manifest = pipeline.run(spec, first.store).manifest
    forget(first.store, {"dicom", "preview"})
    monkeypatch.setattr(reconstruction, "reconstruct", None)
    again = pipeline.run(spec, first.store).manifest
    assert [s["name"] for s in again["stages"] if not s["cached"]] == ["dicom", "preview"]
    assert again["files"] == manifest["files"]


def test_stages_are_told_in_order_though_some_run_beside_others(first):
    forget(first.store, {"dicom", "mechanics", "preview"})
    stages = []
    result = pipeline.run(SPEC, first.store, lambda stage, fraction, message, *, cached=False: stages.append(stage))
    assert result.manifest["computed_stages"] == 3
    assert list(dict.fromkeys(stages)) == list(pipeline.STAGES)
    assert stages == sorted(stages, key=pipeline.STAGES.index)


def test_what_runs_beside_a_failing_stage_is_kept(first, monkeypatch):
    last = {"reconstruction", "dicom", "mechanics", "preview"}
    forget(first.store, last)

    def fail(*arguments, **keywords):
        raise SimulationError("no files today")

    monkeypatch.setattr(dicom, "export", fail)
    with pytest.raises(SimulationError, match="no files"):
        pipeline.run(SPEC, first.store)
    monkeypatch.undo()
    assert cached(pipeline.run(SPEC, first.store)) == [s for s in STAGES if s != "dicom"]
    monkeypatch.setattr(preview, "write_previews", fail)
    forget(first.store, last)
    with pytest.raises(SimulationError, match="no files"):
        pipeline.run(SPEC, first.store)
    monkeypatch.undo()
    assert cached(pipeline.run(SPEC, first.store)) == [s for s in STAGES if s != "preview"]


BUSY = """
import sys, threading
import numba, numpy as np
from simcore import pipeline
from simcore.store.store import Store
from simcore.spec import SimulationSpec

@numba.njit(parallel=True)
def busy(values):
    for i in numba.prange(values.size):
        values[i] = np.sqrt(values[i] + 1.0)

busy(np.ones(1000))
ended = threading.Event()
def work():
    while not ended.is_set():
        busy(np.ones(300_000))
other = threading.Thread(target=work)
other.start()
result = pipeline.run(SimulationSpec.parse(sys.argv[2].encode()), Store(sys.argv[1], min_free_bytes=0))
ended.set()
other.join()
assert result.manifest["computed_stages"] == 2, result.manifest["computed_stages"]
"""


def test_mechanics_and_pictures_start_no_parallel_kernel(first):
    """They run beside the export; numba ends the process where two threads start parallel kernels at a time."""
    spec = SPEC.with_(reconstruction=KEPT)
    pipeline.run(spec, first.store)
    forget(first.store, {"mechanics", "preview"})
    command = [sys.executable, "-c", BUSY, str(first.store.root), spec.model_dump_json()]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_a_killed_run_continues_after_its_last_whole_stage(first, tmp_path):
    spec = tmp_path / "spec.json"
    spec.write_text(SPEC.with_(seed=77).model_dump_json())
    command = [
        sys.executable,
        "-m",
        "tomosim",
        "simulate",
        str(spec),
        "--out",
        str(tmp_path / "out"),
        "--data",
        str(tmp_path / "data"),
    ]
    killed = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    assert killed.stderr is not None
    for line in killed.stderr:
        if line.startswith("fem:"):
            break
    os.killpg(killed.pid, signal.SIGKILL)
    killed.wait()
    time.sleep(0.1)
    assert not (tmp_path / "out").exists()
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "phantom: from the store" in done.stderr
    assert "mesh: from the store" in done.stderr
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    cached = [s["name"] for s in manifest["stages"] if s["cached"]]
    assert cached[:2] == ["phantom", "mesh"]
    assert manifest["computed_stages"] == len(STAGES) - len(cached) > 0
