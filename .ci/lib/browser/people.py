"""A person with a browser before `rayset view`, a stranger without one, and what they look at.

The program is named by the first word of the command line, the folder of screenshots by the second.
"""
import base64
import collections
import http.client
import json
import os
import pathlib
import re
import shlex
import signal
import socket
import subprocess
import sys
import tempfile
import time

from PIL import Image

PROGRAM = str(pathlib.Path(sys.argv[1]).resolve())
SHOTS = pathlib.Path(sys.argv[2] if len(sys.argv) > 2 else tempfile.mkdtemp())
SHOTS.mkdir(parents=True, exist_ok=True)
AXE = pathlib.Path(os.environ["AXE"]).read_text() if "AXE" in os.environ else None
# The page's files are taken from this folder, and not from the program: for those who write them.
PAGE = os.environ.get("PAGE")
# What the page may take for anything, in milliseconds; machines of CI are slow.
PATIENCE = 60_000

Test = collections.namedtuple("Test", "run input options")
TESTS = []


def test(of=None, options=()):
    """A test, which is given a server of this input; or none, and starts its own."""
    def take(run):
        TESTS.append(Test(run, of, options))
        return run
    return take


class Server:
    """`rayset view`, as a user starts it."""

    started = []

    def __init__(self, cloud, folder, port=0, options=()):
        environment = {**os.environ, "XDG_STATE_HOME": str(folder / "state"), "XDG_CACHE_HOME": str(folder / "cache")}
        command = [PROGRAM, "view", str(cloud), "--no-open", "--port", str(port), "--memory", "128MiB", *options]
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, stdin=subprocess.DEVNULL, text=True,
            env=environment)
        self.address = self.process.stdout.readline().strip()
        found = re.match(r"http://127\.0\.0\.1:(\d+)/\?token=[0-9a-f]{32}$", self.address)
        assert found, f"no address: {self.address!r}"
        self.port = int(found[1])
        Server.started.append(self)

    @classmethod
    def end_all(cls):
        for each in cls.started:
            each.process.kill()
            each.process.wait()
        cls.started.clear()

    def end(self):
        self.process.send_signal(signal.SIGINT)
        self.process.wait(20)

    def peak_bytes(self):
        status = pathlib.Path(f"/proc/{self.process.pid}/status").read_text()
        return int(re.search(r"VmHWM:\s+(\d+) kB", status)[1]) << 10


class Person:
    """Somebody with a browser; nothing that goes wrong on the page is let pass."""

    def __init__(self, browser, server, address=None, width=960, height=600, **options):
        self.context = browser.new_context(viewport={"width": width, "height": height}, **options)
        self.page = self.context.new_page()
        self.wrong = []
        host = f"127.0.0.1:{server.port}"
        self.page.on("pageerror", lambda error: self.wrong.append(f"error: {error}"))
        self.page.on("console", lambda line: line.type == "error" and self.wrong.append(f"console: {line.text}"))
        self.page.on("request", lambda request: request.url.split(":", 1)[0] in ("http", "https", "ws", "wss")
                     and host not in request.url and self.wrong.append(f"beyond the host: {request.url}"))
        if PAGE:
            self.page.route("**/*", self.from_page)
        # Playwright evaluates by `eval`, which the page's policy forbids; the debugger's protocol does not.
        self.debugger = self.context.new_cdp_session(self.page)
        self.page.goto(address or server.address)
        # The token is used up, and the page goes on without it.
        self.page.wait_for_url(lambda url: "token" not in url, timeout=PATIENCE)
        self.opened()

    @staticmethod
    def from_page(route):
        file = pathlib.Path(PAGE) / (route.request.url.rsplit("/", 1)[1].split("?")[0] or "index.html")
        if file.is_file() and "token" not in route.request.url:
            route.fulfill(path=file)
        else:
            route.continue_()

    def opened(self):
        """Waits for the scene, and unfolds all panels."""
        self.wait("window.rayset && window.rayset.view.scene")
        self.evaluate("for (const each of document.querySelectorAll('details')) each.open = true")

    def evaluate(self, expression):
        asked = {"expression": expression, "returnByValue": True, "awaitPromise": True}
        answer = self.debugger.send("Runtime.evaluate", asked)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait(self, condition):
        until = time.time() + PATIENCE / 1000
        while not self.evaluate(f"Boolean({condition})"):
            assert time.time() < until, f"not {condition}; the page says: {self.status()}"
            time.sleep(0.02)

    def converged(self):
        self.wait("rayset.view.isConverged")

    def pixels(self):
        """The exact bytes of the picture on the page, and its size."""
        self.converged()
        found = self.evaluate("""(() => {
            const { data, width, height } = rayset.view.pixels;
            let text = "";
            for (let i = 0; i < data.length; i += 32768) text += String.fromCharCode(...data.subarray(i, i + 32768));
            return { text: btoa(text), width, height };
        })()""")
        return base64.b64decode(found["text"]), (found["width"], found["height"])

    def camera(self):
        return self.evaluate("rayset.view.camera")

    def status(self):
        return self.evaluate("document.getElementById('status').textContent")

    def at(self, x, y):
        """A place of the picture, 0 to 1, in pixels of the page."""
        box = self.page.locator("#picture").bounding_box()
        return box["x"] + x * box["width"], box["y"] + y * box["height"]

    def shot(self, name):
        self.page.screenshot(path=SHOTS / f"{name}.png")

    def saved(self, folder):
        """The scene that the page saves, as a file."""
        with self.page.expect_download(timeout=PATIENCE) as download:
            self.page.get_by_role("button", name="Save scene").click()
        path = folder / "saved.json"
        download.value.save_as(path)
        return path

    def command(self):
        """The command that the page shows once its picture is complete, as words; whether options alone say what is seen."""
        self.converged()
        said = self.evaluate("rayset.view.command()")
        text = said or "rayset render scene.json -o picture.png"
        self.wait(f"document.querySelector('textarea').value === {json.dumps(text)}")
        return shlex.split(text), said is not None

    def is_what_render_makes(self, folder):
        pixels, size = self.pixels()
        scene = self.saved(folder)
        picture = folder / "rendered.png"
        subprocess.run([PROGRAM, "render", str(scene), "-o", str(picture)], check=True, capture_output=True)
        image = Image.open(picture).convert("RGBA")
        assert image.size == size, f"{image.size} rendered, {size} on the page"
        differ = sum(a != b for a, b in zip(image.tobytes(), pixels))
        assert differ == 0, f"{differ} bytes of the page differ from the rendered picture"

    def well(self):
        assert not self.wrong, "\n".join(self.wrong)


def drag(page, by, start=None, steps=12):
    box = page.locator("#picture").bounding_box()
    x, y = start or (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + by[0], y + by[1], steps=steps)
    page.mouse.up()


class Stranger:
    """A connection that speaks the protocol of sockets by itself, let in by an invitation."""

    def __init__(self, server, invitation):
        self.port = server.port
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)
        connection.request("GET", invitation[invitation.index("/?"):])
        cookie = connection.getresponse().getheader("Set-Cookie").split(";")[0]
        self.socket = socket.create_connection(("127.0.0.1", self.port), timeout=20)
        self.socket.sendall((
            f"GET /socket HTTP/1.1\r\nHost: 127.0.0.1:{self.port}\r\nOrigin: http://127.0.0.1:{self.port}\r\n"
            f"Cookie: {cookie}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n").encode())
        assert self.socket.recv(12) == b"HTTP/1.1 101"

    def send(self, payload, opcode=1, length=None):
        """A frame with a mask of zeros; `length` may lie."""
        length = len(payload) if length is None else length
        head = bytes([0x80 | opcode])
        if length < 126:
            head += bytes([0x80 | length])
        elif length < 1 << 16:
            head += bytes([0x80 | 126]) + length.to_bytes(2, "big")
        else:
            head += bytes([0x80 | 127]) + length.to_bytes(8, "big")
        self.socket.sendall(head + bytes(4) + payload)

    def is_closed(self, seconds=20):
        self.socket.settimeout(seconds)
        try:
            while self.socket.recv(1 << 16):
                pass
            return True
        except ConnectionError:
            return True
        except TimeoutError:
            return False
