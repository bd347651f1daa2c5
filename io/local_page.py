"""A page for a browser on this machine: on 127.0.0.1 alone, under a secret path, for requests of its own page alone.

Other programs' pages in the same browser can send requests here too: they do not know the token in the URL, name
another Origin, and where they come by a name of their own (DNS rebinding) another Host.
"""

import hmac
import json
import secrets
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qsl, urlsplit

from quadrig.single.errors import QuadrigError

# More than any request of a page has to say.
_MOST_BYTES = 100_000
# s after which a connection that says nothing is closed.
_SILENT = 60
_POLICY = (
    "default-src 'self'; img-src 'self' blob: data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; "
    "object-src 'none'"
)
_HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


@dataclass(frozen=True)
class Request:
    """What the page asks: GET or POST, the path below the token, values of the query or of the JSON that was sent."""

    method: str
    path: str
    values: Mapping[str, object]


@dataclass(frozen=True)
class Reply:
    """What it gets."""

    body: bytes
    kind: str

    @staticmethod
    def of_json(value: object) -> "Reply":
        """A value as JSON; no nan in it."""
        return Reply(json.dumps(value, allow_nan=False).encode(), "application/json")


Answer = Callable[[Request], Reply | None]


class LocalPage:
    """A server on 127.0.0.1 that gives a page and answers it. `url` is where; it ends with `close`.

    answer: called in threads; None where there is no such thing; an error becomes {"problem": its sentence} with
    status 400. port: 0 takes a free one. policy: what the page may load, and from where.
    Raises QuadrigError where the port is taken.
    """

    def __init__(self, answer: Answer, port: int = 0, policy: str = _POLICY) -> None:
        self.token = secrets.token_urlsafe(24)
        try:
            self._server = _Server(("127.0.0.1", port), _handler(answer, self.token, policy))
        except OSError as error:
            raise QuadrigError(f"port {port} of 127.0.0.1 cannot be had ({error.strerror}); give another") from error
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}/{self.token}/"

    def serve(self) -> None:
        """Answer until `close` is called from another thread, or Ctrl-C."""
        self._server.serve_forever(poll_interval=0.1)

    def close(self) -> None:
        """Answer no more."""
        self._server.shutdown()

    def __enter__(self) -> "LocalPage":
        return self

    def __exit__(self, *_: object) -> None:
        self._server.server_close()


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request: object, client_address: object) -> None:
        """A browser that goes away in the middle of an answer is no error; all else is said as usual."""
        if not isinstance(sys.exception(), ConnectionError | TimeoutError):
            super().handle_error(request, client_address)  # pyright: ignore[reportArgumentType]


def _handler(answer: Answer, token: str, policy: str) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        timeout = _SILENT
        protocol_version = "HTTP/1.1"
        server_version, sys_version = "quadrig", ""

        def do_GET(self) -> None:
            self._respond(dict(parse_qsl(urlsplit(self.path).query)))

        def do_POST(self) -> None:
            self._respond(None)

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - as http.server calls it
            pass

        def _respond(self, values: dict[str, object] | None) -> None:
            # Where a request is refused its body is not read: what follows on this connection would be taken for one.
            self.close_connection = True
            parts = urlsplit(self.path).path.split("/", 2)
            own = f"127.0.0.1:{self.server.server_address[1]}"  # pyright: ignore[reportIndexIssue]
            hosts = (own, own.replace("127.0.0.1", "localhost"))
            host, origin = self.headers.get("Host", ""), self.headers.get("Origin")
            if host not in hosts or (origin is None and values is None) or origin not in (None, f"http://{host}"):
                self._send(HTTPStatus.FORBIDDEN)
            elif len(parts) != 3 or not hmac.compare_digest(parts[1].encode(), token.encode()):
                self._send(HTTPStatus.NOT_FOUND)
            elif values is None and (values := self._sent()) is None:
                self._send(HTTPStatus.BAD_REQUEST)
            else:
                self.close_connection = False
                self._answer(Request(self.command, parts[2], values))

        def _sent(self) -> dict[str, object] | None:
            """The JSON that was sent, None where it is none."""
            size = self.headers.get("Content-Length", "")
            if not size.isdigit() or int(size) > _MOST_BYTES:
                return None
            if self.headers.get("Content-Type") != "application/json":
                return None
            try:
                value = json.loads(self.rfile.read(int(size)))
            except (ValueError, RecursionError):
                return None
            return value if isinstance(value, dict) else None

        def _answer(self, request: Request) -> None:
            try:
                reply = answer(request)
            except Exception as error:
                # The page says it, as a command would: nobody who looks at the page sees a traceback elsewhere.
                problem = str(error) if isinstance(error, QuadrigError) else f"unexpected error ({error!r})"
                self._send(HTTPStatus.BAD_REQUEST, Reply.of_json({"problem": problem}))
                return
            self._send(HTTPStatus.OK if reply else HTTPStatus.NOT_FOUND, reply)

        def _send(self, status: HTTPStatus, reply: Reply | None = None) -> None:
            reply = reply or Reply(status.phrase.encode(), "text/plain; charset=utf-8")
            self.send_response(status)
            headers = {
                **_HEADERS,
                "Content-Security-Policy": policy,
                "Content-Type": reply.kind,
                "Content-Length": str(len(reply.body)),
            }
            for name, value in headers.items():
                self.send_header(name, value)
            if self.close_connection:
                self.send_header("Connection", "close")
            self.end_headers()
            self.wfile.write(reply.body)

    return Handler
