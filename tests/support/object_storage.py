"""S3 in this process: what it promises of one object, and nothing between objects.

Requests of different objects run side by side. A conditional write that meets another write of the same object under
way is answered 409 ConditionalRequestConflict, as S3 does it.
"""

import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

CONFLICT = b"<Error><Code>ConditionalRequestConflict</Code><Message>a write is under way</Message></Error>"
WRITES = ("PUT", "POST", "DELETE")


class ObjectRequests:
    """The requests under way: those of one object come one after the other, those of a whole bucket alone."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._writes: dict[str, bool] = {}
        """Objects with a request under way, and whether it writes."""
        self._alone = False

    @contextmanager
    def of_object(self, path: str, writes: bool, conditional: bool) -> Iterator[bool]:
        """Waits for the request before. False at once where a conditional write meets another write."""
        with self._changed:
            if writes and conditional and self._writes.get(path):
                yield False
                return
            self._changed.wait_for(lambda: not self._alone and path not in self._writes)
            self._writes[path] = writes
        try:
            yield True
        finally:
            with self._changed:
                del self._writes[path]
                self._changed.notify_all()

    @contextmanager
    def of_bucket(self) -> Iterator[None]:
        """Waits until no other request is under way; others wait for this one."""
        with self._changed:
            self._changed.wait_for(lambda: not self._alone and not self._writes)
            self._alone = True
        try:
            yield
        finally:
            with self._changed:
                self._alone = False
                self._changed.notify_all()


@contextmanager
def served() -> Iterator[str]:
    """URL of an S3 service that keeps everything in memory."""
    from moto.moto_server.werkzeug_app import DomainDispatcherApplication, create_backend_app
    from werkzeug.serving import WSGIRequestHandler, make_server

    class Quiet(WSGIRequestHandler):
        def log(self, *args: Any, **kwargs: Any) -> None:
            pass

    app = DomainDispatcherApplication(create_backend_app)
    requests = ObjectRequests()

    def serve(environ: dict[str, Any], start_response: Callable[..., Any]) -> Iterable[bytes]:
        path = environ["PATH_INFO"]
        if path.strip("/").count("/") == 0:
            with requests.of_bucket():
                return list(app(environ, start_response))
        conditional = "HTTP_IF_MATCH" in environ or "HTTP_IF_NONE_MATCH" in environ
        with requests.of_object(path, environ["REQUEST_METHOD"] in WRITES, conditional) as goes_on:
            if goes_on:
                return list(app(environ, start_response))
        start_response("409 Conflict", [("Content-Type", "application/xml"), ("Content-Length", str(len(CONFLICT)))])
        return [CONFLICT]

    server = make_server("127.0.0.1", 0, serve, threaded=True, request_handler=Quiet)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        thread.join()
