"""docs/deploy.md, line by line: two hosts are two network namespaces with a cable between them."""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from tests.support.services import need

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "docs" / "deploy.md").read_text()
BLOCKS = re.findall(r"<!-- on: (\w+) -->\n```sh\n(.*?)```", PAGE, re.DOTALL)
ADDRESSES = {"storage": "10.77.0.1", "compute": "10.77.0.2"}
# PostgreSQL refuses to run as root; what is written in Python may lie where only root gets.
USERS = {"storage": ("storage", "nobody"), "objects": ("storage", "root"), "compute": ("compute", "root")}
PATIENCE_SECONDS = 180


def test_the_page_has_all_its_blocks():
    assert [host for host, _ in BLOCKS] == [
        "storage", "objects", "compute", "compute", "compute", "storage", "compute", "storage", "compute", "compute",
    ]  # fmt: skip
    assert len(re.findall("```sh", PAGE)) == len(BLOCKS)


def ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True)


@pytest.fixture
def hosts():
    """Names of the namespaces by host."""
    if os.getuid() != 0 or shutil.which("ip") is None:
        pytest.skip("needs root and the Debian package iproute2: network namespaces")
    names = {host: f"tomosim-{host}-{os.getpid()}" for host in ADDRESSES}
    ends = {"storage": f"tms{os.getpid()}", "compute": f"tmc{os.getpid()}"}
    try:
        try:
            for name in names.values():
                ip("netns", "add", name)
        except subprocess.CalledProcessError as error:
            pytest.skip(f"needs the right to make network namespaces: {error.stderr.decode().strip()}")
        ip("link", "add", ends["storage"], "type", "veth", "peer", "name", ends["compute"])
        for host, name in names.items():
            ip("link", "set", ends[host], "netns", name)
            ip("-n", name, "address", "add", f"{ADDRESSES[host]}/24", "dev", ends[host])
            ip("-n", name, "link", "set", ends[host], "up")
            ip("-n", name, "link", "set", "lo", "up")
        yield names
    finally:
        for name in names.values():
            pids = subprocess.run(["ip", "netns", "pids", name], capture_output=True, text=True).stdout.split()
            for pid in pids:
                subprocess.run(["kill", "-9", pid], stderr=subprocess.DEVNULL)
            subprocess.run(["ip", "netns", "del", name], capture_output=True)


@pytest.fixture
def folders():
    """The folder in which the commands of a host are given; pytest's own are closed to nobody."""
    whole = Path(tempfile.mkdtemp(prefix="deploy"))
    whole.chmod(0o755)
    paths = {host: whole / host for host in ADDRESSES}
    for host, folder in paths.items():
        folder.mkdir()
        shutil.chown(folder, USERS[host][1])
    yield paths
    shutil.rmtree(whole, ignore_errors=True)


def run(who: str, text: str, names: dict[str, str], folders: dict[str, Path]) -> str:
    host, user = USERS[who]
    programs = [
        os.path.dirname(sys.executable),
        *map(str, Path("/usr/lib/postgresql").glob("*/bin")),
        os.environ["PATH"],
    ]
    env = {"PATH": os.pathsep.join(programs), "HOME": str(folders[host]), "PYTHONPATH": str(ROOT), "LANG": "C.UTF-8"}
    tomosim = f'tomosim() {{ "{sys.executable}" -m tomosim "$@"; }}\n'
    shell = ["bash", "-euo", "pipefail", "-c", tomosim + text]
    with open(folders[host] / "output", "ab+") as output:
        begin = output.tell()
        done = subprocess.run(
            ["ip", "netns", "exec", names[host], "setpriv", f"--reuid={user}", "--clear-groups", *shell],
            cwd=folders[host],
            env=env,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            timeout=PATIENCE_SECONDS,
        )
        output.seek(begin)
        said = output.read().decode()
    logs = "".join(f"\n{p.name}: {p.read_text()[-2000:]}" for p in folders[host].rglob("*.log"))
    assert done.returncode == 0, f"on {host}:\n{text}\n{said}{logs if done.returncode else ''}"
    return said


@pytest.mark.sweep
@pytest.mark.needs_postgresql
@pytest.mark.needs_redis
def test_the_page_line_by_line(hosts, folders):
    for program in ("redis-server", "openssl", "curl"):
        need(program, program)
    said = []
    for number, (host, text) in enumerate(BLOCKS):
        if number == 2:  # scp
            shutil.copytree(folders["storage"] / "tomosim" / "secrets", folders["compute"] / "secrets")
        said.append(run(host, text, hosts, folders))
    assert "can be used" in said[2]
    assert '"status":"ok"' in said[3].replace(" ", "")
    assert (folders["compute"] / "case" / "tomosynthesis.dcm").stat().st_size > 0
    # What was restored is what was there: the case is in the list, and its files come from the bucket.
    shutil.rmtree(folders["compute"] / "cache")
    list_cases = (
        'curl --silent --fail -H "Authorization: Bearer $(cat secrets/admin_key)" http://10.77.0.2:8080/v1/simulations'
    )
    assert '"state":"succeeded"' in run("compute", list_cases, hosts, folders)
    assert "would remove 0 stages" in said[-1]
