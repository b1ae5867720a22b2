"""A proxy in front of a server of S3 that counts requests and answers some of them wrongly.

A fault is chosen by what a request is (`upload-part`, `complete` …) and by how many of that kind are to fail. It is one of

* a number: that status, and the server never hears of the request;
* `cut`: the connection is closed in the middle of the request's body, and the server never hears of it;
* `lost`: the server does what it is asked, and the connection is closed before its answer;
* `held`: the request waits, until `release` is called, before the server hears of it;
* `hung`: it waits likewise, and the server never hears of it.
"""
import collections
import http.client
import http.server
import socket
import threading
import urllib.parse

from local import Local

# Of a connection alone: not passed on.
HOP_BY_HOP = {"connection", "keep-alive", "transfer-encoding", "host"}


def kind_of(method, target, length):
    """What a request of S3's protocol, with a body of so many bytes, is. `note` is what says which upload is under way."""
    if method == "PUT" and target.endswith(".rayset-upload"):
        return "note" if length else "empty-note"
    query = urllib.parse.parse_qs(urllib.parse.urlsplit(target).query, keep_blank_values=True)
    if method == "POST" and "uploads" in query:
        return "create"
    if method == "PUT" and "partNumber" in query:
        return "upload-part"
    if method == "POST" and "uploadId" in query:
        return "complete"
    if method == "POST" and "delete" in query:
        return "delete"
    if method == "DELETE" and "uploadId" in query:
        return "abort"
    if method == "GET" and "uploads" in query:
        return "list-uploads"
    return method.lower()


class Proxy(Local):
    """Listens on a port of this machine and passes requests on to another one."""

    def __init__(self, host, port):
        self.counts = collections.Counter()
        self.lock = threading.Lock()
        self.faults = {}
        # How many requests have failed so far.
        self.failed = 0
        self.is_free = threading.Event()
        proxy = self

        class Handler(http.server.BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def answer(self):
                proxy.answer(self, (host, port))

            do_GET = do_HEAD = do_PUT = do_POST = do_DELETE = answer

            def log_message(self, *_):
                pass

        super().__init__(Handler)

    def fail(self, kind, how, times=1, after=0):
        """From now on, after some that pass, so many requests of a kind fail."""
        with self.lock:
            self.faults[kind] = [how, times, after]
        self.is_free.clear()

    def release(self):
        """No faults from now on, and what was held goes on."""
        with self.lock:
            self.faults.clear()
        self.is_free.set()

    def fault(self, kind):
        with self.lock:
            self.counts[kind] += 1
            fault = self.faults.get(kind)
            if fault is None:
                return None
            if fault[2] > 0:
                fault[2] -= 1
                return None
            if fault[1] == 0:
                return None
            fault[1] -= 1
            self.failed += 1
            return fault[0]

    def answer(self, handler, server):
        length = int(handler.headers.get("Content-Length") or 0)
        fault = self.fault(kind_of(handler.command, handler.path, length))
        if fault == "cut":
            handler.rfile.read(length // 2)
            return hang_up(handler)
        body = handler.rfile.read(length)
        if isinstance(fault, int):
            return refuse(handler, fault)
        if fault in ("held", "hung"):
            self.is_free.wait(60)
        if fault == "hung":
            return hang_up(handler)
        connection = http.client.HTTPConnection(*server, timeout=60)
        headers = {name: value for name, value in handler.headers.items() if name.lower() not in HOP_BY_HOP}
        connection.request(handler.command, handler.path, body, headers)
        answer = connection.getresponse()
        content = answer.read()
        connection.close()
        if fault == "lost":
            return hang_up(handler)
        handler.send_response(answer.status)
        for name, value in answer.getheaders():
            if name.lower() not in HOP_BY_HOP | {"content-length", "date", "server"}:
                handler.send_header(name, value)
        # Of an answer without a body, the length of what would be in it.
        told = answer.getheader("Content-Length") if handler.command == "HEAD" else None
        handler.send_header("Content-Length", told or str(len(content)))
        handler.end_headers()
        handler.wfile.write(content)


def hang_up(handler):
    handler.close_connection = True
    handler.connection.shutdown(socket.SHUT_RDWR)


def refuse(handler, status):
    code = {403: "AccessDenied", 503: "SlowDown"}.get(status, "InternalError")
    content = f"<?xml version='1.0'?><Error><Code>{code}</Code><Message>by the proxy</Message></Error>".encode()
    handler.send_response(status)
    handler.send_header("Content-Type", "application/xml")
    handler.send_header("Content-Length", str(len(content)))
    handler.end_headers()
    handler.wfile.write(content)
