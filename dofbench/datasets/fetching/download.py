"""Downloads that resume, and the checksums that they are compared with."""

from __future__ import annotations

import http.client
import json
import time
import urllib.error
import urllib.request
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from dofbench.core.errors import one_line
from dofbench.core.files import read_json, sha256_file, write_json
from dofbench.core.progress import Progress
from dofbench.datasets.fetching.failure import FetchFailure
from dofbench.scenes.named import Archive

RECORD = "fetched.json"  # in the data root: what was downloaded, by address
ATTEMPTS = 3  # without a new byte
PAUSE = 2.0  # seconds before the second attempt; doubled for each further one
_TIMEOUT = 60.0  # seconds without an answer
_CHUNK = 1 << 20
_MEGA = 1e6
_BUSY = (408, 425, 429, 500, 502, 503, 504)  # HTTP statuses that may pass


@dataclass(frozen=True)
class Checksum:
    """The sha256 that a download must have; None for the first one of an archive whose checksum nobody published.

    published: stated by the manifest, as opposed to recorded by the first download.
    """

    sha256: str | None
    published: bool


def expected_checksum(archive: Archive, data_root: Path) -> Checksum:
    """The checksum that the manifest states, else the one of the first download to this data root."""
    if archive.sha256 is not None:
        return Checksum(archive.sha256, published=True)
    return Checksum(_records(data_root).get(archive.url, {}).get("sha256"), published=False)


def record_download(archive: Archive, file: Path, checksum: Checksum, data_root: Path) -> None:
    """Write address, sha256 and size of an archive that was unpacked to `RECORD` in the data root. checksum: with which
    it was downloaded."""
    records = _records(data_root)
    records[archive.url] = {
        "sha256": checksum.sha256 or sha256_file(file),
        "bytes": file.stat().st_size,
        "checksum": "published" if checksum.published else "of the first download, not published",
    }
    write_json(data_root / RECORD, records)


def download(archive: Archive, folder: Path, checksum: Checksum, progress: Progress) -> Path:
    """Download the archive into `folder`, or find it there; returns the file, whose checksum is the expected one.

    What an interrupted download left is continued, if the server still has the same file. Raises FetchFailure when the
    server can't be reached, refuses, or sends a file of another checksum, which is deleted.
    """
    import logging

    import pooch  # type: ignore[import-untyped]

    pooch.get_logger().setLevel(logging.WARNING)
    name = Path(urlsplit(archive.url).path).name
    transfer = _Transfer(folder / f"{name}.part", progress)
    known = None if checksum.sha256 is None else f"sha256:{checksum.sha256}"
    try:
        return Path(pooch.retrieve(archive.url, known_hash=known, fname=name, path=folder, downloader=transfer))
    except ValueError as error:
        if checksum.published:
            why = "its publisher's is"
        else:
            why = f"{RECORD} has that of the first download (delete its entry to accept the new file):"
        raise FetchFailure(f"{archive.url}: {_found(error)}, {why} {checksum.sha256}; deleted") from None
    finally:
        progress.close()


def _found(error: ValueError) -> str:
    words = str(error).replace(".", " ").split()
    hashes = [word for word in words if len(word) == 64]
    return f"sha256 {hashes[-1]}" if hashes else "another sha256"


class _Transfer:
    """A downloader for pooch: `part` grows over attempts and calls, and moves to its place when it is complete."""

    def __init__(self, part: Path, progress: Progress):
        self._part, self._progress = part, progress
        self._note = part.with_name(f"{part.name}.json")  # of which file on the server the part is

    def __call__(self, url: str, output_file: str, pooch: object) -> None:
        """Download `url` to `output_file`. Raises FetchFailure when it can't be reached, or refuses."""
        failed = 0
        while True:
            before = self._size()
            try:
                self._continue(url)
                break
            except urllib.error.HTTPError as error:
                if error.code == http.client.REQUESTED_RANGE_NOT_SATISFIABLE and before:
                    self._forget()  # the file on the server is shorter than the part
                    continue
                why = f"the server answers {error.code} {error.reason}"
                if error.code not in _BUSY:
                    raise FetchFailure(f"{url}: {why}") from None
            except (OSError, http.client.HTTPException) as error:
                if one_line(error):  # this machine's disk, not the network
                    raise
                why = str(getattr(error, "reason", None) or error or type(error).__name__)
            failed = 1 if self._size() > before else failed + 1
            if failed >= ATTEMPTS:
                kept = f"{self._size() / _MEGA:.0f} MB are kept; " if self._size() else ""
                raise FetchFailure(f"{url}: {why}; {kept}rerun the same command to resume")
            time.sleep(PAUSE * 2 ** (failed - 1))
        self._part.replace(output_file)
        self._note.unlink(missing_ok=True)

    def _continue(self, url: str) -> None:
        note = self._read_note(url)
        start = self._size() if note.get("validator") else 0
        if start and start == note.get("total"):
            return
        request = urllib.request.Request(url, headers={"User-Agent": "dofbench", "Accept-Encoding": "identity"})
        if start:
            # Without If-Range, a file that has changed meanwhile would be joined to the old one's beginning.
            request.add_header("Range", f"bytes={start}-")
            request.add_header("If-Range", note["validator"])
        with urllib.request.urlopen(request, timeout=_TIMEOUT) as answer:
            if answer.status != http.client.PARTIAL_CONTENT:
                start = 0
            length = answer.headers.get("Content-Length")
            total = start + int(length) if length else 0
            write_json(self._note, {"url": url, "validator": _validator(answer.headers), "total": total})
            with self._part.open("ab" if start else "wb") as stream:
                done = start
                self._show(done, total)
                while chunk := answer.read(_CHUNK):
                    stream.write(chunk)
                    done += len(chunk)
                    self._show(done, total)
        if total and done != total:
            raise ConnectionError(f"the connection ended after {done} of {total} bytes")

    def _show(self, done: int, total: int) -> None:
        self._progress.update("download (MB)", done / _MEGA, total / _MEGA)

    def _size(self) -> int:
        return self._part.stat().st_size if self._part.is_file() else 0

    def _forget(self) -> None:
        self._part.unlink(missing_ok=True)
        self._note.unlink(missing_ok=True)

    def _read_note(self, url: str) -> dict[str, Any]:
        with suppress(OSError, json.JSONDecodeError, UnicodeDecodeError):
            note = json.loads(self._note.read_text(encoding="utf-8"))
            if isinstance(note, dict) and note.get("url") == url:
                return note
        return {}


def _validator(headers: http.client.HTTPMessage) -> str | None:
    """What identifies the file on the server: its strong ETag, else its date; None where it can't be resumed."""
    tag = headers.get("ETag", "")
    return tag if tag.startswith('"') else headers.get("Last-Modified")


def _records(data_root: Path) -> dict[str, dict[str, Any]]:
    file = data_root / RECORD
    content = read_json(file) if file.is_file() else {}
    return content if isinstance(content, dict) else {}
