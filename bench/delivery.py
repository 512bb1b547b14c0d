"""Delivery to Orthanc against dcmtk's storescu: the same files, the same archive, in turns.

    python -m bench.delivery [--rounds 3] [--rows 2304 --columns 1920 --slices 60 --views 15]

A volume and its projections of full size (664 MB of noise, which nothing can compress) go to an Orthanc on this
machine, in memory, emptied before every transfer. Ours is a whole delivery: row, files of the store, C-ECHO, C-STORE,
the status of every instance written to the database. storescu sends the same files on one association. The last line:
{"MBps", "peer_MBps", "ratio", "peak_MB"}: medians, and the peak memory of the process that delivers.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import httpx
import numpy as np
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import (
    BreastTomosynthesisImageStorage,
    DigitalMammographyXRayImageStorageForProcessing,
    ExplicitVRLittleEndian,
    generate_uid,
)

from tests.support.orthanc import running

TITLE = "ORTHANC"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.delivery", description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--rows", type=int, default=2304)
    parser.add_argument("--columns", type=int, default=1920)
    parser.add_argument("--slices", type=int, default=60)
    parser.add_argument("--views", type=int, default=15)
    parser.add_argument("--deliver", nargs=2, metavar=("FOLDER", "PORT"), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.deliver:
        _deliver(Path(args.deliver[0]), int(args.deliver[1]))
        return
    for program in ("Orthanc", "storescu"):
        if not shutil.which(program):
            sys.exit(f"bench.delivery needs {program}: the Debian packages orthanc and dcmtk")
    with tempfile.TemporaryDirectory(prefix="bench-delivery", dir=_fast_folder()) as folder:
        _compare(Path(folder), args)


def _fast_folder() -> str | None:
    """Memory, where there is some for the files and the archive: a disk would be what is measured."""
    memory = Path("/dev/shm")
    return str(memory) if memory.exists() and shutil.disk_usage(memory).free > 4e9 else None


def _compare(folder: Path, args: argparse.Namespace) -> None:
    files = folder / "files"
    files.mkdir()
    _write(files / "tomosynthesis.dcm", BreastTomosynthesisImageStorage, args, args.slices)
    for view in range(args.views):
        _write(files / f"{view + 1:04d}.dcm", DigitalMammographyXRayImageStorageForProcessing, args, 1)
    megabytes = sum(p.stat().st_size for p in files.iterdir()) / 1e6
    print(f"{args.views + 1} files, {megabytes:.0f} MB", flush=True)
    seconds: dict[str, list[float]] = {"ours": [], "storescu": []}
    peaks = []
    # Synchronized, it waits for the disk after every file, and whoever sends has nothing to do with that time.
    with running(folder / "orthanc", plugin=False, DicomAet=TITLE, SyncStorageArea=False) as archive:
        port, http = archive.port, archive.http
        for number in range(args.rounds + 1):
            _empty(http)
            ours, peak = _ours(files, port)
            _check(http, args.views + 1)
            _empty(http)
            theirs = _storescu(files, port)
            _check(http, args.views + 1)
            note = "warm-up" if number == 0 else f"round {number}"
            print(f"{note}: ours {megabytes / ours:.0f} MB/s, {peak:.0f} MB; storescu {megabytes / theirs:.0f} MB/s")
            sys.stdout.flush()
            if number:
                seconds["ours"].append(ours)
                seconds["storescu"].append(theirs)
                peaks.append(peak)
    rates = {name: megabytes / statistics.median(values) for name, values in seconds.items()}
    result = {
        "MBps": round(rates["ours"], 1),
        "peer_MBps": round(rates["storescu"], 1),
        "ratio": round(rates["ours"] / rates["storescu"], 3),
        "peak_MB": round(statistics.median(peaks), 1),
    }
    print(json.dumps(result))


def _write(path: Path, sop_class: str, args: argparse.Namespace, frames: int) -> None:
    rng = np.random.default_rng(frames)
    dataset = Dataset()
    dataset.SOPClassUID = sop_class
    dataset.SOPInstanceUID, dataset.SeriesInstanceUID = generate_uid(), generate_uid()
    dataset.StudyInstanceUID = "2.25.1"
    dataset.PatientID, dataset.PatientName, dataset.Modality = "SIM-BENCH", "SYNTHETIC^BENCH", "MG"
    dataset.Rows, dataset.Columns, dataset.NumberOfFrames = args.rows, args.columns, frames
    dataset.SamplesPerPixel, dataset.PhotometricInterpretation = 1, "MONOCHROME2"
    dataset.BitsAllocated, dataset.BitsStored, dataset.HighBit, dataset.PixelRepresentation = 16, 14, 13, 0
    dataset.add_new("PixelData", "OW", rng.bytes(2 * args.rows * args.columns * frames))
    dataset.file_meta = FileMetaDataset()
    dataset.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    dataset.save_as(path, enforce_file_format=True)


def _ours(files: Path, port: int) -> tuple[float, float]:
    """Seconds of a delivery and peak memory of its process, MB."""
    command = [sys.executable, "-m", "bench.delivery", "--deliver", str(files), str(port)]
    answer = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout.split()
    return float(answer[-2]), float(answer[-1])


def _deliver(files: Path, port: int) -> None:
    """Delivers once and prints the seconds it took and the peak memory of this process, MB."""
    from simcore.store.hashing import file_digest
    from simcore.store.store import Store
    from tomosim_contract.destination import Destination
    from worker.delivery.sender import Sender
    from worker.records import schema
    from worker.records.database import connect
    from worker.records.deliveries import Deliveries
    from worker.records.delivery_tables import Item, Request
    from worker.records.destinations import Destinations
    from worker.settings import Settings

    with tempfile.TemporaryDirectory(prefix="data", dir=files.parent) as folder:
        settings = Settings.load(data_folder=Path(folder))
        engine = connect(settings.resolved_database_url)
        schema.upgrade(engine)
        store = Store(settings.store_folder)
        items = []
        for path in sorted(files.iterdir()):
            sha256 = file_digest(path)
            target = store.root / "objects" / sha256[:2] / sha256
            target.parent.mkdir(parents=True, exist_ok=True)
            os.link(path, target)
            items.append(Item("0" * 32, path.name, sha256, path.stat().st_size))
        destination = Destination(name="orthanc", host="127.0.0.1", port=port, called_aet=TITLE)
        row = Destinations(engine).create(destination)
        deliveries = Deliveries(engine)
        identifier = deliveries.create(Request(row.id, items)).id
        sender = Sender("bench", settings, deliveries, store, threading.Event())
        start = time.perf_counter()
        sender.run(identifier)
        seconds = time.perf_counter() - start
        delivery = deliveries.get(identifier)
        if delivery.state != "succeeded":
            sys.exit(f"{delivery.state}: {delivery.error}")
        # Not getrusage: that counts the memory of whoever started this process, too.
        status = Path("/proc/self/status").read_text().splitlines()
        peak_kB = next(int(line.split()[1]) for line in status if line.startswith("VmHWM"))
        print(seconds, peak_kB * 1024 / 1e6)


def _storescu(files: Path, port: int) -> float:
    # -R: it proposes what the files need; its own list has no tomosynthesis.
    command = ["storescu", "-R", "-aec", TITLE, "127.0.0.1", str(port), "+sd", str(files)]
    start = time.perf_counter()
    subprocess.run(command, check=True)
    return time.perf_counter() - start


def _empty(http: httpx.Client) -> None:
    for patient in http.get("/patients").json():
        http.delete(f"/patients/{patient}").raise_for_status()


def _check(http: httpx.Client, expected: int) -> None:
    count = http.get("/statistics").json()["CountInstances"]
    if count != expected:
        sys.exit(f"Orthanc has {count} instances instead of {expected}")


if __name__ == "__main__":
    main()
