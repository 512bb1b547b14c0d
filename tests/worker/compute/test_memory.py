"""What the kernel counts as killed for want of memory, wherever it says so."""

import pytest

from worker.compute import memory


@pytest.mark.parametrize(
    ("membership", "file", "content", "count"),
    [
        ("0::/box/worker\n", "box/worker/memory.events", "low 0\noom 9\noom_kill 3\noom_group_kill 1\n", 3),
        ("0::/elsewhere\n", "memory.events", "oom_kill 2\n", 2),  # the path is that of the host, not of the container
        ("9:cpu:/\n4:memory:/box\n0::/\n", "memory/box/memory.oom_control", "under_oom 0\noom_kill 5\n", 5),
        ("4:memory:/gone\n", "memory/memory.oom_control", "oom_kill_disable 0\noom_kill 1\n", 1),
        ("0::/\n", "other", "", 0),
    ],
)
def test_the_count_of_the_kernel(tmp_path, monkeypatch, membership, file, content, count):
    path = tmp_path / "cgroup" / file
    path.parent.mkdir(parents=True)
    path.write_text(content)
    (tmp_path / "self").write_text(membership)
    monkeypatch.setattr(memory, "_PROC", tmp_path / "self")
    monkeypatch.setattr(memory, "_ROOT", tmp_path / "cgroup")
    assert memory.kernel_kills() == count


@pytest.mark.parametrize(
    ("code", "words", "killed", "because"),
    [
        (
            -6,
            b"terminate called after throwing an instance of 'std::bad_alloc'\n  what():  std::bad_alloc\n",
            False,
            "may",
        ),
        (-6, b"free(): invalid pointer\n", True, None),
        (-11, b"std::bad_alloc", True, None),
        (-9, b"", True, "kernel"),
        (-9, b"std::bad_alloc", False, None),
        (3, b"memory allocation of 8 bytes failed", True, None),
    ],
)
def test_what_was_for_want_of_memory(code, words, killed, because):
    error = memory.explain(code, words, 2_000_000_000, killed)
    if because is None:
        assert error is None
        return
    assert (error["code"], error["kind"]) == ("out-of-memory", "system")
    assert because in error["message"]
    assert "2.0 GB" in error["message"]
