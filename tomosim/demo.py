"""``make demo``: the paper's everyday case through the whole service, once, on this machine.

Starts ``tomosim serve``, posts the cup C / 20 % / 15 views / 40 degrees case over HTTP, shows its progress, downloads
the files, says where to look, and stops the service in order.
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import time
from pathlib import Path

import httpx

from simcore import children, presets
from simcore.core.errors import SimulationError
from tomosim.client import Client, ServiceError
from tomosim.console import StageDisplay

READY_SECONDS = 60


def main() -> int:
    parser = argparse.ArgumentParser(prog="make demo", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--data", type=Path, default=Path("data"))
    parser.add_argument("--port", type=int, default=8080)
    parser.add_argument("--preset", default="paper-cup-c-20")
    args = parser.parse_args()
    url = f"http://127.0.0.1:{args.port}"
    command = children.command("tomosim", "serve", "--data", str(args.data), "--port", str(args.port))
    service = subprocess.Popen(command, env=children.environment(), start_new_session=True)
    try:
        _wait_until_ready(service, url)
        case_id = _run_case(url, args.preset, args.out)
        _say_where_to_look(url, case_id, args.out)
        return 0
    except SimulationError as error:
        print(f"demo: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    finally:
        _stop(service)


def _wait_until_ready(service: subprocess.Popen[bytes], url: str) -> None:
    deadline = time.monotonic() + READY_SECONDS
    while time.monotonic() < deadline:
        if service.poll() is not None:
            raise ServiceError("the service did not start; its message stands above")
        try:
            if httpx.get(f"{url}/readyz", timeout=2).is_success:
                return
        except httpx.HTTPError:
            pass
        time.sleep(0.2)
    raise ServiceError(f"the service was not ready within {READY_SECONDS} s")


def _run_case(url: str, preset: str, out: Path) -> str:
    with Client(url) as client:
        case = client.submit(presets.get(preset))
        print(f"posted {preset} to {url}{case.links['self']}", flush=True)
        with StageDisplay() as display:
            case = client.wait(case.id, display.show_event)
        if case.state != "succeeded":
            raise ServiceError(f"the case was {case.state}: {case.error.message if case.error else ''}")
        size = sum(file.size for file in client.download(case.id, out))
        print(f"{size / 1e6:.0f} MB downloaded to {out}/", flush=True)
        return case.id


def _say_where_to_look(url: str, case_id: str, out: Path) -> None:
    print(
        f"""
Look at
  {out}/preview/              pictures: phantom, compressed phantom, projections, volume
  {out}/projections/*.dcm     one DICOM file a view, and projections.dcm with all views
  {out}/tomosynthesis.dcm     the reconstructed volume; labels.dcm the tissue of every voxel
  {out}/manifest.json         digests, seconds and memory of each stage, force, thickness, volumes
Start the service again with `make serve`, then
  {url}/                      all cases
  {url}/v1/simulations/{case_id}
  {url}/docs                  the API
""",
        flush=True,
    )


def _stop(service: subprocess.Popen[bytes]) -> None:
    if service.poll() is None:
        service.send_signal(signal.SIGINT)
        try:
            service.wait(30)
        except subprocess.TimeoutExpired:
            service.kill()
            service.wait()


if __name__ == "__main__":
    sys.exit(main())
