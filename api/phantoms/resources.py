"""Documents of label volumes, made from their rows."""

from __future__ import annotations

from api.http.documents import PREFIX
from simcore.phantom.upload import registry
from tomosim_contract.phantoms import Content, PhantomResource


def phantom_path(sha256: str) -> str:
    return f"{PREFIX}/phantoms/{sha256}"


def phantom_resource(upload: registry.Upload) -> PhantomResource:
    """The document of an upload."""
    return PhantomResource(
        sha256=upload.sha256,
        name=upload.name,
        size=upload.size,
        format=upload.format,
        values=upload.values,
        contents=[Content(**entry) for entry in upload.contents],
        remarks=list(upload.remarks),
        specification={"phantom": upload.phantom},
        links={"self": phantom_path(upload.sha256), "simulations": f"{PREFIX}/simulations"},
    )
