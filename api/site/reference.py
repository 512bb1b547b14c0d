"""/docs: every operation of the API on one page, made from the OpenAPI description. It loads nothing from elsewhere."""

from __future__ import annotations

import base64
import hashlib
from html import escape
from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

STYLE = """
:root { color-scheme: light dark; --line: #8884; --soft: #888; }
body { font: 15px/1.45 system-ui, sans-serif; margin: 0 auto; padding: 1rem; max-width: 62rem; }
h1 { font-size: 1.4rem; } h2 { font-size: 1.15rem; margin-top: 2rem; }
details { border-top: 1px solid var(--line); padding: .5rem 0; }
summary { cursor: pointer; }
code { font-family: ui-monospace, monospace; } .method { font-weight: 600; }
.note { color: var(--soft); } td, th { text-align: left; vertical-align: top; padding: .1rem 1rem .1rem 0; }
"""

METHODS = ("get", "head", "post", "put", "patch", "delete")

Json = dict[str, Any]

router = APIRouter(include_in_schema=False)


@router.get("/docs")
def reference(request: Request) -> HTMLResponse:
    """The page."""
    digest = base64.b64encode(hashlib.sha256(STYLE.encode()).digest()).decode()
    policy = f"default-src 'none'; style-src 'sha256-{digest}'; base-uri 'none'; frame-ancestors 'none'"
    headers = {"Content-Security-Policy": policy, "Cache-Control": "no-cache"}
    return HTMLResponse(page(request.app.openapi()), headers=headers)


def page(description: Json) -> str:
    """The page of an OpenAPI description."""
    info = description["info"]
    groups: dict[str, list[str]] = {}
    for path, operations in description["paths"].items():
        for method in METHODS:
            if operation := operations.get(method):
                tag = (operation.get("tags") or ["other"])[0]
                groups.setdefault(tag, []).append(_operation(method, path, operation))
    body = "\n".join(f"<h2>{escape(tag)}</h2>\n" + "\n".join(sections) for tag, sections in groups.items())
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(info["title"])} API</title>
<link rel="icon" href="data:,">
<style>{STYLE}</style>
</head>
<body>
<h1>{escape(info["title"])} {escape(info["version"])}</h1>
<p>{escape(info.get("description", ""))}</p>
<p>For programs: <a href="/openapi.json">openapi.json</a>. What can be asked of a case, with units and bounds:
<a href="/v1/schemas/simulation">the schema</a>; to begin with: <a href="/v1/presets">presets</a>.</p>
{body}
</body>
</html>
"""


def _operation(method: str, path: str, operation: Json) -> str:
    text = operation.get("description", "")
    first, _, rest = text.partition("\n")
    parts = [f"<p>{escape(rest.strip())}</p>" if rest.strip() else ""]
    if parameters := operation.get("parameters"):
        rows = "".join(_row(p["name"], p["in"], p.get("description", ""), p["schema"]) for p in parameters)
        parts.append(f"<table>{rows}</table>")
    if body := operation.get("requestBody"):
        kinds = ", ".join(_content(kind, content) for kind, content in body["content"].items())
        parts.append(f"<p>Body: {kinds}</p>")
    answers = ", ".join(
        f"<code>{escape(status)}</code> {escape(answer.get('description', ''))}"
        for status, answer in operation["responses"].items()
    )
    parts.append(f"<p>Answers: {answers}</p>")
    head = f'<span class="method">{method.upper()}</span> <code>{escape(path)}</code>'
    details = "\n".join(part for part in parts if part)
    return f'<details><summary>{head} <span class="note">{escape(first)}</span></summary>\n{details}\n</details>'


def _row(name: str, place: str, description: str, schema: Json) -> str:
    choices = [s["enum"] for s in (schema, *schema.get("anyOf", ())) if "enum" in s]
    allowed = f" ({', '.join(map(str, choices[0]))})" if choices else ""
    default = f"; default {schema['default']}" if schema.get("default") is not None else ""
    text = escape(f"{description}{allowed}{default}")
    return f"<tr><td><code>{escape(name)}</code></td><td>{escape(place)}</td><td>{text}</td></tr>"


def _content(kind: str, content: Json) -> str:
    name = content.get("schema", {}).get("$ref", "").rpartition("/")[2]
    return f"<code>{escape(kind)}</code>{f' ({escape(name)})' if name else ''}"
