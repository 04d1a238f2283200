#!/usr/bin/env bash
# fsspec 2026.9.0 (HTTP): a file whose server answers 503, 429, 403 or not at all is not missing, but 'exists' and 'glob' say that it is.
#
# HTTPFileSystem.exists takes every status of 400 and more, and every error of the connection, for False, without a word; glob of a name
# without wildcards asks exists, and is empty then; info turns all of it into FileNotFoundError. So a program that skips what does not
# exist, or reads all that matches, goes on without data that are there when a server is busy for a moment. pathlib's exists raises for
# all but "there is none". To read (cat_file, open) raises the true error here, too, and so does glob with a wildcard, which lists.
#
# Seen (fsspec 2026.9.0, aiohttp 3.14.5, Python 3.11): as above, against a server of Python's own on the loopback.
# This script exits with 0 as long as that is so, and with 1 when it changes.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check fsspec==2026.9.0 aiohttp==3.14.5

"$folder/venv/bin/python" - <<'PYTHON'
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import fsspec


class Moody(BaseHTTPRequestHandler):
    answers = 200

    def do_GET(self):
        body = b"rows" if self.answers == 200 else b""
        self.send_response(self.answers)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(body)

    do_HEAD = do_GET

    def log_message(self, *_):
        pass


def raised(question):
    try:
        return repr(question())
    except Exception as error:
        return type(error).__name__


server = ThreadingHTTPServer(("127.0.0.1", 0), Moody)
threading.Thread(target=server.serve_forever, daemon=True).start()
address = f"http://127.0.0.1:{server.server_port}/table.csv"
store = fsspec.filesystem("http", use_listings_cache=False)
seen = {}
for status in (200, 503, 429, 403):
    Moody.answers = status
    seen[status] = (store.exists(address), len(store.glob(address)), raised(lambda: store.info(address)["name"] == address),
                    raised(lambda: store.cat_file(address)))  # fmt: skip
server.shutdown()
server.server_close()
seen["down"] = (store.exists(address), len(store.glob(address)), raised(lambda: store.info(address)),
                raised(lambda: store.cat_file(address)))  # fmt: skip
for status, (exists, matches, info, read) in seen.items():
    print(f"{status}: exists {exists}, glob finds {matches}, info {info}, to read it {read}")
silent = [seen[each][:3] == (False, 0, "FileNotFoundError") for each in (503, 429, 403, "down")]
loud = [seen[each][3] for each in (503, 429, 403, "down")]
as_described = seen[200] == (True, 1, "True", "b'rows'") and all(silent)
sys.exit(0 if as_described and loud == ["ClientResponseError"] * 3 + ["ClientConnectorError"] else 1)
PYTHON
