"""A small S3 on a socket of this machine, that fails when it is told to. Also ``python -m tests.s3
--port 9000``.

It knows one bucket, and of S3 what isogi asks of it: objects with entity tags, conditional reads
and writes, ranges, listing page by page, deletion one by one and many at once. It looks at the
access key and not at the signature.
"""

import argparse
import hashlib
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from email.utils import formatdate
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from typing import Literal
from urllib.parse import parse_qs, unquote, urlsplit
from uuid import uuid4
from xml.etree import ElementTree
from xml.sax.saxutils import escape

BUCKET = "isogi"
ACCESS_KEY = "AKIAISOGITESTS"
SECRET_KEY = "a-secret-that-nobody-may-tell"
MOST_LISTED = 1000
"""Keys in one page of a listing, at most."""

Fault = int | Literal["hang", "short", "drop", "lost", "flip", "no-bucket"]
"""What becomes of a call: a status that is answered and nothing done; ``hang``: no answer until the
server closes; ``short``: half of the body, and the connection ends; ``drop``: the connection ends
and nothing is done; ``lost``: what was asked is done, and the connection ends without an answer;
``flip``: a bit in the middle of the answer's body is another; ``no-bucket``: as if there were no
bucket."""


def environment_of(endpoint: str) -> dict[str, str]:
    """Variables with which clients find an S3 at an address, and are let in."""
    return {
        "AWS_ACCESS_KEY_ID": ACCESS_KEY,
        "AWS_SECRET_ACCESS_KEY": SECRET_KEY,
        "AWS_ENDPOINT_URL": endpoint,
        "AWS_ALLOW_HTTP": "true",
        "AWS_REGION": "us-east-1",
    }


@dataclass(frozen=True)
class Call:
    """One request: its ``number`` from 1, its method, the key in the bucket (empty for the bucket
    itself), its query.

    ``condition`` is what If-Match or If-None-Match says, empty where there is neither.
    """

    number: int
    method: str
    key: str
    query: str
    condition: str


class S3Server:
    """An S3 while the ``with`` block runs: ``url`` of a place in it, ``environment`` that leads
    there.

    ``objects`` are the bytes by key (``prefix``/…), free to be changed; ``calls`` all requests so
    far, and ``sent`` the bytes of the answers' bodies; ``fault`` is asked before each call what
    shall become of it, None for what is usual.
    """

    def __init__(self, port: int = 0) -> None:
        self.prefix = f"light-{uuid4().hex[:12]}"
        self.objects: dict[str, bytes] = {}
        self.calls: list[Call] = []
        self.sent = 0
        self.fault: Callable[[Call], Fault | None] = lambda _: None
        self.lock = threading.Lock()
        self.closing = threading.Event()
        self._server = Listener(("127.0.0.1", port), Handler)
        self._server.s3 = self

    def __enter__(self) -> "S3Server":
        self._thread = threading.Thread(
            target=self._server.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True
        )
        self._thread.start()
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self.closing.set()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    @property
    def url(self) -> str:
        """A place for light in the bucket; no other server has the same."""
        return f"s3://{BUCKET}/{self.prefix}"

    @property
    def endpoint(self) -> str:
        """The address of the server."""
        return f"http://127.0.0.1:{self._server.server_address[1]}"

    @property
    def environment(self) -> dict[str, str]:
        """Variables with which clients find the server, and are let in."""
        return environment_of(self.endpoint)

    def began(self, method: str, key: str, query: str, condition: str) -> Fault | None:
        """Note a call; what shall become of it."""
        with self.lock:
            call = Call(len(self.calls) + 1, method, key, query, condition)
            self.calls.append(call)
        return self.fault(call)


class Listener(ThreadingHTTPServer):
    """Takes connections, one thread each."""

    daemon_threads = True
    block_on_close = False
    request_queue_size = 128
    s3: S3Server

    def handle_error(self, request: object, client_address: object) -> None:
        """Clients may leave; that is no news."""


class Handler(BaseHTTPRequestHandler):
    """Answers the requests of one connection."""

    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True
    wbufsize = -1
    short = lost = flip = False
    server: Listener

    def log_message(self, format: str, *args: object) -> None:
        """Nothing: ``calls`` tell."""

    def do_GET(self) -> None:
        self.work()

    do_HEAD = do_PUT = do_DELETE = do_POST = do_GET

    def work(self) -> None:
        """Read the request, and answer it or fail as told."""
        s3 = self.server.s3
        parts = urlsplit(self.path)
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        bucket, _, key = unquote(parts.path).lstrip("/").partition("/")
        condition = self.headers.get("If-Match") or self.headers.get("If-None-Match") or ""
        fault = s3.began(self.command, key, parts.query, condition)
        self.short = fault == "short"
        self.lost = fault == "lost"
        self.flip = fault == "flip"
        if fault == "hang":
            s3.closing.wait()
        if fault in ("hang", "drop"):
            self.close_connection = True
            return
        if f"Credential={ACCESS_KEY}/" not in self.headers.get("Authorization", ""):
            return self.refuse(403, "InvalidAccessKeyId")
        if bucket != BUCKET or fault == "no-bucket":
            return self.refuse(404, "NoSuchBucket")
        if isinstance(fault, int):
            return self.refuse(fault, "Told")
        with s3.lock:
            answer = self.answer(key, parse_qs(parts.query, keep_blank_values=True), body)
        self.say(*answer)

    def answer(
        self, key: str, query: dict[str, list[str]], body: bytes
    ) -> tuple[int, bytes, dict[str, str]]:
        """Status, body and headers of what was asked; the caller holds the lock."""
        objects = self.server.s3.objects
        if not key and self.command == "GET":
            return 200, listing(objects, {name: values[0] for name, values in query.items()}), XML
        if not key and self.command == "POST" and "delete" in query:
            return self.delete_many(body)
        if self.command == "PUT":
            if "x-amz-copy-source" in self.headers:
                return self.copy(key)
            return self.put(key, body)
        if self.command == "DELETE":
            objects.pop(key, None)
            return 204, b"", {}
        if not key:
            return 200, b"", {}
        return self.get(key)

    def get(self, key: str) -> tuple[int, bytes, dict[str, str]]:
        """An object, whole or a range of it, where the conditions hold."""
        data = self.server.s3.objects.get(key)
        if data is None:
            return failure(404, "NoSuchKey")
        headers = {
            "ETag": tag(data),
            "Last-Modified": formatdate(time.time(), usegmt=True),
            "Accept-Ranges": "bytes",
        }
        if self.headers.get("If-Match", tag(data)) not in (tag(data), "*"):
            return failure(412, "PreconditionFailed")
        if self.headers.get("If-None-Match") in (tag(data), "*"):
            return 304, b"", headers
        if "Range" not in self.headers:
            return 200, data, headers
        first, last = span(self.headers["Range"], len(data))
        headers["Content-Range"] = f"bytes {first}-{last - 1}/{len(data)}"
        return 206, data[first:last], headers

    def put(self, key: str, body: bytes) -> tuple[int, bytes, dict[str, str]]:
        """Keep an object where the conditions hold."""
        objects = self.server.s3.objects
        wanted = self.headers.get("If-Match")
        if self.headers.get("If-None-Match") == "*" and key in objects:
            return failure(412, "PreconditionFailed")
        if wanted is not None and key not in objects:
            return failure(404, "NoSuchKey")
        if wanted is not None and wanted != tag(objects[key]):
            return failure(412, "PreconditionFailed")
        objects[key] = body
        return 200, b"", {"ETag": tag(body)}

    def copy(self, key: str) -> tuple[int, bytes, dict[str, str]]:
        """Keep the object that a header names under this key, too."""
        objects = self.server.s3.objects
        source = unquote(self.headers["x-amz-copy-source"]).lstrip("/").partition("/")[2]
        if source not in objects:
            return failure(404, "NoSuchKey")
        objects[key] = objects[source]
        return (
            200,
            f"<CopyObjectResult><ETag>{escape(tag(objects[key]))}</ETag></CopyObjectResult>".encode(),
            XML,
        )

    def delete_many(self, body: bytes) -> tuple[int, bytes, dict[str, str]]:
        """Delete the keys that a document names."""
        keys = [
            each.text or ""
            for each in ElementTree.fromstring(body).iter()
            if each.tag.rpartition("}")[2] == "Key"
        ]
        for key in keys:
            self.server.s3.objects.pop(key, None)
        rows = "".join(f"<Deleted><Key>{escape(key)}</Key></Deleted>" for key in keys)
        return 200, f"<DeleteResult>{rows}</DeleteResult>".encode(), XML

    def refuse(self, status: int, code: str) -> None:
        """Answer with an error."""
        self.lost = False
        self.say(*failure(status, code))

    def say(self, status: int, body: bytes, headers: dict[str, str]) -> None:
        """Send an answer, or as much of it as the fault leaves."""
        if self.lost:
            self.close_connection = True
            return
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        if status not in (204, 304):
            self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.command != "HEAD" and status != 304:
            self.server.s3.sent += len(body)
            if self.flip and body:
                middle = len(body) // 2
                body = body[:middle] + bytes([body[middle] ^ 1]) + body[middle + 1 :]
            self.wfile.write(body[: len(body) // 2] if self.short else body)
        self.close_connection = self.close_connection or self.short


XML = {"Content-Type": "application/xml"}


def tag(data: bytes) -> str:
    """The entity tag of an object."""
    return f'"{hashlib.md5(data).hexdigest()}"'


def failure(status: int, code: str) -> tuple[int, bytes, dict[str, str]]:
    """An error as S3 tells it."""
    return status, f"<Error><Code>{code}</Code><Message>{code}</Message></Error>".encode(), XML


def span(header: str, size: int) -> tuple[int, int]:
    """First and end of a Range of ``size`` bytes."""
    first, _, last = header.removeprefix("bytes=").partition("-")
    if not first:
        return max(size - int(last), 0), size
    return int(first), min(int(last) + 1, size) if last else size


def listing(objects: dict[str, bytes], query: dict[str, str]) -> bytes:
    """One page of ListObjectsV2."""
    prefix = query.get("prefix", "")
    delimiter = query.get("delimiter", "")
    after = query.get("continuation-token") or query.get("start-after", "")
    most = min(int(query.get("max-keys", MOST_LISTED)), MOST_LISTED)
    names: dict[str, int | None] = {}
    for key, data in sorted(objects.items()):
        if key.startswith(prefix):
            if delimiter:
                folder, found, _ = key[len(prefix) :].partition(delimiter)
            else:
                folder = ""
                found = ""
                _ = ""
            names[prefix + folder + delimiter if found else key] = None if found else len(data)
    rest = [name for name in names if name > after]
    rows = "".join(row(name, names[name], objects) for name in rest[:most])
    if len(rest) > most:
        more = f"<NextContinuationToken>{escape(rest[most - 1])}</NextContinuationToken>"
    else:
        more = ""
    truncated = str(len(rest) > most).lower()
    inside = f"<IsTruncated>{truncated}</IsTruncated>{more}{rows}"
    return f"<ListBucketResult>{inside}</ListBucketResult>".encode()


def row(name: str, size: int | None, objects: dict[str, bytes]) -> str:
    """An object, or a folder, in a listing."""
    if size is None:
        return f"<CommonPrefixes><Prefix>{escape(name)}</Prefix></CommonPrefixes>"
    facts = "<LastModified>2026-01-01T00:00:00.000Z</LastModified>"
    facts += f"<ETag>{escape(tag(objects[name]))}</ETag>"
    return f"<Contents><Key>{escape(name)}</Key>{facts}<Size>{size}</Size></Contents>"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--port", type=int, default=9000, help="0 takes a free one")
    with S3Server(parser.parse_args().port) as s3:
        for name, value in s3.environment.items():
            print(f"export {name}={value}")  # noqa: T201
        print(f"isogi serve --store {s3.url}", flush=True)  # noqa: T201
        try:
            threading.Event().wait()
        except KeyboardInterrupt:
            return


if __name__ == "__main__":
    main()
