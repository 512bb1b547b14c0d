"""Schemathesis finds nothing: a bounded run over every operation. A long one: python -m bench.schemathesis."""

from bench import schemathesis


def test_every_operation(monkeypatch):
    with schemathesis.service() as target:
        code, output = schemathesis.run(target, ["--phases=fuzzing", "--max-examples=1", "--generation-deterministic"])
    assert code == 0, output
