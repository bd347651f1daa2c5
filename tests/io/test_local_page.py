"""A page on this machine answers its own page alone: the token, the Host and the Origin are checked, and no file is
served but what it is given."""

import http.client
import json
import socket
import threading
from urllib.parse import urlsplit

import pytest

from quadrig.io.local_page import LocalPage, Reply, Request
from quadrig.single.errors import QuadrigError


def answer(request: Request) -> Reply | None:
    if request.path == "bad":
        raise QuadrigError("not so; do it otherwise")
    if request.path == "broken":
        raise ZeroDivisionError("by nought")
    if request.path == "large":
        return Reply(bytes(50_000_000), "image/jpeg")
    if request.path == "missing":
        return None
    return Reply.of_json([request.method, request.path, dict(request.values)])


@pytest.fixture
def page():
    with LocalPage(answer) as served:
        thread = threading.Thread(target=served.serve)
        thread.start()
        yield served
        served.close()
        thread.join()


def asked(page, path, method="GET", body=None, **headers):
    """Status, body and headers of an answer; {own} in a header is the page's own host and port."""
    own = urlsplit(page.url).netloc
    connection = http.client.HTTPConnection("127.0.0.1", urlsplit(page.url).port, timeout=10)
    connection.putrequest(method, path, skip_host=True)
    for name, value in {"Host": "{own}", **headers}.items():
        if value is not None:
            connection.putheader(name.replace("_", "-"), value.format(own=own))
    if body is not None:
        connection.putheader("Content-Length", str(len(body)))
    connection.endheaders(body)
    reply = connection.getresponse()
    text = reply.read()
    connection.close()
    return reply.status, text, reply.headers


def path_of(page, rest=""):
    return urlsplit(page.url).path + rest


def test_its_own_page_is_answered(page):
    status, text, headers = asked(page, path_of(page, "a?x=1"))
    assert (status, json.loads(text)) == (200, ["GET", "a", {"x": "1"}])
    assert "default-src 'self'" in headers["Content-Security-Policy"]
    assert (headers["Referrer-Policy"], headers["X-Content-Type-Options"]) == ("no-referrer", "nosniff")
    sent = {"Content_Type": "application/json", "Origin": "http://{own}", "body": b'{"x": 1}', "method": "POST"}
    assert json.loads(asked(page, path_of(page, "a"), **sent)[1]) == ["POST", "a", {"x": 1}]
    assert asked(page, path_of(page, "bad"))[:2] == (400, b'{"problem": "not so; do it otherwise"}')
    assert asked(page, path_of(page, "missing"))[0] == 404


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Host": "evil.example"}, 403),
        ({"Host": "evil.example:80"}, 403),
        ({"Host": "127.0.0.1"}, 403),
        ({"Host": None}, 403),
        ({"Origin": "http://evil.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Origin": "https://{own}"}, 403),
        ({"method": "POST", "body": b"{}", "Content_Type": "application/json"}, 403),
        ({"method": "POST", "body": b"{}", "Content_Type": "application/json", "Origin": "http://localhost:1"}, 403),
        ({"method": "POST", "body": b"{}", "Content_Type": "text/plain", "Origin": "http://{own}"}, 400),
        ({"method": "POST", "body": b"[1]", "Content_Type": "application/json", "Origin": "http://{own}"}, 400),
        (
            {"method": "POST", "body": b"[" * 9000, "Content_Type": "application/json", "Origin": "http://{own}"},
            400,
        ),
        ({"method": "POST", "Content_Type": "application/json", "Origin": "http://{own}"}, 400),
        ({"method": "PUT"}, 501),
    ],
)
def test_requests_from_elsewhere_are_refused(page, headers, status):
    got, text, _ = asked(page, path_of(page, "a"), **headers)
    assert got == status
    assert b'"a"' not in text


@pytest.mark.parametrize("path", ["/", "/a", "/wrong/a", "//a", "/../../etc/passwd", "/{token}x/a", "/{token}"])
def test_without_the_token_there_is_nothing(page, path):
    assert asked(page, path.format(token=page.token))[0] == 404


def test_a_body_that_is_announced_too_large_is_not_read(page):
    own = urlsplit(page.url).netloc
    with socket.create_connection(("127.0.0.1", urlsplit(page.url).port), timeout=10) as line:
        head = f"POST {path_of(page, 'a')} HTTP/1.1\r\nHost: {own}\r\nOrigin: http://{own}\r\n"
        line.sendall(f"{head}Content-Type: application/json\r\nContent-Length: 99999999999\r\n\r\n".encode())
        assert b" 400 " in line.recv(1000)


def test_an_error_is_said_to_the_page_and_a_browser_that_goes_away_is_none(page, capfd):
    assert asked(page, path_of(page, "broken"))[:2] == (
        400,
        b'{"problem": "unexpected error (ZeroDivisionError(\'by nought\'))"}',
    )
    with socket.create_connection(("127.0.0.1", urlsplit(page.url).port), timeout=10) as line:
        line.sendall(f"GET {path_of(page, 'large')} HTTP/1.1\r\nHost: {urlsplit(page.url).netloc}\r\n\r\n".encode())
        assert b" 200 " in line.recv(100)
    assert asked(page, path_of(page, "a"))[0] == 200
    assert capfd.readouterr().err == ""


def test_it_listens_on_this_machine_alone_and_a_taken_port_is_said(page):
    assert urlsplit(page.url).hostname == "127.0.0.1"
    port = urlsplit(page.url).port
    # Every address of 127.0.0.0/8 is this machine: a server on all of them would answer here too.
    with pytest.raises(OSError, match=r"refused"):
        socket.create_connection(("127.0.0.2", port), timeout=5).close()
    with pytest.raises(QuadrigError, match=rf"port {port} of 127.0.0.1 cannot be had .*give another"):
        LocalPage(answer, port)
