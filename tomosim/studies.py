"""``tomosim study``: families of cases on a service."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simcore.core.errors import SpecError
from simcore.study import StudySpec
from tomosim_contract.names import STATES

if TYPE_CHECKING:
    from tomosim.client import Client
    from tomosim_contract.studies import StudyResource

KINDS = {"dicom": (".dcm",), "preview": (".png",), "mechanics": (".vtu",)}
"""Kinds of files by the ends of their names."""

SOME_FAILED = 3


def add_commands(commands: Any) -> None:
    """Adds the command ``study`` and its commands."""
    of_study = commands.add_parser("study", help="families of cases on a service").add_subparsers(
        title="commands", required=True, metavar="COMMAND"
    )

    p = of_study.add_parser("submit", help="send a study: a base specification and axes")
    _file_argument(p)
    p.add_argument("--wait", action="store_true", help="wait until all cases have ended, showing counts")
    p.add_argument("--out", type=Path, metavar="DIR", help="download all files there (implies --wait)")
    p.set_defaults(run=_submit)
    _url_argument(p)

    p = of_study.add_parser("estimate", help="number of cases, memory, disk and time a study will need")
    _file_argument(p)
    p.set_defaults(run=_estimate)
    _url_argument(p)

    p = of_study.add_parser("example", help="list the examples, or print one to edit")
    p.add_argument("name", nargs="?", choices=sorted(_examples()), help="an example")
    p.set_defaults(run=_example)

    p = of_study.add_parser("list", help="list studies, the newest first")
    p.set_defaults(run=_list)
    _url_argument(p)

    p = _of_one(of_study, "status", "show the state of a study and the counts of its cases")
    p.add_argument("--wait", action="store_true", help="wait until all cases have ended, showing counts")
    p.set_defaults(run=_status)

    p = _of_one(of_study, "cases", "list its cases with their values on the axes")
    p.add_argument("--state", choices=STATES, help="only cases in this state")
    p.add_argument("--csv", action="store_true", help="all cases with their results as CSV")
    p.set_defaults(run=_cases)

    p = _of_one(of_study, "cancel", "stop all cases that have not finished")
    p.set_defaults(run=_cancel)

    p = _of_one(of_study, "retry", "queue the failed cases again")
    p.add_argument("--cancelled", action="store_true", help="the cancelled ones as well")
    p.set_defaults(run=_retry)

    p = _of_one(of_study, "download", "write the files of all cases that have succeeded, one folder a case")
    p.add_argument("--out", type=Path, required=True, metavar="DIR", help="where they go; what is there is kept")
    p.add_argument("--only", choices=KINDS, help="files of this kind alone")
    p.set_defaults(run=_download)

    p = _of_one(of_study, "delete", "forget a study that has ended, and its cases")
    p.set_defaults(run=_delete)


def _of_one(commands: Any, name: str, text: str) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = commands.add_parser(name, help=text)
    parser.add_argument("id", metavar="STUDY", help="identifier of a study, as 'submit' and 'list' print it")
    _url_argument(parser)
    return parser


def _file_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="STUDY.json", help="a study, or - for standard input")


def _url_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--url", default=os.environ.get("TOMOSIM_URL", "http://127.0.0.1:8080"), help="the service")


def _read(name: str) -> StudySpec:
    try:
        text = sys.stdin.buffer.read() if name == "-" else Path(name).read_bytes()
    except OSError as error:
        raise SpecError(f"the study {name} cannot be read: {error.strerror}", code="study-not-readable") from error
    return StudySpec.parse(text)


def _examples() -> dict[str, Path]:
    """Studies that come with the package, by name."""
    return {path.stem: path for path in (Path(__file__).parent / "examples").glob("*.json")}


def _example(args: argparse.Namespace) -> None:
    examples = _examples()
    print(examples[args.name].read_text().rstrip() if args.name else "\n".join(sorted(examples)))


def _client(args: argparse.Namespace) -> Client:
    from tomosim.client import Client

    return Client(args.url)


def _submit(args: argparse.Namespace) -> int:
    study = _read(args.file)
    with _client(args) as client:
        submission = client.submit_study(study)
        print(f"{client.url}{submission.links['self']}", flush=True)
        print(f"tomosim: {submission.cases} cases queued", file=sys.stderr)
        if not (args.wait or args.out):
            return 0
        ended = _wait(client, submission.id)
        if args.out:
            _fetch(client, submission.id, args.out, None)
        return _verdict(ended)


def _estimate(args: argparse.Namespace) -> None:
    study = _read(args.file)
    with _client(args) as client:
        print(client.estimate_study(study).model_dump_json(indent=2))


def _list(args: argparse.Namespace) -> None:
    with _client(args) as client:
        for study in client.studies():
            print(f"{study.id}  {study.state:<10} {study.finished_cases:>5}/{study.cases:<5} {study.name}")


def _status(args: argparse.Namespace) -> int:
    with _client(args) as client:
        study = _wait(client, args.id) if args.wait else client.study(args.id)
        print(_counts(study))
        return _verdict(study) if args.wait else 0


def _cases(args: argparse.Namespace) -> None:
    with _client(args) as client:
        if args.csv:
            sys.stdout.write(client.study_table(args.id))
            return
        for case in client.study_cases(args.id, args.state):
            values = ", ".join(f"{name} = {value}" for name, value in case.coordinates.items())
            error = f"  {case.error.message}" if case.error else ""
            print(f"{case.number:>5}  {case.id}  {case.state:<10} {values}{error}")


def _cancel(args: argparse.Namespace) -> None:
    with _client(args) as client:
        print(_counts(client.cancel_study(args.id)))


def _retry(args: argparse.Namespace) -> None:
    with _client(args) as client:
        print(_counts(client.retry_study(args.id, cancelled=args.cancelled)))


def _download(args: argparse.Namespace) -> None:
    with _client(args) as client:
        _fetch(client, args.id, args.out, args.only)


def _delete(args: argparse.Namespace) -> None:
    with _client(args) as client:
        client.delete_study(args.id)


def _wait(client: Client, identifier: str) -> StudyResource:
    last_line = ""

    def show(study: StudyResource) -> None:
        nonlocal last_line
        if (line := _counts(study)) != last_line:
            last_line = line
            print(line, file=sys.stderr, flush=True)

    try:
        return client.wait_for_study(identifier, show)
    except KeyboardInterrupt:
        print(f"tomosim: the study goes on; stop it with 'tomosim study cancel {identifier}'", file=sys.stderr)
        raise


def _fetch(client: Client, identifier: str, out: Path, only: str | None) -> None:
    ends = KINDS.get(only or "", ("",))
    files = new = 0
    for file in client.download_study(identifier, out, lambda name: name.endswith(ends)):
        files += 1
        new += not file.kept
    print(f"{files} files in {out}, {files - new} of them were there", file=sys.stderr)


def _counts(study: StudyResource) -> str:
    counts = ", ".join(f"{number} {state}" for state, number in study.counts.items() if number)
    return f"{study.state}: {counts}"


def _verdict(study: StudyResource) -> int:
    return 0 if study.state == "succeeded" else SOME_FAILED
