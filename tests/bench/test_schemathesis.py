"""Schemathesis finds nothing: a bounded run over every operation. A long one: python -m bench.schemathesis."""

from bench.schemathesis import run as schemathesis


def test_every_operation(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    with schemathesis.service() as target:
        code, output = schemathesis.run(target, ["--phases=fuzzing", "--max-examples=1", "--generation-deterministic"])
    assert code == 0, output
    assert list(tmp_path.iterdir()) == []  # what Schemathesis keeps of a run, it keeps elsewhere
