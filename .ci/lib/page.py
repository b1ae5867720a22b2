"""A page of `rayset view` without a browser: it is let in by an invitation, and hears what the program says to pages."""
import http.client
import json
import re
import signal
import socket


class Viewer:
    """`rayset view`, as a user starts it."""

    def __init__(self, program, *words, **environment):
        self.process = program.start("view", *words, "--no-open", "--memory", "128MiB", **environment)
        self.address = self.process.stdout.readline().strip()
        found = re.match(r"http://127\.0\.0\.1:(\d+)/\?token=[0-9a-f]{32}$", self.address)
        assert found, f"no address: {self.address!r} {self.process.stderr.read()}"
        self.port = int(found[1])

    def page(self):
        """What is in the page, and a socket that speaks with the program."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        connection.request("GET", self.address[self.address.index("/?"):])
        answer = connection.getresponse()
        answer.read()
        cookie = answer.getheader("Set-Cookie").split(";")[0]
        connection.request("GET", "/", headers={"Cookie": cookie})
        page = connection.getresponse()
        content = page.read().decode()
        assert page.status == 200, page.status
        return content, Socket(self.port, cookie)

    def end(self):
        self.process.send_signal(signal.SIGINT)
        self.process.communicate(timeout=60)


class Socket:
    def __init__(self, port, cookie):
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=120)
        self.socket.sendall((
            f"GET /socket HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nOrigin: http://127.0.0.1:{port}\r\n"
            f"Cookie: {cookie}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n").encode())
        self.stream = self.socket.makefile("rb")
        assert self.stream.readline().startswith(b"HTTP/1.1 101")
        while self.stream.readline().strip():
            pass

    def say(self, message):
        """Sends a message, in a frame with a mask of zeros."""
        payload = json.dumps(message).encode()
        assert len(payload) < 1 << 16
        self.socket.sendall(bytes([0x81, 0x80 | 126]) + len(payload).to_bytes(2, "big") + bytes(4) + payload)

    def hear(self):
        """The next message: a value, or the bytes of a picture."""
        while True:
            first, second = self.stream.read(2)
            length = second & 0x7F
            if length >= 126:
                length = int.from_bytes(self.stream.read(2 if length == 126 else 8), "big")
            payload = self.stream.read(length)
            if first & 0x0F == 1:
                return json.loads(payload)
            if first & 0x0F == 2:
                return payload
            assert first & 0x0F != 8, f"the program closed the connection: {payload!r}"

    def hear_until(self, is_wanted):
        while not is_wanted(message := self.hear()):
            assert not isinstance(message, dict) or message.get("type") != "refused", message
        return message
