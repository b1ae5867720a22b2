"""A web server of the files of a folder, by ranges, with entity tags."""
import http.server
import pathlib
import re

from local import Local


class RangeServer(Local):
    def __init__(self, folder):
        folder = pathlib.Path(folder).resolve()

        class Handler(http.server.BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_HEAD(self):
                self.answer()

            def do_GET(self):
                self.answer()

            def answer(self):
                path = folder / self.path.lstrip("/")
                if not path.is_file():
                    return self.send_error(404)
                content = path.read_bytes()
                asked = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("Range", ""))
                first, last = (int(asked[1]), int(asked[2])) if asked else (0, len(content) - 1)
                part = content[first:last + 1]
                self.send_response(206 if asked else 200)
                if asked:
                    self.send_header("Content-Range", f"bytes {first}-{first + len(part) - 1}/{len(content)}")
                self.send_header("ETag", f'"{path.stat().st_mtime_ns:x}-{len(content):x}"')
                self.send_header("Accept-Ranges", "bytes")
                self.send_header("Content-Length", str(len(part)))
                self.end_headers()
                if self.command == "GET":
                    self.wfile.write(part)

            def log_message(self, *_):
                pass

        super().__init__(Handler)
