"""Something to ask for: a service that has cases, studies, a phantom, destinations, deliveries and webhooks.

Identifiers that are drawn at random are never those of anything; Schemathesis is told these, and draws them half of the
time. What it deletes is gone for the rest of the run, so there are several of each.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import httpx

from api.http.deps import Services
from tests.support.dicom_files import write_dicom
from tests.support.waiting import wait_for

OF_EACH = 4
PROBABILITY = 0.5

Values = dict[str, list[str]]

PATHS = {
    "^/v1/simulations/": {"identifier": "simulations", "name": "artifacts"},
    "^/v1/studies/": {"identifier": "studies"},
    "^/v1/phantoms/": {"sha256": "phantoms"},
    "^/v1/destinations/": {"identifier": "destinations"},
    "^/v1/deliveries/": {"identifier": "deliveries"},
    "^/v1/webhooks/": {"identifier": "webhooks", "message_id": "messages"},
    "^/v1/presets/": {"name": "presets"},
    "^/dicomweb/studies/": {
        "study": "dicom-studies",
        "series": "dicom-series",
        "instance": "dicom-instances",
        "frames": "frames",
        "where": "places",
    },
}
"""Paths, and the dictionary of values of each of their parameters."""


def make(http: httpx.Client, dicom_cases: list[str]) -> Values:
    """Makes them on a service that carries cases out; the values by dictionary."""
    values: Values = {name: [] for parameters in PATHS.values() for name in parameters.values()}
    values |= {"frames": ["1"], "places": ["7FE00010"], "presets": ["tiny"], "artifacts": ["volume.dcm"]}
    for number in range(OF_EACH):
        values["simulations"].append(_post(http, "/v1/simulations", {"seed": number})["id"])
        axes = [{"kind": "grid", "field": "seed", "values": [number, number + 1]}]
        values["studies"].append(_post(http, "/v1/studies", {"axes": axes})["id"])
        pacs = {"name": f"pacs-{number}", "host": "127.0.0.1", "port": 1, "called_aet": "PACS"}
        values["destinations"].append(_post(http, "/v1/destinations", pacs)["id"])
        hook = _post(http, "/v1/webhooks", {"url": "https://93.184.216.34/hook"})["id"]
        values["webhooks"].append(hook)
        values["messages"].append(_post(http, f"/v1/webhooks/{hook}/test", None)["id"])
    _wait_until_all_have_succeeded(http, values["simulations"])
    reading = {"raw": {"shape": [20, 20, 20], "spacing_mm": [2.0, 2.0, 2.0]}, "tissues": "tomosim"}
    uploaded = http.post(
        "/v1/phantoms",
        params={"reading": json.dumps(reading)},
        content=bytes([1, 2, 1, 1] * 2000),
        headers={"Content-Type": "application/octet-stream"},
    )
    values["phantoms"].append(uploaded.raise_for_status().json()["sha256"])
    for destination, case in zip(values["destinations"], dicom_cases, strict=True):
        values["simulations"].append(case)
        sent = {"destination": destination, "simulation_id": case}
        values["deliveries"].append(_post(http, "/v1/deliveries", sent)["id"])
    for entry in http.get("/dicomweb/instances").raise_for_status().json():
        for name, tag in (("studies", "0020000D"), ("series", "0020000E"), ("instances", "00080018")):
            values[f"dicom-{name}"] += [uid for uid in entry[tag]["Value"] if uid not in values[f"dicom-{name}"]]
    return values


def configuration(values: Values) -> str:
    """What is added to the configuration of Schemathesis (TOML; its strings are those of JSON here)."""
    lines = []
    for name, known in values.items():
        lines += [f"[dictionaries.{name}]", f"values = {json.dumps(known)}", ""]
    for path, parameters in PATHS.items():
        lines += ["[[operations]]", f"include-path-regex = {json.dumps(path)}", "[operations.parameters]"]
        for parameter, name in parameters.items():
            lines.append(f'"path.{parameter}" = {{ dictionary = "{name}", probability = {PROBABILITY} }}')
        lines.append("")
    return "\n".join(lines)


def _post(http: httpx.Client, path: str, body: Any) -> Any:
    return http.post(path, json=body).raise_for_status().json()


def _wait_until_all_have_succeeded(http: httpx.Client, identifiers: list[str]) -> None:
    for identifier in identifiers:
        path = f"/v1/simulations/{identifier}"
        wait_for(lambda path=path: http.get(path).json()["state"] == "succeeded", f"the end of {identifier}")


def make_dicom_cases(http: httpx.Client, served: Services, folder: Path) -> list[str]:
    """Cases whose files are DICOM objects that can be read. Before anybody else runs what is queued."""
    needs = _post(http, "/v1/simulations/estimate", {})
    identifiers = []
    for number in range(OF_EACH):
        files = {}
        for name in ("projections/0001.dcm", "projections/0002.dcm"):
            path = folder / "made.dcm"
            write_dicom(path, number=len(files) + 1, seed=number, study=f"2.25.{number + 7}")
            files[name] = asdict(served.store.add(path))
        identifier = served.jobs.create({}, needs, "dicom").id
        assert served.jobs.claim(identifier, "resources") is not None
        assert served.jobs.succeed(identifier, "resources", {"files": files, "stages": [], "results": {}})
        identifiers.append(identifier)
    return identifiers
