"""A receiver of webhooks, run as a program of its own: PORT HABIT FILE.

It appends what it receives to the file, a line of JSON each, and answers as its habit is.
"""

from __future__ import annotations

import json
import sys
import time
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

PORT, HABIT, FILE = int(sys.argv[1]), sys.argv[2], sys.argv[3]


class Handler(BaseHTTPRequestHandler):
    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"])).decode()
        said = {"path": self.path, "body": body, "signature": self.headers["E3pose-Signature"]}
        with open(FILE, "a") as file:
            file.write(json.dumps(said) + "\n")
        if HABIT == "hangs":
            time.sleep(60)
        elif HABIT == "drips":  # an answer that comes byte by byte, and never in full
            with suppress(OSError):
                while True:
                    self.wfile.write(b"H")
                    time.sleep(0.1)
        elif HABIT == "slow":
            time.sleep(0.7)
        status = {"fails": 503, "redirects": 307, "refuses": 404}.get(HABIT, 200)
        if HABIT == "hates-waves" and json.loads(body)["kind"] == "waved":
            status = 500
        self.send_response(status)
        if HABIT == "redirects":
            self.send_header("Location", f"http://127.0.0.1:{PORT}/elsewhere")
        self.end_headers()
        if HABIT == "talks":  # an answer that never ends
            with suppress(OSError):
                while True:
                    self.wfile.write(bytes(65536))

    def log_message(self, format: str, *args: object) -> None:
        pass


ThreadingHTTPServer(("127.0.0.1", PORT), Handler).serve_forever()
