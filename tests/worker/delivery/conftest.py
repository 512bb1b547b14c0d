"""Destinations of all kinds on loopback: dcmtk's storescp, Orthanc, and peers that misbehave on request."""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import httpx
import numpy as np
import pytest
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import (
    BreastTomosynthesisImageStorage,
    DigitalMammographyXRayImageStorageForProcessing,
    ExplicitVRLittleEndian,
)

from tomosim_contract.destination import Destination
from worker.delivery.sender import Sender
from worker.records.database import connect
from worker.records.deliveries import Deliveries
from worker.records.delivery_tables import Item, Request
from worker.records.destinations import Destinations
from worker.storage import open_store

MG = str(DigitalMammographyXRayImageStorageForProcessing)
TOMO = str(BreastTomosynthesisImageStorage)
PATIENCE_SECONDS = 30
ORTHANC_PLUGIN = Path("/usr/share/orthanc/plugins/libOrthancDicomWeb.so")


def wait_for(condition, what="it"):
    deadline = time.monotonic() + PATIENCE_SECONDS
    while not (found := condition()):
        assert time.monotonic() < deadline, f"{what} did not happen"
        time.sleep(0.02)
    return found


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def write_dicom(path, number=1, sop_class=MG, rows=8, columns=16, frames=1, study="2.25.7", compress=None, seed=0):
    """A small object that archives take. Returns its pixels."""
    pixels = np.random.default_rng(1000 * seed + number).integers(0, 4096, (frames, rows, columns), dtype=np.uint16)
    dataset = Dataset()
    dataset.SOPClassUID = sop_class
    dataset.SOPInstanceUID = f"2.25.{10**20 + 1000 * seed + number}"
    dataset.StudyInstanceUID = study
    dataset.SeriesInstanceUID = f"{study}.{1 if sop_class == MG else 2}"
    dataset.PatientID = "SIM-TEST"
    dataset.PatientName = "SYNTHETIC^TEST"
    dataset.StudyDate, dataset.StudyTime = "20260101", "120000"
    dataset.AccessionNumber = dataset.StudyID = dataset.ReferringPhysicianName = ""
    dataset.PatientBirthDate, dataset.PatientSex = "19760101", "F"
    dataset.Modality = "MG"
    dataset.SeriesNumber, dataset.InstanceNumber = 1, number
    dataset.SamplesPerPixel, dataset.PhotometricInterpretation = 1, "MONOCHROME2"
    dataset.Rows, dataset.Columns = rows, columns
    dataset.BitsAllocated, dataset.BitsStored, dataset.HighBit, dataset.PixelRepresentation = 16, 12, 11, 0
    if frames > 1:
        dataset.NumberOfFrames = frames
    dataset.PixelData = pixels.tobytes()
    dataset["PixelData"].VR = "OW"
    dataset.file_meta = FileMetaDataset()
    dataset.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    if compress:
        dataset.compress(compress, generate_instance_uid=False)
    dataset.save_as(path, enforce_file_format=True)
    return pixels


class Room:
    """A database, a store with a case, and whoever delivers it."""

    def __init__(self, settings, folder):
        """settings: their database has all tables."""
        self.settings = settings
        self.folder = folder
        self.engine = connect(settings.resolved_database_url)
        self.deliveries = Deliveries(self.engine, settings.lease_seconds)
        self.destinations = Destinations(self.engine)
        self.store = open_store(settings)
        self.stopping = threading.Event()
        self.sender = Sender("test", settings, self.deliveries, self.store, self.stopping)
        self.pixels = {}

    def file(self, name, **content):
        """A file of the case, in the store."""
        path = self.folder / "made.dcm"
        self.pixels[name] = write_dicom(path, **content)
        ref = self.store.add(path)
        return Item("5" * 32, name, ref.sha256, ref.size)

    def case(self, count=3, **content):
        """So many projections and a volume."""
        views = [self.file(f"projections/{n:04d}.dcm", number=n, **content) for n in range(1, count + 1)]
        return [*views, self.file("volume.dcm", number=count + 1, sop_class=TOMO, frames=2, **content)]

    def destination(self, port, name="peer", limits=None, **more):
        quick = {"backoff_seconds": 0.1, "attempts": 3, "connect_seconds": 5.0, "negotiate_seconds": 5.0}
        definition = {"name": name, "host": "127.0.0.1", "port": port, "called_aet": "PEER", **more}
        return self.destinations.create(
            Destination.model_validate({**definition, "limits": {**quick, **(limits or {})}})
        )

    def queue(self, destination, items):
        return self.deliveries.create(Request(destination.id, items)).id

    def run(self, identifier, until_final=True):
        """Attempts until the end, without waiting for the time between them."""
        while True:
            self.sender.run(identifier)
            row = self.deliveries.get(identifier)
            if row.is_final or not until_final:
                return row
            self.due(identifier)

    def due(self, identifier):
        from worker.records.delivery_tables import deliveries

        with self.engine.begin() as connection:
            connection.execute(deliveries.update().where(deliveries.c.id == identifier).values(not_before=None))

    def deliver(self, port, items, **destination):
        """Sends items to a new destination; the delivery in the end."""
        return self.run(self.queue(self.destination(port, **destination), items))

    def states(self, identifier):
        return [i.state for i in self.deliveries.instances(identifier)]

    def codes(self, identifier):
        return [i.code for i in self.deliveries.instances(identifier)]


@pytest.fixture
def make_room(make_settings, tmp_path, sqlite_template):
    made = []

    def make(**options):
        settings = make_settings(**options)
        if not made and not settings.database_url:
            settings.data_folder.mkdir(exist_ok=True)
            shutil.copyfile(sqlite_template, settings.data_folder / "tomosim.db")
        made.append(Room(settings, tmp_path))
        return made[-1]

    yield make
    for room in made:
        room.engine.dispose()


@pytest.fixture
def room(make_room):
    return make_room()


@contextmanager
def program(command, log, ready, env=None):
    """A program that is ended in the end, by its process."""
    with open(log, "ab") as output:
        process = subprocess.Popen(
            command, stdout=output, stderr=subprocess.STDOUT, env=env, cwd=log.parent, start_new_session=True
        )
    try:

        def is_ready():
            assert process.poll() is None, log.read_text(errors="replace")
            return ready()

        wait_for(is_ready, f"the start of {command[0]}")
        yield process
    finally:
        if process.poll() is None:
            os.kill(process.pid, signal.SIGCONT)
            process.terminate()
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def listens(port):
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


class StoreScp:
    """dcmtk's storescp: where it listens, and what it stored."""

    def __init__(self, port, folder, process, log):
        self.port, self.folder, self.process, self.log = port, folder, process, log

    def stored(self):
        return sorted(p.name for p in self.folder.iterdir())


@pytest.fixture
def storescp(tmp_path):
    """Starts storescp with the given options; skipped where dcmtk is not installed."""
    # Not pynetdicom's command of the same name, which an activated environment puts first.
    folders = [f for f in os.environ["PATH"].split(os.pathsep) if Path(f) != Path(sys.prefix, "bin")]
    found = shutil.which("storescp", path=os.pathsep.join(folders))
    if not found:
        pytest.skip("needs dcmtk's storescp: the Debian package dcmtk")
    running = []

    def start(*options, port=None):
        port = port or free_port()
        number = len(running)
        folder = tmp_path / f"storescp{number}"
        folder.mkdir(exist_ok=True)
        log = tmp_path / f"storescp{number}.log"
        # Uncompressed transfer syntaxes alone, unless told otherwise.
        classes = [] if "-xf" in options else ["-pm"]
        command = [found, "-v", "-aet", "PEER", "-od", str(folder), *classes, *options, str(port)]
        context = program(command, log, lambda: listens(port))
        running.append(context)
        return StoreScp(port, folder, context.__enter__(), log)

    yield start
    for context in running:
        context.__exit__(None, None, None)


class Orthanc:
    """A running Orthanc: DICOM port, and its REST interface."""

    def __init__(self, port, url):
        self.port = port
        self.http = httpx.Client(base_url=url, timeout=60, headers={"Accept-Encoding": "identity"})

    def instances(self):
        return self.http.get("/instances").json()

    def uids(self):
        return sorted(
            self.http.get(f"/instances/{i}/simplified-tags").json()["SOPInstanceUID"] for i in self.instances()
        )


@pytest.fixture
def orthanc(tmp_path):
    """Starts Orthanc with the given settings; skipped where it or its DICOMweb plugin is not installed."""
    if not shutil.which("Orthanc") or not ORTHANC_PLUGIN.exists():
        pytest.skip("needs Orthanc and its plugin: the Debian packages orthanc and orthanc-dicomweb")
    running = []

    def start(**options):
        number = len(running)
        port, http = free_port(), free_port()
        folder = tmp_path / f"orthanc{number}"
        folder.mkdir()
        configuration = {
            "StorageDirectory": str(folder / "db"),
            "IndexDirectory": str(folder / "db"),
            "DicomAet": "PEER",
            "DicomPort": port,
            "HttpPort": http,
            "RemoteAccessAllowed": False,
            "AuthenticationEnabled": False,
            "DicomCheckCalledAet": True,
            "DicomAlwaysAllowStore": True,
            "Plugins": [str(ORTHANC_PLUGIN)],
            **options,
        }
        (folder / "orthanc.json").write_text(json.dumps(configuration))
        found = Orthanc(port, f"http://127.0.0.1:{http}")

        def ready():
            try:
                return found.http.get("/system").is_success and listens(port)
            except httpx.HTTPError:
                return False

        context = program(["Orthanc", str(folder / "orthanc.json")], folder / "log", ready)
        context.__enter__()
        running.append((context, found))
        return found

    yield start
    for context, found in running:
        found.http.close()
        context.__exit__(None, None, None)
