"""The command line. Standard output carries results, standard error progress and messages.

Exit codes: 0 done; 2 the command or the specification is wrong; 3 the simulation failed; 4 the system or the service
failed (running again may help); 130 interrupted.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from simcore import __version__, missing
from simcore.core.errors import ExportError, SimulationError, SpecError
from simcore.phantom.upload.tissue_maps import BUILT_IN
from simcore.spec import SimulationSpec
from tomosim import destination, keys, operator, studies

EXIT_CODES = {"user": 2, "simulation": 3, "system": 4}
DEFAULT_DATA = Path("data")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command; returns its exit code."""
    args = _parser().parse_args(arguments)
    try:
        return int(args.run(args) or 0)
    except SimulationError as error:
        print(f"tomosim: {error}", file=sys.stderr)
        return EXIT_CODES[error.kind]
    except ImportError as error:
        if (reason := missing.explain(error)) is None:
            raise
        print(f"tomosim: {reason}", file=sys.stderr)
        return EXIT_CODES["user"]
    except BrokenPipeError:  # the reader of a pipe is gone: `tomosim presets | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        print("tomosim: interrupted; finished stages are kept, run the same command to go on", file=sys.stderr)
        return 130
    except MemoryError:
        print("tomosim: out of memory: use larger voxels, fewer views or thicker slices", file=sys.stderr)
        return EXIT_CODES["system"]


class _Parser(argparse.ArgumentParser):
    """Knows ``--axes -z,+y,+x``: argparse takes whatever begins with a minus for an option."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        joined: list[str] = []
        for argument in sys.argv[1:] if args is None else args:
            if joined[-1:] == ["--axes"] and re.match("-[xyz]", argument):
                joined[-1] += f"={argument}"
            else:
                joined.append(argument)
        return super().parse_known_args(joined, namespace)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="tomosim", description="Simulation of digital breast tomosynthesis, from a specification to DICOM."
    )
    parser.add_argument("--version", action="version", version=f"tomosim {__version__}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    p = commands.add_parser("simulate", help="run one case here, without a service")
    _spec_argument(p)
    p.add_argument("--out", type=Path, required=True, metavar="DIR", help="where the files of the case go")
    _data_argument(p)
    p.add_argument("--threads", type=_positive, metavar="N", help="threads of the computation (default: all cores)")
    p.set_defaults(run=_simulate)

    p = commands.add_parser("serve", help="start the service: broker, worker and API in one process tree")
    p.add_argument("--host", help="address to listen on (default 127.0.0.1)")
    p.add_argument("--port", type=_port, help="port to listen on (default 8080)")
    p.add_argument("--data", type=Path, metavar="DIR", help="folder of database, queue and store (default ./data)")
    p.set_defaults(run=_serve)

    p = commands.add_parser("submit", help="send one case to a service")
    _spec_argument(p)
    p.add_argument("--url", default=os.environ.get("TOMOSIM_URL", "http://127.0.0.1:8080"), help="the service")
    p.add_argument("--wait", action="store_true", help="wait for the result, showing progress")
    p.add_argument("--out", type=Path, metavar="DIR", help="download the files of the case there (implies --wait)")
    p.set_defaults(run=_submit)

    p = commands.add_parser("presets", help="list the presets, or print the specification of one to edit")
    p.add_argument("name", nargs="?", help="a preset")
    p.set_defaults(run=_presets)

    p = commands.add_parser("estimate", help="memory, disk and time a case will need")
    _spec_argument(p)
    p.set_defaults(run=_estimate)

    p = commands.add_parser("analyse", help="quality measures of a case: texture, contrast, skin line, clipping")
    p.add_argument("case", type=Path, metavar="DIR", help="a folder that 'tomosim simulate --out' wrote")
    p.set_defaults(run=_analyse)

    _phantom_parser(commands)
    studies.add_commands(commands)
    keys.add_commands(commands)
    destination.add_commands(commands)
    operator.add_commands(commands)

    p = commands.add_parser("warm-up", help="compile all kernels once, so that the first case is as fast as the next")
    p.add_argument("--processes", type=_positive, metavar="N", help="that compile at the same time (as many as cores)")
    p.set_defaults(run=_warm_up)
    return parser


def _phantom_parser(commands: Any) -> None:
    of_phantom = commands.add_parser("phantom", help="label volumes of your own").add_subparsers(
        title="commands", required=True, metavar="COMMAND"
    )
    p = of_phantom.add_parser(
        "add",
        help="copy a label volume into the store and print the specification that uses it",
        description="Reads NRRD, MetaImage (.mha, .mhd), NIfTI, and with --header raw voxels (.raw, .raw.gz). VICTRE's "
        "labels are known.",
    )
    p.add_argument("file", type=Path, metavar="FILE", help="the label volume")
    p.add_argument(
        "--tissue-map",
        metavar="NAME|FILE|JSON",
        help=f"{', '.join(BUILT_IN)}, or {{value: tissue}} as a JSON file or as it stands; not given: by the names of "
        "the segments in the file (3D Slicer), or victre",
    )
    p.add_argument(
        "--confirm-tissues", action="store_true", help="the tissues are right, though hardly those of a breast"
    )
    p.add_argument("--header", type=Path, metavar="JSON", help="header of raw voxels: shape, spacing_mm, dtype, axes")
    p.add_argument("--axes", type=_axes, metavar="A,B,C", help="where the array axes lead, slowest first: +z,+y,+x")
    p.add_argument("--spacing-mm", type=_edges, metavar="A,B,C", help="voxel edges along the array axes, slowest first")
    p.add_argument("--compressed", action="store_true", help="it is already compressed along z")
    p.add_argument("--confirm-size", action="store_true", help="take a breast below 20 ml or above 5 l")
    _data_argument(p)
    p.set_defaults(run=_add_phantom)
    p = of_phantom.add_parser("list", help="list the label volumes in the store")
    _data_argument(p)
    p.set_defaults(run=_list_phantoms)


def _spec_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("spec", metavar="SPEC.json", help="a specification, or - for standard input")


def _data_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--data",
        type=Path,
        metavar="DIR",
        default=Path(os.environ.get("TOMOSIM_DATA_FOLDER", DEFAULT_DATA)),
        help="folder of the stage store (default ./data, or TOMOSIM_DATA_FOLDER)",
    )


def _positive(text: str) -> int:
    try:
        number = int(text)
    except ValueError:
        number = 0
    if number < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least 1")
    return number


def _port(text: str) -> int:
    number = _positive(text)
    if number > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not a port: 1 to 65535")
    return number


def _axes(text: str) -> list[str]:
    return text.split(",")


def _edges(text: str) -> list[float]:
    try:
        return [float(edge) for edge in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not three numbers such as 0.2,0.2,0.2") from None


def _read_spec(name: str) -> SimulationSpec:
    try:
        text = sys.stdin.buffer.read() if name == "-" else Path(name).read_bytes()
    except OSError as error:
        raise SpecError(
            f"the specification {name} cannot be read: {error.strerror}; "
            "'tomosim presets NAME' prints one to begin with",
            code="specification-not-readable",
        ) from error
    return SimulationSpec.parse(text)


def _simulate(args: argparse.Namespace) -> None:
    from simcore import estimate
    from simcore.store.store import Store
    from tomosim.console import StageDisplay

    spec = _read_spec(args.spec)
    for remark in estimate.check(spec).remarks:
        print(f"tomosim: {remark}", file=sys.stderr)
    from simcore import pipeline  # the kernels take a second to load: a wrong specification is told before

    _compile_if_cold(args.threads)
    _set_threads(args.threads)
    store = Store(args.data / "store")
    store.sweep_temporary()
    with StageDisplay() as display:
        result = pipeline.run(spec, store, display)
    result.write(args.out)
    _summary(result.manifest, args.out)


def _compile_if_cold(threads: int | None) -> None:
    """The first case of an installation would compile with one processor, kernel after kernel, what several can."""
    from simcore import warmup

    processes = min(threads or warmup.cores(), warmup.cores())
    if processes > 1 and warmup.is_cold():
        print(f"tomosim: kernels are compiled, once, by {processes} processes", file=sys.stderr, flush=True)
        warmup.compile_all(processes, _tell_compiled, warmup.OF_MOST_CASES)


def _set_threads(count: int | None) -> None:
    import numba

    if count is not None:
        available = numba.config.NUMBA_NUM_THREADS
        if count > available:
            print(f"tomosim: --threads {count}: {available} cores are there, {available} threads used", file=sys.stderr)
        numba.set_num_threads(min(count, available))


def _serve(args: argparse.Namespace) -> int:
    from worker.serve.embedded import serve
    from worker.settings import Settings

    options = {"host": args.host, "port": args.port, "data_folder": args.data}
    return serve(Settings.load(**{k: v for k, v in options.items() if v is not None}))


def _submit(args: argparse.Namespace) -> int:
    from tomosim.client import Client
    from tomosim.console import StageDisplay

    spec = _read_spec(args.spec)
    with Client(args.url) as client:
        case = client.submit(spec)
        print(f"{client.url}{case.links['self']}", flush=True)
        for remark in case.estimate.remarks:
            print(f"tomosim: {remark}", file=sys.stderr)
        if not (args.wait or args.out):
            return 0
        try:
            with StageDisplay() as display:
                case = client.wait(case.id, display.show_event)
        except KeyboardInterrupt:
            print(f"tomosim: the case goes on; cancel it with POST .../{case.id}/cancel", file=sys.stderr)
            raise
        if case.state != "succeeded":
            print(f"tomosim: {case.error.message if case.error else f'the case was {case.state}'}", file=sys.stderr)
            return EXIT_CODES[case.error.kind if case.error else "system"]
        if args.out:
            for file in client.download(case.id, args.out):
                print(f"{file.name}  {'was there' if file.kept else f'{file.size} bytes'}", file=sys.stderr)
            print(f"files in {args.out}", file=sys.stderr)
    return 0


def _summary(manifest: dict[str, Any], out: Path) -> None:
    results = manifest["results"]
    computed = manifest["computed_stages"]
    force = f"force {results['force_N']:.1f} N, " if "force_N" in results else ""
    print(
        f"{out}: {force}thickness {results['thickness_mm']:.1f} mm, "
        f"volume {results['volume_ml']:.1f} ml{_compressed_volume(results)}, "
        f"glandularity {100 * results['glandularity']:.1f} %; "
        f"{computed} of {len(manifest['stages'])} stages computed, {manifest['seconds']:.1f} s"
    )
    for caution in results.get("cautions", ()):
        print(f"tomosim: {caution}", file=sys.stderr)


def _compressed_volume(results: dict[str, Any]) -> str:
    """What is left of the volume between the plates and beyond; nothing for a phantom that was compressed elsewhere."""
    return f" ({results['volume_after_ml']:.1f} ml compressed)" if "volume_after_ml" in results else ""


def _presets(args: argparse.Namespace) -> None:
    from simcore import presets

    if args.name:
        print(presets.get(args.name).model_dump_json(indent=2))
        return
    width = max(map(len, presets.names()))
    for name in presets.names():
        print(f"{name:<{width}}  {presets.describe(name)}")


def _estimate(args: argparse.Namespace) -> None:
    from simcore import estimate

    print(estimate.check(_read_spec(args.spec)).model_dump_json(indent=2))


def _analyse(args: argparse.Namespace) -> None:
    import json

    from simcore import quality
    from tomosim.console import StageDisplay

    with StageDisplay() as display:
        analysis = quality.analyse(args.case, lambda fraction, message: display("analyse", fraction, message))
        display("analyse", 1.0, "done")
    target = args.case / "analysis.json"
    try:
        target.write_text(json.dumps(analysis, indent=1) + "\n")
    except OSError as error:
        raise ExportError(f"{target} cannot be written: {error.strerror}") from error
    print(quality.table(analysis))


def _add_phantom(args: argparse.Namespace) -> None:
    from simcore.phantom.upload import registry, review
    from simcore.phantom.upload.reading import Reading
    from simcore.store.store import Store

    fields: dict[str, Any] = {name: getattr(args, name) for name in ("compressed", "confirm_size", "confirm_tissues")}
    if args.tissue_map is not None:
        fields["tissues"] = _tissue_map(args.tissue_map)
    if args.header is not None:
        fields["raw"] = _read_json(args.header, "header")
    fields |= {name: value for name in ("axes", "spacing_mm") if (value := getattr(args, name)) is not None}
    upload = registry.add_file(Store(args.data / "store"), args.file, Reading.parse(json.dumps(fields)))
    print(review.table(upload.contents), file=sys.stderr)
    for remark in upload.remarks:
        print(f"tomosim: {remark}", file=sys.stderr)
    print(f"tomosim: {upload.sha256}, {upload.size} bytes in the store", file=sys.stderr)
    print(json.dumps({"phantom": upload.phantom}, indent=2))


def _tissue_map(text: str) -> Any:
    """The name of a known map, or one as a JSON file or as JSON."""
    if text in BUILT_IN:
        return text
    if not text.lstrip().startswith("{"):
        return _read_json(Path(text), f"tissue map (known ones: {', '.join(BUILT_IN)})")
    try:
        return json.loads(text)
    except ValueError as error:
        raise SpecError(f"the tissue map {text!r} is not JSON: {error}", code="file-not-readable") from error


def _list_phantoms(args: argparse.Namespace) -> None:
    from simcore.phantom.upload import registry
    from simcore.store.store import Store

    for upload in registry.uploads(Store(args.data / "store")):
        shape = " x ".join(map(str, upload.phantom["shape"]))
        print(f"{upload.sha256}  {upload.format:<9}  {shape}  {upload.name}")


def _read_json(path: Path, what: str) -> Any:
    try:
        return json.loads(path.read_bytes())
    except OSError as error:
        raise SpecError(f"the {what} {path} cannot be read: {error.strerror}", code="file-not-readable") from error
    except ValueError as error:
        raise SpecError(f"the {what} {path} is not JSON: {error}", code="file-not-readable") from error


def _warm_up(args: argparse.Namespace) -> None:
    from simcore import warmup

    warmup.compile_all(args.processes or warmup.cores(), _tell_compiled)


def _tell_compiled(part: str, fraction: float) -> None:
    print(f"tomosim: compiled {part}, {fraction:.0%}", file=sys.stderr, flush=True)
