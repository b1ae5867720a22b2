"""What tests share."""

from __future__ import annotations

import contextlib
import hashlib
import http.server
import os
import re
import signal
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import rayset as rs

# Tests interrupt renders. Whoever ignores SIGINT, as shells make what runs in the background do, hands that on.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing goes into the user's cache."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def points(count: int = 2000, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, 3))


@pytest.fixture(scope="session")
def cloud() -> rs.Cloud:
    """A ball of points in memory, with a temperature and classes."""
    where = points()
    attributes = {"T": where[:, 0].astype("f4"), "kind": (where[:, 1] > 0).astype("u1")}
    return rs.build(where, radius=0.3, attributes=attributes, classes=["kind"])


def program() -> str | None:
    """The program, if it is installed or named."""
    try:
        from rayset import _program

        return os.environ.get("RAYSET_PROGRAM") or _program.path()
    except FileNotFoundError:
        return None


class _Ranges(http.server.SimpleHTTPRequestHandler):
    """Files of a folder, whole or in ranges."""

    protocol_version = "HTTP/1.1"
    #: What was asked for: methods and paths.
    asked: list[tuple[str, str]]
    #: What the query of an address must be.
    signature: str | None = None

    def _send(self, with_body: bool) -> None:
        file = Path(self.translate_path(self.path))
        self.asked.append((self.command, self.path))
        if self.signature is not None and not self.path.endswith(f"?{self.signature}"):
            self.send_error(403)
            return
        if not file.is_file():
            self.send_error(404)
            return
        data, asked = file.read_bytes(), re.match(r"bytes=(\d+)-(\d*)", self.headers.get("Range", ""))
        first = int(asked[1]) if asked else 0
        last = min(int(asked[2]) if asked and asked[2] else len(data) - 1, len(data) - 1)
        self.send_response(206 if asked else 200)
        self.send_header("ETag", f'"{hashlib.sha256(data).hexdigest()}"')
        self.send_header("Accept-Ranges", "bytes")
        self.send_header("Content-Length", str(last - first + 1))
        if asked:
            self.send_header("Content-Range", f"bytes {first}-{last}/{len(data)}")
        self.end_headers()
        if with_body:
            self.wfile.write(data[first : last + 1])

    def do_GET(self) -> None:
        self._send(True)

    def do_HEAD(self) -> None:
        self._send(False)

    def log_message(self, *_: object) -> None:
        pass


@contextlib.contextmanager
def served(folder: Path, signature: str | None = None) -> Iterator[tuple[str, list[tuple[str, str]]]]:
    """The files of a folder at an address of this machine, and a list of what is asked for there. With a signature, only for addresses
    that have it as their query."""
    asked: list[tuple[str, str]] = []
    handler = type("Ranges", (_Ranges,), {"asked": asked, "signature": signature})
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), lambda *given: handler(*given, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}", asked
    finally:
        server.shutdown()
        server.server_close()
