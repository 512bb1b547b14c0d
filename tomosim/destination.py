"""``tomosim destination``, ``tomosim deliver``: archives and workstations of a service, and what is sent to them."""

from __future__ import annotations

import argparse
import os
import sys
import time
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from simcore.core.errors import SimulationError
from simcore.spec import spec_error
from tomosim_contract.destination import Destination
from tomosim_contract.names import FINAL_STATES

if TYPE_CHECKING:
    from tomosim.client import Client

Json = dict[str, Any]

POLL_SECONDS = 0.5
EXIT_FAILED = 4


class NoSuchDestinationError(SimulationError):
    """There is no destination of this name."""

    kind = "user"
    code = "destination-not-found"


def add_commands(commands: Any) -> None:
    """Adds ``destination`` with add, list, echo and remove, and ``deliver``."""
    of_destination = commands.add_parser(
        "destination", help="archives and workstations that cases are sent to"
    ).add_subparsers(title="commands", required=True, metavar="COMMAND")
    p = of_destination.add_parser("add", help="make a destination")
    p.add_argument("name", help="for people and commands")
    p.add_argument("host", help="host name or IP address")
    p.add_argument("port", type=int)
    p.add_argument("called_aet", metavar="AE_TITLE", help="AE title of the peer")
    p.add_argument("--calling-aet", metavar="AE_TITLE", help="our AE title (default TOMOSIM)")
    p.add_argument("--tls", action="store_true", help="over TLS")
    for name, what in (
        ("ca-file", "PEM: who signs the peer's certificate (default: the system's authorities)"),
        ("certificate-file", "PEM: our certificate, where the peer asks for one"),
        ("key-file", "PEM: its private key"),
    ):
        p.add_argument(f"--{name}", metavar="FILE", help=f"{what}; in the service's secrets folder; implies --tls")
    p.add_argument("--no-verify", action="store_true", help="take any certificate of the peer; implies --tls")
    p.add_argument("--bandwidth", type=float, metavar="MB/s", help="sent a second at most (default: no limit)")
    p.add_argument("--associations", type=int, metavar="N", help="open at the same time (default 1)")
    p.add_argument("--maximum-pdu", type=int, metavar="BYTES", help="largest PDU that is sent")
    _service_argument(p)
    p.set_defaults(run=_add)
    p = of_destination.add_parser("list", help="list the destinations")
    _service_argument(p)
    p.set_defaults(run=_list)
    p = of_destination.add_parser("echo", help="test one: association, C-ECHO, which SOP classes it takes")
    p.add_argument("destination", metavar="NAME")
    _service_argument(p)
    p.set_defaults(run=_echo)
    p = of_destination.add_parser("remove", help="forget one; deliveries stay on record")
    p.add_argument("destination", metavar="NAME")
    _service_argument(p)
    p.set_defaults(run=_remove)

    p = commands.add_parser("deliver", help="send a case that succeeded to a destination")
    p.add_argument("case", metavar="ID", help="identifier of the case (with --study: of the study)")
    p.add_argument("destination", metavar="NAME")
    p.add_argument("--study", action="store_true", help="all cases of a study that have succeeded")
    p.add_argument("--files", action="append", metavar="PATTERN", help="only these: tomosynthesis.dcm, 'projections/*'")
    p.add_argument("--wait", action="store_true", help="wait for its end, showing every instance")
    _service_argument(p)
    p.set_defaults(run=_deliver)


def _service_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--url", default=os.environ.get("TOMOSIM_URL", "http://127.0.0.1:8080"), help="the service")


def _add(args: argparse.Namespace) -> None:
    definition: Json = {"name": args.name, "host": args.host, "port": args.port, "called_aet": args.called_aet}
    if args.calling_aet is not None:
        definition["calling_aet"] = args.calling_aet
    files = {n: v for n in ("ca_file", "certificate_file", "key_file") if (v := getattr(args, n)) is not None}
    if args.tls or files or args.no_verify:
        definition["tls"] = {**files, "verify": not args.no_verify}
    limits = {"bandwidth_MBps": args.bandwidth, "associations": args.associations, "maximum_pdu": args.maximum_pdu}
    definition["limits"] = {name: value for name, value in limits.items() if value is not None}
    try:
        destination = Destination.model_validate(definition)
    except ValidationError as error:
        raise spec_error(Destination, error, "destination") from None
    with _client(args) as client:
        print(client.create_destination(destination).id)
    print(f"tomosim: test it with 'tomosim destination echo {args.name}'", file=sys.stderr)


def _list(args: argparse.Namespace) -> None:
    with _client(args) as client:
        for item in client.destinations():
            where = ""
            if isinstance(item, Destination):
                where = f"{item.called_aet}@{item.host}:{item.port}{' TLS' if item.tls else ''}"
            print(f"{item.id}  {item.name:<20}  {where}".rstrip())


def _echo(args: argparse.Namespace) -> int:
    with _client(args) as client:
        answer = client.echo(_identifier(client, args.destination))
    if not answer.reachable:
        print(f"tomosim: {answer.message} ({answer.code})", file=sys.stderr)
        return EXIT_FAILED
    print(f"{args.destination}: {answer.message}, {answer.seconds:.2f} s")
    for name in answer.refused:
        print(f"  refused: {name}")
    return 0


def _remove(args: argparse.Namespace) -> None:
    with _client(args) as client:
        client.delete_destination(_identifier(client, args.destination))


def _deliver(args: argparse.Namespace) -> int:
    case = {"study_id" if args.study else "simulation_id": args.case}
    with _client(args) as client:
        delivery = client.deliver(args.destination, files=args.files or (), **case)
        print(f"{client.url}{delivery.links['self']}", flush=True)
        if not args.wait:
            return 0
        message = ""
        while delivery.state not in FINAL_STATES:
            if delivery.message not in ("", message):
                message = delivery.message
                done = f"{delivery.instances_stored} of {delivery.instances_total}"
                print(f"{done}: {message}", file=sys.stderr, flush=True)
            time.sleep(POLL_SECONDS)
            delivery = client.delivery(delivery.id)
    if delivery.state != "succeeded":
        why = delivery.error.message if delivery.error else f"the delivery was {delivery.state}"
        print(f"tomosim: {why}", file=sys.stderr)
        return EXIT_FAILED
    print(f"{delivery.instances_stored} instances, {delivery.bytes_stored / 1e6:.0f} MB stored", file=sys.stderr)
    return 0


def _client(args: argparse.Namespace) -> Client:
    from tomosim.client import Client

    return Client(args.url)


def _identifier(client: Client, name: str) -> str:
    """The identifier of a destination by its name (or itself). raises: NoSuchDestinationError"""
    items = client.destinations()
    for item in items:
        if name in (item.name, item.id):
            return item.id
    known = ", ".join(item.name for item in items) or "none"
    raise NoSuchDestinationError(f"there is no destination {name!r}; there are: {known}")
