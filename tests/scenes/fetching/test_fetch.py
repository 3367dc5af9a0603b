"""`dofbench fetch` against a server on this machine: whole scenes where readers look, or none."""

from __future__ import annotations

import hashlib
import io
import shutil
import threading
import zipfile
from collections.abc import Callable, Iterator, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path, PurePosixPath

import numpy as np
import pytest

from dofbench.cli import app
from dofbench.core.errors import InputError
from dofbench.core.files import read_json
from dofbench.datasets.fetching import download as downloading
from dofbench.datasets.fetching import unpack as unpacking
from dofbench.datasets.fetching.fetch import DOWNLOADS
from dofbench.scenes.export import write_poses_bounds
from dofbench.scenes.named import library, named_datasets, resolve

VIEWS = 9


class Server:
    """Serves bytes by path. etag: sent with them; None for neither it nor ranges. drop: bytes after which each answer's
    connection ends. asked: the `Range` of every request, "" without one."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        self.etag: str | None = '"first"'
        self.drop: int | None = None
        self.asked: list[str] = []
        self.address = ""


@pytest.fixture
def server() -> Iterator[Server]:
    """A server on a free port of this machine."""
    state = Server()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            wanted = self.headers.get("Range", "")
            state.asked.append(wanted)
            content = state.files.get(self.path)
            if content is None:
                self.send_error(404)
                return
            start = 0
            if wanted and state.etag is not None and self.headers.get("If-Range") == state.etag:
                start = int(wanted.removeprefix("bytes=").removesuffix("-"))
            self.send_response(206 if start else 200)
            self.send_header("Content-Length", str(len(content) - start))
            if state.etag is not None:
                self.send_header("ETag", state.etag)
            self.end_headers()
            self.wfile.write(content[start:][: state.drop])

        def log_message(self, *_: object) -> None:
            """Tests print nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as http:
        state.address = f"http://127.0.0.1:{http.server_port}"
        thread = threading.Thread(target=http.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield state
        http.shutdown()
        thread.join()


@pytest.fixture(scope="module")
def scene_files(tmp_path_factory, make_cameras, write_images) -> dict[str, bytes]:
    """The files of an LLFF scene, by their path in it. They don't compress, so that a part of them is a part."""
    folder = tmp_path_factory.mktemp("scene")
    write_images(folder / "images", [f"{index:03d}.png" for index in range(VIEWS)], (24, 18))
    write_poses_bounds(folder / "poses_bounds.npy", make_cameras(VIEWS, size=(24, 18)), np.ones((VIEWS, 2)))
    (folder / "noise.bin").write_bytes(np.random.default_rng(0).bytes(60_000))
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def zipped(members: Mapping[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, content in members.items():
            archive.writestr(zipfile.ZipInfo(name), content)
    return stream.getvalue()


@pytest.fixture
def archive(server: Server, scene_files: dict[str, bytes]) -> bytes:
    """The archive that the server has: two scenes, and what macOS adds."""
    members = {f"small/{name}/{path}": content for name in ("one", "two") for path, content in scene_files.items()}
    server.files["/pub/small.zip"] = zipped({**members, "__MACOSX/small/one/._x": b"?"})
    return server.files["/pub/small.zip"]


@pytest.fixture
def state_dataset(
    server: Server, archive: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., None]:
    """`state_dataset(sha256=, url=)`: let the named datasets be `small`, with that archive, and two by hand."""
    monkeypatch.setattr(downloading, "PAUSE", 0.0)

    def write(sha256: str | None = hashlib.sha256(archive).hexdigest(), url: str = "/pub/small.zip") -> None:
        content = Path(tmp_path / "content" / str(len(list(tmp_path.glob("content/*")))))
        content.mkdir(parents=True)
        head = 'title = "Some"\norigin = "https://there"\nlicence = "CC BY 4.0"\nrole = "report"\n'
        (content / "small.toml").write_text(
            f'id = "small"\n{head}layout = "llff"\nhold = 3\nfolders = ["small/{{scene}}", "{{scene}}_small"]\n'
            f'[[archives]]\nurl = "{server.address}{url}"\nstated_by = "a test"\n'
            + (f'sha256 = "{sha256}"\n' if sha256 else "")
            + '[[scenes]]\nname = "one"\n[[scenes]]\nname = "two"\n'
        )
        (content / "drive.toml").write_text(
            f'id = "drive"\n{head}layout = "llff"\nfolders = ["drive/{{scene}}"]\n'
            'by_hand = "click on https://drive.there"\n[[scenes]]\nname = "two"\n[[scenes]]\nname = "three"\n'
        )
        monkeypatch.setattr(library, "content_folder", lambda name: content)

    write()
    return write


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """The data root, which isn't there yet."""
    return tmp_path / "data"


def fetch(root: Path, name: str = "small", *options: str) -> int:
    return app.main(["fetch", name, "--data-root", str(root), *options])


def seen(root: Path) -> list[str]:
    """The files that a reader could come upon."""
    files = (path.relative_to(root) for path in root.rglob("*") if path.is_file())
    return sorted(path.as_posix() for path in files if not path.parts[0].startswith("."))


def of_scenes(scene_files: Mapping[str, bytes], *names: str) -> list[str]:
    return sorted(["fetched.json", *(f"small/{name}/{path}" for name in names for path in scene_files)])


def test_a_fetched_dataset_is_read_by_its_names(state_dataset, server, archive, scene_files, root, capsys) -> None:
    assert fetch(root) == 0
    said = capsys.readouterr().out
    assert "CC BY 4.0" in said and "unverified" not in said and f"make-dataset small --data-root {root}" in said
    assert seen(root) == of_scenes(scene_files, "one", "two") and not (root / DOWNLOADS).exists()
    assert (root / "small" / "two" / "noise.bin").read_bytes() == scene_files["noise.bin"]
    (record,) = read_json(root / "fetched.json").values()
    assert record["sha256"] == hashlib.sha256(archive).hexdigest() and record["bytes"] == len(archive)
    for text in ("small/one", "one"):
        (scene,) = resolve(text, root)
        assert scene.label == "small/one" and len(scene.load().test_views()) == VIEWS // 3
    assert app.main(["scenes", "--data-root", str(root)]) == 0


def test_what_is_here_is_not_downloaded(state_dataset, server, root, scene_files) -> None:
    mine = root / "one_small"
    mine.mkdir(parents=True)
    assert fetch(root, "small/two") == 0 and len(server.asked) == 1
    assert seen(root) == of_scenes(scene_files, "two")
    for _ in range(2):
        assert fetch(root, "two") == 0
    assert len(server.asked) == 1 and not list(mine.iterdir())
    assert fetch(root) == 1, "one_small is no scene, and stays"
    assert len(server.asked) == 1 and not list(mine.iterdir())


def test_a_wrong_checksum_leaves_nothing(state_dataset, archive, root, capsys) -> None:
    state_dataset(sha256="0" * 64)
    assert fetch(root) == 1
    said = capsys.readouterr().err
    assert "0" * 64 in said and hashlib.sha256(archive).hexdigest() in said and len(said.splitlines()) < 4
    assert seen(root) == [] and not [path for path in root.rglob("*") if path.is_file()]
    state_dataset()
    assert fetch(root) == 0


def test_an_unpublished_checksum_is_that_of_the_first_download(
    state_dataset, server, archive, scene_files, root, capsys
) -> None:
    state_dataset(sha256=None)
    assert fetch(root) == 0 and "unverified" in capsys.readouterr().out
    shutil.rmtree(root / "small")
    assert fetch(root) == 0 and "unverified" in capsys.readouterr().out
    shutil.rmtree(root / "small")
    server.files["/pub/small.zip"] = archive + b"!"
    assert fetch(root) == 1 and "fetched.json" in capsys.readouterr().err
    assert seen(root) == ["fetched.json"]
    server.files["/pub/small.zip"] = archive
    assert fetch(root) == 0 and seen(root) == of_scenes(scene_files, "one", "two")


class TestInterrupted:
    """A connection that ends early, in this call or in an earlier one."""

    def test_it_continues_in_the_same_call(self, state_dataset, server, archive, scene_files, root) -> None:
        server.drop = step = len(archive) // 3 + 1
        assert fetch(root) == 0
        assert server.asked == ["", f"bytes={step}-", f"bytes={2 * step}-"]
        assert seen(root) == of_scenes(scene_files, "one", "two")

    def test_it_continues_in_a_later_call(self, state_dataset, server, archive, root, monkeypatch, capsys) -> None:
        with monkeypatch.context() as context:
            context.setattr(downloading, "ATTEMPTS", 1)
            server.drop = 1000
            assert fetch(root) == 1
        assert "rerun the same command" in capsys.readouterr().err and seen(root) == []
        server.drop = None
        assert fetch(root) == 0 and server.asked == ["", "bytes=1000-"]

    def test_it_starts_again_where_the_server_has_another_file(
        self, state_dataset, server, archive, scene_files, root, monkeypatch
    ) -> None:
        state_dataset(sha256=None)
        with monkeypatch.context() as context:
            context.setattr(downloading, "ATTEMPTS", 1)
            server.drop = 1000
            assert fetch(root) == 1
        server.drop, server.etag = None, '"second"'
        other = {f"small/{name}/{path}": content for name in ("one", "two") for path, content in scene_files.items()}
        other = {path: b"other" if path.endswith("noise.bin") else content for path, content in other.items()}
        server.files["/pub/small.zip"] = zipped(other)
        assert fetch(root) == 0
        assert (root / "small" / "one" / "noise.bin").read_bytes() == b"other"

    def test_it_starts_again_where_the_server_cannot_continue(
        self, state_dataset, server, archive, scene_files, root, monkeypatch
    ) -> None:
        server.etag = None
        with monkeypatch.context() as context:
            context.setattr(downloading, "ATTEMPTS", 1)
            server.drop = 1000
            assert fetch(root) == 1
        server.drop = None
        assert fetch(root) == 0 and server.asked == ["", ""]

    def test_it_gives_up_without_a_new_byte(self, state_dataset, server, root) -> None:
        server.drop = 0
        assert fetch(root) == 1 and len(server.asked) == downloading.ATTEMPTS

    def test_unpacking_leaves_whole_scenes_alone(self, state_dataset, server, scene_files, root, monkeypatch) -> None:
        write, written = unpacking._write, []

        def interrupted(opened: zipfile.ZipFile, info: zipfile.ZipInfo, target: Path) -> None:
            written.append(target)
            if len(written) > len(scene_files) + 2:  # within the second scene
                raise KeyboardInterrupt
            write(opened, info, target)

        with monkeypatch.context() as context:
            context.setattr(unpacking, "_write", interrupted)
            assert fetch(root) == 128 + 2
        assert seen(root) == [path for path in of_scenes(scene_files, "one") if path != "fetched.json"]
        assert fetch(root) == 0 and len(server.asked) == 1, "the archive is whole"
        assert seen(root) == of_scenes(scene_files, "one", "two")


@pytest.mark.parametrize(
    "member", ["../evil", "small/one/../../../evil", "/evil", "C:\\evil", "..\\evil", "small\\..\\..\\evil"]
)
def test_a_member_that_leads_out_unpacks_nothing(state_dataset, server, archive, root, member, capsys) -> None:
    stream = io.BytesIO(archive)
    with zipfile.ZipFile(stream, "a") as opened:
        opened.writestr(member, b"evil")
    server.files["/pub/small.zip"] = stream.getvalue()
    state_dataset(sha256=None)
    assert fetch(root) == 1 and "leads out" in capsys.readouterr().err
    assert not [path for path in root.parent.rglob("*") if "evil" in path.name]
    assert seen(root) == []


def test_a_link_unpacks_nothing(state_dataset, server, archive, root) -> None:
    stream, link = io.BytesIO(archive), zipfile.ZipInfo("small/one/images/link")
    link.external_attr = 0o120777 << 16
    with zipfile.ZipFile(stream, "a") as opened:
        opened.writestr(link, "/etc")
    server.files["/pub/small.zip"] = stream.getvalue()
    state_dataset(sha256=None)
    assert fetch(root) == 1 and seen(root) == []


def test_no_archive_and_a_scene_that_is_not_in_it(state_dataset, server, scene_files, root, capsys) -> None:
    state_dataset(sha256=None)
    server.files["/pub/small.zip"] = b"<html>log in first</html>"
    assert fetch(root) == 1 and "not a whole zip archive" in capsys.readouterr().err
    server.files["/pub/small.zip"] = zipped({f"small/one/{path}": content for path, content in scene_files.items()})
    assert fetch(root) == 1 and "no small/two in it" in capsys.readouterr().err
    assert seen(root) == []
    assert fetch(root, "small/one") == 0 and seen(root) == of_scenes(scene_files, "one")


def test_a_server_that_refuses_is_asked_once(state_dataset, server, root, capsys) -> None:
    state_dataset(url="/elsewhere.zip")
    assert fetch(root) == 1 and "404" in capsys.readouterr().err and len(server.asked) == 1


def test_a_full_disk_keeps_the_archive(state_dataset, server, root, monkeypatch, capsys) -> None:
    usage = shutil.disk_usage(root.parent)
    with monkeypatch.context() as context:
        context.setattr(shutil, "disk_usage", lambda path: usage._replace(free=1000))
        assert fetch(root) == 1 and "free" in capsys.readouterr().err
    assert seen(root) == [] and fetch(root) == 0 and len(server.asked) == 1


def test_a_kept_archive_is_not_downloaded_again(state_dataset, server, archive, root, scene_files) -> None:
    assert fetch(root, "small/one", "--keep-archive") == 0
    assert fetch(root, "small/two") == 0
    assert len(server.asked) == 1 and seen(root) == of_scenes(scene_files, "one", "two")
    assert not (root / DOWNLOADS).exists()


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("smal", "small"),
        ("smll/one", "small/one"),
        ("three", "https://drive.there"),
        ("drive", "https://drive.there"),
        ("two", "small/two"),
        ("drive/three", "drive/three in"),
    ],
)
def test_a_call_that_cannot_succeed_ends_at_once(state_dataset, server, root, capsys, name, said) -> None:
    assert fetch(root, name) == 2 and not server.asked
    error = capsys.readouterr().err
    assert said in error.partition("expected")[2] and len(error.splitlines()) == 1


def test_without_a_data_root(state_dataset, server, root, monkeypatch, capsys) -> None:
    monkeypatch.delenv("DOFBENCH_DATA", raising=False)
    assert app.main(["fetch", "small"]) == 2 and "DOFBENCH_DATA" in capsys.readouterr().err
    monkeypatch.setenv("DOFBENCH_DATA", str(root))
    assert app.main(["fetch", "small"]) == 0 and resolve("small/one", root)


def test_an_absent_scene_is_answered_with_the_command(state_dataset, root) -> None:
    root.mkdir()
    with pytest.raises(InputError, match="dofbench fetch small"):
        resolve("small/one", root)


@pytest.mark.parametrize("dataset", [one for one in named_datasets().values() if one.archives], ids=lambda one: one.id)
def test_the_archives_of_the_named_datasets_have_all_scenes(dataset) -> None:
    """Each scene is in one archive, unpacked to a place where it is looked for."""
    for scene in dataset.scenes:
        (archive,) = (one for one in dataset.archives if not one.scenes or scene.name in one.scenes)
        into = PurePosixPath(archive.into or ".")
        assert any(PurePosixPath(place).is_relative_to(into) for place in dataset.candidates(scene))
