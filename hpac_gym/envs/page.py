"""`render_mode="human"`: images on a web page, which needs neither a local display nor another
package.
"""

import struct
import sys
import time
import zlib
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Condition, Thread

import numpy as np
from numpy.typing import NDArray

from hpac_gym.tasks.task import CONTROL_HZ

_HTML = b'<!doctype html><title>hpac_gym</title><body style="margin:0;background:#222"><img src="stream" style="height:100vh">'
_PART = b"--picture\r\nContent-Type: image/png\r\nContent-Length: %d\r\n\r\n%s\r\n"


class Page:
    """A web server on localhost, at a free port, that shows the latest image; its address is
    printed once.

    A browser elsewhere reaches it through `ssh -L PORT:127.0.0.1:PORT`.

    Attributes:
        address: URL of the page.
    """

    def __init__(self) -> None:
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), _Handler)
        self._server.daemon_threads = True
        self._server.shown = Condition()
        self._server.picture = b""
        self.address = f"http://127.0.0.1:{self._server.server_address[1]}/"
        self._due = 0.0
        Thread(target=self._server.serve_forever, args=(0.1,), daemon=True).start()
        print(f"hpac_gym: pictures at {self.address}", file=sys.stderr, flush=True)

    def show(self, picture: NDArray[np.uint8]) -> None:
        """Show a picture, shape (height, width, 3), one control period after the last one at the
        earliest.
        """
        time.sleep(max(self._due - time.monotonic(), 0.0))
        self._due = time.monotonic() + 1 / CONTROL_HZ
        with self._server.shown:
            self._server.picture = png(picture)
            self._server.shown.notify_all()

    def close(self) -> None:
        """Stop the server; open pages keep their last image."""
        with self._server.shown:
            self._server.picture = None
            self._server.shown.notify_all()
        self._server.shutdown()
        self._server.server_close()


class _Handler(BaseHTTPRequestHandler):
    """Serves the page at `/`, and images at `/stream` until either side closes the connection."""

    def do_GET(self) -> None:
        if self.path not in ("/", "/stream"):
            self.send_error(404)
            return
        self.send_response(200)
        stream = self.path == "/stream"
        self.send_header(
            "Content-Type", "multipart/x-mixed-replace; boundary=picture" if stream else "text/html"
        )
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        with suppress(OSError):  # the browser has disconnected
            self._send_pictures() if stream else self.wfile.write(_HTML)

    def _send_pictures(self) -> None:
        last = b""
        while True:
            with self.server.shown:
                while self.server.picture is last:
                    self.server.shown.wait()
                last = self.server.picture
            if last is None:
                return
            # Sent twice: browsers display a part only when the next one begins.
            self.wfile.write(2 * (_PART % (len(last), last)))

    def log_message(self, *_: object) -> None:
        """Suppress the log of requests."""


def png(picture: NDArray[np.uint8]) -> bytes:
    """PNG file of an image, shape (height, width, 3), compressed for speed rather than size."""
    height, width, _ = picture.shape
    # A row begins with its filter.
    rows = np.concatenate([np.zeros((height, 1), np.uint8), picture.reshape(height, -1)], axis=1)

    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + chunk(b"IDAT", zlib.compress(rows.tobytes(), 1))
        + chunk(b"IEND", b"")
    )
