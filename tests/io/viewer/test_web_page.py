"""What rig inspect --web and rig setup --web serve: to their own page alone, on this machine alone, and the page of
rerun's viewer reaches nobody else."""

import http.client
import ipaddress
import shutil
import socket
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from urllib.parse import parse_qs, urlsplit

import pytest

from quadrig.io.viewer.process import Viewer, own_address
from quadrig.io.viewer.web_page import RECORDING, PageViewer, page_address, rrd_page

RRD = b"what is shown"
READ = "/rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages"


@pytest.fixture(scope="module")
def page():
    with rrd_page(RRD) as served:
        thread = threading.Thread(target=served.serve)
        thread.start()
        yield served
        served.close()
        thread.join()


def asked(url, path=None, **headers):
    """Status, body and policy of a GET."""
    parts = urlsplit(url)
    connection = http.client.HTTPConnection("127.0.0.1", parts.port, timeout=10)
    connection.putrequest("GET", parts.path if path is None else path, skip_host=True)
    for name, value in {"Host": parts.netloc, **headers}.items():
        connection.putheader(name, value)
    connection.endheaders()
    reply = connection.getresponse()
    return reply.status, reply.read(), reply.headers.get("Content-Security-Policy", "")


def test_the_viewer_and_what_it_shows_are_under_the_token(page):
    assert parse_qs(urlsplit(page_address(page, page.url + RECORDING)).query)["url"] == [page.url + RECORDING]
    assert b"re_viewer.js" in asked(page.url)[1]
    assert asked(page.url + "re_viewer_bg.wasm")[1][:4] == b"\0asm"
    assert asked(page.url + RECORDING)[:2] == (200, RRD)
    for path in ("/", f"/{RECORDING}", "/wrong/", f"/{page.token}/../{RECORDING}", f"/{page.token}/etc/passwd"):
        assert asked(page.url, path)[0] == 404, path


@pytest.mark.parametrize("headers", [{"Host": "evil.example"}, {"Origin": "http://evil.example"}, {"Origin": "null"}])
def test_requests_from_elsewhere_are_refused(page, headers):
    status, body, _ = asked(page.url + RECORDING, **headers)
    assert status == 403
    assert RRD not in body


def test_the_page_may_reach_nobody_else(page):
    policy = asked(page.url)[2]
    assert "connect-src 'self' blob: data:;" in policy
    assert "http" not in policy


def test_a_live_page_reaches_the_one_server_that_has_its_pictures():
    viewer = PageViewer()
    try:
        shown = parse_qs(urlsplit(viewer.page).query)["url"][0]
        assert shown == viewer.address
        own = viewer.address.removeprefix("rerun+").removesuffix("/proxy")
        assert f"connect-src 'self' blob: data: {own};" in asked(viewer.page.partition("?")[0])[2]
        # Pages from elsewhere get no leave to read it, and those that name it otherwise do not know where it is.
        where = urlsplit(own)
        page_origin = viewer.page[: viewer.page.index("/", len("http://"))]
        for origin, allowed in (("http://evil.example", None), ("null", None), (page_origin, page_origin)):
            connection = http.client.HTTPConnection(str(where.hostname), where.port, timeout=10)
            connection.request("OPTIONS", READ, headers={"Origin": origin, "Access-Control-Request-Method": "POST"})
            assert connection.getresponse().headers.get("Access-Control-Allow-Origin") == allowed
        for address in ("127.0.0.1", "127.0.0.2", socket.gethostbyname(socket.gethostname())):
            with pytest.raises(OSError, match=r"refused"):
                http.client.HTTPConnection(address, where.port, timeout=5).connect()
    finally:
        viewer.close()
    assert not viewer.open


@pytest.mark.skipif(sys.platform == "darwin", reason="macOS has no address of its own but 127.0.0.1")
def test_a_viewer_stands_where_nobody_guesses():
    addresses = {own_address() for _ in range(9)}
    assert len(addresses) == 9
    assert all(ipaddress.ip_address(one).is_loopback for one in addresses)
    assert not addresses & {"127.0.0.1", "127.255.255.255"}


def test_a_viewer_that_is_started_keeps_no_count_of_who_uses_it(tmp_path, monkeypatch):
    """rerun notes who it is used by, to tell its makers, as soon as it starts, unless that is off."""
    for name in ("HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME"):
        monkeypatch.setenv(name, str(tmp_path))
    monkeypatch.delenv("CI", raising=False)
    Viewer(options=("--serve-grpc",)).close()
    assert list(tmp_path.rglob("*analytics*")) == []


def test_in_a_browser_nothing_leaves_this_machine(page):
    """The page asks for a font, its makers' newest release and where to tell how it is used: none is let through."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    found = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if found is None:
        pytest.skip("there is no Chromium here")
    left, own = [], urlsplit(page.url).netloc

    def look() -> None:
        with playwright.sync_playwright() as driver:
            browser = driver.chromium.launch(executable_path=found, args=["--no-sandbox"])
            opened = browser.new_page()
            opened.on("response", lambda reply: left.append(reply.url) if urlsplit(reply.url).netloc != own else None)
            with opened.expect_response("**/re_viewer_bg.wasm", timeout=60_000):
                opened.goto(page_address(page, page.url + RECORDING))
            browser.close()

    # Another test's browser may still have this thread's event loop.
    with ThreadPoolExecutor(1) as alone:
        alone.submit(look).result()
    assert [url for url in left if url.startswith("http")] == []
