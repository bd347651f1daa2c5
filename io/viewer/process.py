"""The rerun viewer as a process: found, started, and ended with us."""

import contextlib
import ipaddress
import os
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from quadrig.single.errors import QuadrigError

# A viewer that is opened needs this long (s) to listen, a slow machine more; one without a display dies in a tenth.
_OPENING_SECONDS, _WINDOW_SECONDS = 15.0, 1.0
_NICE = 5
# rerun tells its makers how it is used, unless it runs in continuous integration: what `rig` starts tells nobody.
_SILENT = {"CI": "1"}
# Runs a viewer until the pipe to us is closed, as it is when we are killed. The whole group is ended: the `rerun`
# that is on the path is a script that waits for the program which does the work.
_ENDS_WITH_US = """
import os, signal, subprocess, sys, threading
viewer = subprocess.Popen(sys.argv[1:], stdin=subprocess.DEVNULL)
def end():
    sys.stdin.buffer.read()
    os.killpg(0, signal.SIGTERM) if hasattr(os, "killpg") else viewer.terminate()
threading.Thread(target=end, daemon=True).start()
sys.exit(viewer.wait())
"""
# What a viewer keeps of a session: pictures of a few minutes.
_MEMORY = "512MiB"


class Viewer:
    """A rerun viewer in a process of its own, at an address of this machine alone that nobody else is told.

    web: a page for a browser instead of a window. options: of the `rerun` program, for a viewer without a window.
    Raises QuadrigError where it does not open.
    """

    def __init__(self, web: bool = False, options: Sequence[str] = ()) -> None:
        if not (web or options or has_screen()):
            raise QuadrigError("there is no screen here for the rerun viewer; use --web for a browser or --no-viewer")
        host, self.page = own_address(), ""
        port = free_port(host)
        ports = [port]
        command = [_executable(), "--bind", host, "--port", str(port), "--memory-limit", _MEMORY, *options]
        if web:
            web_port = free_port(host)
            ports.append(web_port)
            command += ["--serve-web", "--web-viewer-port", str(web_port)]
            self.page = f"http://{host}:{web_port}/?url=rerun%2Bhttp://{host}:{port}/proxy"
        self.address = f"rerun+http://{host}:{port}/proxy"
        self._stays = not (web or options)
        if not self._stays:
            command = [sys.executable, "-I", "-S", "-c", _ENDS_WITH_US, *command]
        # In a session of its own: a Ctrl-C that ends ours leaves the window with the result.
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL if self._stays else subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            env={**os.environ, **_SILENT},
        )
        if hasattr(os, "setpriority"):
            # Drawing takes all it can get, in software most of all: the search comes first.
            os.setpriority(os.PRIO_PGRP, self._process.pid, _NICE)
        try:
            for each in ports:
                self._wait_for(host, each)
        except BaseException:
            self.close(force=True)
            raise

    @property
    def open(self) -> bool:
        """Whether it still runs."""
        return self._process.poll() is None

    def _wait_for(self, host: str, port: int) -> None:
        until = time.monotonic() + _OPENING_SECONDS
        while time.monotonic() < until and self.open:
            try:
                socket.create_connection((host, port), timeout=0.2).close()
                # It listens before it opens its window, and dies where it cannot.
                self._process.wait(_WINDOW_SECONDS if self._stays else 0.0)
            except subprocess.TimeoutExpired:
                return
            except OSError:
                time.sleep(0.05)
        raise QuadrigError("the rerun viewer does not open here; use --web for a browser or --no-viewer")

    def close(self, force: bool = False) -> None:
        """A window stays for who wants to look at the result; a page for a browser goes with the session."""
        if (self._stays and not force) or self._process.poll() is not None:
            return
        if hasattr(os, "killpg"):
            os.killpg(self._process.pid, signal.SIGTERM)
        else:
            self._process.terminate()
        self._process.wait()


def has_screen() -> bool:
    """Whether a window can open here."""
    # Elsewhere than on Linux a window opens wherever a person can start the command.
    named = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")
    return not sys.platform.startswith("linux") or any(os.environ.get(name) for name in named)


def own_address() -> str:
    """An address of this machine alone that nobody guesses, where the system has more than 127.0.0.1 (not on macOS).

    rerun's servers know no token and answer whatever Host they are called by: a page in this machine's browser whose
    name is made to lead here (DNS rebinding) could read them if it knew the address, one of 2^24 at 2^15 ports.
    """
    address = str(ipaddress.IPv4Address(0x7F000002 + secrets.randbelow((1 << 24) - 4)))
    try:
        free_port(address)
    except OSError:
        return "127.0.0.1"
    return address


def free_port(host: str) -> int:
    """A port of this address that nobody listens on."""
    with socket.socket() as probe:
        probe.bind((host, 0))
        return probe.getsockname()[1]


def _executable() -> str:
    """The viewer that came with this Python's rerun, or another on the path."""
    beside = Path(sys.executable).with_name("rerun")
    found = str(beside) if beside.exists() else shutil.which("rerun")
    if not found:
        raise QuadrigError("there is no rerun viewer here; install rerun-sdk, or use --no-viewer")
    return found


@contextlib.contextmanager
def ends_with_us(viewer: "Viewer") -> Iterator["Viewer"]:
    """A viewer that is closed when the block ends, by whatever signal: it has a session of its own, else it stays."""
    ends = (signal.SIGINT, signal.SIGTERM)
    before = signal.getsignal(signal.SIGINT), signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield viewer
    finally:
        # Whoever is impatient and asks again would leave it behind.
        for one in ends:
            signal.signal(one, signal.SIG_IGN)
        viewer.close()
        for one, handler in zip(ends, before, strict=True):
            signal.signal(one, handler)
