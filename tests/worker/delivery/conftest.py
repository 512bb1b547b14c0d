"""Destinations of all kinds on loopback: dcmtk's storescp, Orthanc, and peers that misbehave on request."""

import shutil
import sys
import threading
from contextlib import ExitStack
from itertools import count
from pathlib import Path

import pytest

from tests.support.dicom_files import TOMO, write_dicom
from tests.support.orthanc import running
from tests.support.ports import free_port, listens
from tests.support.servers import program
from tests.support.services import need, path_without
from tomosim_contract.destination import Destination
from worker.delivery.sender import Sender
from worker.records.database import connect
from worker.records.deliveries import Deliveries
from worker.records.delivery_tables import Item, Request
from worker.records.destinations import Destinations
from worker.storage import open_store


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
    storescp = need("storescp", "dcmtk", path_without(Path(sys.prefix, "bin")))
    with ExitStack() as stack:
        numbers = count()

        def start(*options, port=None):
            port = port or free_port()
            folder = tmp_path / f"storescp{next(numbers)}"
            folder.mkdir()
            log = folder.with_suffix(".log")
            # Uncompressed transfer syntaxes alone, unless told otherwise.
            classes = [] if "-xf" in options else ["-pm"]
            command = [storescp, "-v", "-aet", "PEER", "-od", str(folder), *classes, *options, str(port)]
            process = stack.enter_context(program(command, lambda: listens(port), log, cwd=tmp_path))
            return StoreScp(port, folder, process, log)

        yield start


@pytest.fixture
def orthanc(tmp_path):
    """Starts Orthanc with the given settings; skipped where it or its DICOMweb plugin is not installed."""
    with ExitStack() as stack:
        numbers = count()

        def start(**options):
            return stack.enter_context(running(tmp_path / f"orthanc{next(numbers)}", **options))

        yield start
