"""`dofbench` as a user calls it, in a process of its own: to its end, or killed in the middle."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import pytest
from fake_method import write_method

from dofbench.core.content import content_folder
from dofbench.datasets.synthesis import make_dataset
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.evaluation.results.result import Result

PATIENCE = 600  # seconds, for a call on a busy machine, with kernels that must be compiled

TIMED = {"train_s", "train_cpu_s", "cold_start_s", "render_fps", "peak_mb"}


def dofbench(*words: object) -> list[str]:
    """The command."""
    return [sys.executable, "-m", "dofbench", *map(str, words)]


def called(command: Sequence[str], **environment: str) -> subprocess.CompletedProcess[str]:
    """The command, run to its end. environment: variables that it has besides this process's."""
    return subprocess.run(
        command, capture_output=True, text=True, timeout=PATIENCE, env={**os.environ, **environment}, check=False
    )


def holding(imports: str, context: str) -> subprocess.Popen[str]:
    """A process of its own that is inside the context manager of this expression until its input ends."""
    code = f"import sys\n{imports}\nwith {context}:\n    print('held', flush=True)\n    sys.stdin.read()"
    other = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert other.stdout is not None and other.stdout.readline() == "held\n"
    return other


def imported_by(code: str) -> set[str]:
    """The modules that are loaded after this Python code, in a process of its own."""
    done = called([sys.executable, "-c", f"{code}\nimport sys\nprint(*sys.modules)"])
    assert done.returncode == 0, done.stderr
    return set(done.stdout.splitlines()[-1].split())


def killed(
    command: Sequence[str],
    when: Callable[[], bool],
    *,
    number: signal.Signals = signal.SIGKILL,
    delay: float = 0.0,
    environment: Mapping[str, str] | None = None,
) -> subprocess.CompletedProcess[str]:
    """The command, sent a signal as soon as `when()` says so, or ended by itself before that.

    delay: seconds more until the signal. The exit status is minus the signal's number where that ended the process.
    """
    with tempfile.TemporaryFile("w+") as said:  # a pipe that nobody reads would hold the process up once it is full
        process = subprocess.Popen(
            command, stdout=said, stderr=subprocess.STDOUT, env={**os.environ, **(environment or {})}
        )
        try:
            limit = time.monotonic() + PATIENCE
            while not when() and process.poll() is None:
                assert time.monotonic() < limit, "not there in time"
                time.sleep(0.002)
            time.sleep(delay)
            process.send_signal(number)
            status = process.wait(PATIENCE)
        finally:
            process.kill()
            process.wait()
        said.seek(0)
        return subprocess.CompletedProcess(command, status, said.read())


def timeless(result: Result) -> list:
    """All that a result says but times, memory and where it was made."""
    return [
        result.spec,
        {column: value for column, value in result.scores.items() if column not in TIMED},
        result.views,
        result.lens,
        [(point.steps, point.loss, point.scores) for point in result.curve],
        result.description,
        result.do_nothing,
        result.predictions,
        result.model,
    ]


def fake_method_and_data(
    folder: Path, monkeypatch: pytest.MonkeyPatch, width: int, code: str = "", name: str = "Fake"
) -> Path:
    """A small dataset in `folder`/data, and for called commands the method `fake`, which costs nothing: its folder.

    code: added to the method's. name: of the method's class in it.
    """
    foliage = content_folder("datasets") / "thinlens" / "foliage"
    make_dataset(MakeDataset(scene=str(foliage), width=width, out=folder / "data"))
    methods = write_method(folder / "methods")
    monkeypatch.setenv("DOFBENCH_METHODS", str(methods))
    # The fake method is written with the help of this folder.
    path = [str(Path(__file__).parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path))
    trainer, card = methods / "fake" / "trainer.py", methods / "fake" / "method.toml"
    trainer.write_text(trainer.read_text() + code)
    card.write_text(card.read_text().replace("trainer:Fake", f"trainer:{name}"))
    return methods / "fake"
