"""What is shown as a page for the browser of this machine: rerun's own viewer, served by a page that answers nobody
else, and that lets the viewer talk to nobody else.

rerun's servers answer whoever finds their port, and its page asks for fonts and scripts from elsewhere. So they only
hand over the viewer's files, before there is anything to see, and are gone when the page is served.
"""

import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import quote
from urllib.request import urlopen

from quadrig.io.local_page import Answer, LocalPage, Reply, Request
from quadrig.io.viewer.process import Viewer
from quadrig.single.errors import QuadrigError

_KINDS = {
    "": "text/html; charset=utf-8",
    "re_viewer.js": "text/javascript",
    "re_viewer_bg.wasm": "application/wasm",
    "favicon.ico": "image/x-icon",
}
RECORDING = "shown.rrd"
"""The name of what is shown, below the page's own address."""
# The viewer is compiled (wasm) and begun by scripts in its page; all else is as for our own pages.
_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval' blob:; "
    "style-src 'self' 'unsafe-inline'; worker-src 'self' blob:; connect-src 'self' blob: data:{}; "
    "img-src 'self' blob: data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; object-src 'none'"
)
# s to hand over one file; the largest has some 40 MB.
_PATIENCE = 60.0


def viewer_files() -> dict[str, Reply]:
    """The files of rerun's web viewer, by name. Raises QuadrigError where there is none."""
    viewer = Viewer(web=True)
    root = viewer.page.partition("?")[0]
    try:
        return {name: Reply(_read(root + name), kind) for name, kind in _KINDS.items()}
    except OSError as error:
        raise QuadrigError(f"rerun's viewer for the browser does not answer here ({error}); use --save") from error
    finally:
        viewer.close()


def _read(address: str) -> bytes:
    with urlopen(address, timeout=_PATIENCE) as answer:
        return answer.read()


class PageViewer:
    """A viewer in the browser for what is still to come: `address` takes it, `page` shows it, until `close`.

    What is sent waits in rerun's own server, which knows no token: its address stands for one (own_address), and is
    told by this page alone. Pages from elsewhere that knew it could not read what it answers (CORS); programs of this
    machine that look for open ports can.
    """

    def __init__(self) -> None:
        files = viewer_files()
        self._viewer = Viewer(options=("--serve-grpc",))
        self.address = self._viewer.address
        self._page = LocalPage(files_alone(files), policy=_POLICY.format(f" {_origin(self.address)}"))
        self.page = page_address(self._page, self.address)
        threading.Thread(target=self._page.serve, name="page", daemon=True).start()

    @property
    def open(self) -> bool:
        """Whether it still runs."""
        return self._viewer.open

    def close(self) -> None:
        """Show no more."""
        self._page.close()
        self._viewer.close()


def _origin(address: str) -> str:
    """http://127.0.0.1:9876 of rerun+http://127.0.0.1:9876/proxy."""
    return address.removeprefix("rerun+").removesuffix("/proxy")


def rrd_page(rrd: bytes) -> LocalPage:
    """A page that shows the content of an .rrd file, at page_address(page, page.url + RECORDING)."""
    files = {**viewer_files(), RECORDING: Reply(rrd, "application/octet-stream")}
    return LocalPage(files_alone(files), policy=_POLICY.format(""))


def page_address(page: LocalPage, source: str) -> str:
    """Where a browser sees what is at `source`."""
    return f"{page.url}?url={quote(source, safe='')}"


def files_alone(files: Mapping[str, Reply]) -> Answer:
    """Gives these files by their names, and nothing else."""

    def answer(request: Request) -> Reply | None:
        return files.get(request.path) if request.method == "GET" else None

    return answer


def serve(write: Callable[[Path], None]) -> None:
    """Serve what `write` writes to the .rrd file that it is given, until Ctrl-C."""
    with TemporaryDirectory() as folder:
        rrd = Path(folder) / RECORDING
        write(rrd)
        page = rrd_page(rrd.read_bytes())
    with page, suppress(KeyboardInterrupt):
        print(f"{page_address(page, page.url + RECORDING)}\nCtrl-C ends it", flush=True)
        page.serve()
