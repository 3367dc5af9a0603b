"""The command line: parsing, exit status, and that help loads no slow modules."""

from __future__ import annotations

import errno
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from called import called, dofbench, imported_by

from dofbench import __version__
from dofbench.cli import app
from dofbench.cli.small_commands import Check, Methods, Scenes, Score
from dofbench.core.budget import Budget
from dofbench.core.errors import InputError

HEAVY = (
    "torch",
    "numba",
    "cv2",
    "OpenImageIO",
    "pycolmap",
    "matplotlib",
    "scipy",
    "skimage",
    "colour",
    "mitsuba",
    "flip_evaluator",
    "pandas",
)


def test_typical_calls_mean_what_they_say() -> None:
    scene = "../shared/data/llff_fern"
    made = app.parse(f"make-dataset {scene} --focus 0.2,0.5,0.8 --aperture 0.5,1.0 --out data/fern".split())
    assert (made.scenes, made.out) == ((scene,), Path("data/fern"))
    assert (made.focus, made.aperture) == ((0.2, 0.5, 0.8), (0.5, 1.0))

    run = app.parse("run --method dofgaussian --data data/fern --out results".split())
    (cell,) = run.cells()
    assert (cell.method, cell.data, cell.out) == ("dofgaussian", Path("data/fern"), Path("results"))
    assert app.parse(["run", "--method", "dofgaussian"]).data is None

    ablate = app.parse("ablate --data data/a,data/b --table table4,table5 --seeds 3 --budget 1500it --jobs 2".split())
    assert (ablate.folders, ablate.ids) == ((Path("data/a"), Path("data/b")), ("table4", "table5"))
    assert (ablate.seeds, ablate.budget, ablate.jobs) == (3, Budget(steps=1500), 2)

    report = app.parse("report results --out reports".split())
    assert (report.results, report.out) == (Path("results"), Path("reports"))
    assert app.parse(["report"]).results == Path("results")
    assert app.parse("report --reach psnr=30,delta_f=0.01".split()).levels == {"psnr": (30.0,), "delta_f": (0.01,)}

    assert app.parse(["score", "a", "b", "--metrics", "aif_gmsd"]) == Score((Path("a"), Path("b")), "aif_gmsd")
    assert app.parse(["score"]).results == (Path("results"),)
    assert app.parse(["check", "data/fern"]) == Check(Path("data/fern"))
    assert app.parse(["scenes"]) == Scenes()
    assert app.parse(["scenes", "a", "b"]) == Scenes((Path("a"), Path("b")))
    assert app.parse(["methods"]) == Methods() and app.parse(["methods", "a"]) == Methods("a")
    assert app.parse(["make-dataset"]).scenes == ()
    assert app.parse("make-dataset a b --jobs 2".split()).scenes == ("a", "b")


@pytest.mark.parametrize(
    "arguments",
    [
        "run --method",
        "make-dataset --seed x",
        "check a b",
    ],
)
def test_a_wrong_call_ends_with_2_and_says_so(arguments: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        app.main(arguments.split())
    printed = capsys.readouterr()
    assert end.value.code == 2
    assert printed.err.strip() and not printed.out


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        ("rnu --method a", "run"),
        ("run --metod a", "--method"),
        ("run --method dofgausian", "dofgaussian"),
        ("run --method dofgaussian --preset ppaer", "paper"),
        ("make-dataset llff/fren", "llff/fern"),
        ("score . --metrics pnsr", "psnr"),
        ("make-scene coridor", "corridor"),
        ("stability --group gradient", "gradients"),
    ],
)
def test_a_misspelt_name_is_answered_with_the_one_that_was_meant(
    arguments: str, meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert app.main(arguments.split()) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1 and f"did you mean {meant}" in line


@pytest.mark.parametrize(
    ("arguments", "missing"),
    [("run", "--method"), ("run --budget 3s", "--method"), ("check", "path"), ("make-scene", "recipe")],
)
def test_a_required_option_that_is_missing_is_named_in_one_line(
    arguments: str, missing: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert app.main(arguments.split()) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1 and line.startswith(f"dofbench: {missing}:")


@pytest.mark.parametrize(
    "arguments",
    [
        "",
        "frobnicate",
        "run --method a --bogus 1",
        "make-dataset --jobs 0",
        "make-dataset --shape round",
        "make-dataset --width 1",
        "make-dataset no/such/folder --out never",
        "make-dataset --focus 7 --out never",
        "make-dataset --aperture a,b",
        "make-dataset --depth guess",
        "run --method nobodys",
        "run --method dofgaussian --data no/such/folder",
        "run --method dofgaussian --budget lots",
        "ablate --data data/a --budget lots",
        "run --method dofgaussian --seeds 0",
        "run --method dofgaussian --jobs 0",
        "run --method dofgaussian, --seeds 2",
        "run --method dofgaussian,dofgaussian",
        "run --method dofgaussian --budget 60s 60.0s",
        "run --method dofgaussian --data a,b",
        "run --method dofgaussian --set sh_degree=3 --set steps=9",
        "ablate --data no/such/folder",
        "ablate --data a --seeds 0",
        "ablate --data a --tables none.toml",
        "report no/such/folder",
        "report --reach psnr=fast",
        "check no/such/folder",
        "score no/such/folder",
        "score . --metrics lpips",
        "scenes no/such/folder",
        "methods nobodys",
    ],
)
def test_a_wrong_input_is_one_line_with_what_was_expected(
    arguments: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert app.main(arguments.split()) == 2
    printed = capsys.readouterr()
    assert re.fullmatch(r"dofbench: .+: found .+, expected .+\n", printed.err)
    assert not printed.out
    assert not list(tmp_path.iterdir())


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert app.main(["--version"]) == 0
    assert capsys.readouterr().out == f"dofbench {__version__}\n"


@pytest.mark.parametrize(
    "command",
    ["make-dataset", "make-scene", "reconstruct", "run", "ablate", "score", "report", "check", "scenes", "methods"],
)
def test_help_names_every_option_with_a_sentence(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        app.main([command, "--help"])
    printed = capsys.readouterr().out
    assert end.value.code == 0
    # An option without a docstring has nothing but its default to say.
    assert not re.search(r"(STR|INT|FLOAT|PATH|\}|--[a-z-]+)\s*│?\s*│?\s*\((default|required)", printed)
    assert command in printed


# ---- how a command ends ----


def ending(monkeypatch: pytest.MonkeyPatch, outcome: Any) -> int:
    """Exit status of a command that returns `outcome`, or raises it."""

    def execute(settings: Any) -> int:
        if isinstance(outcome, BaseException):
            raise outcome
        return outcome

    monkeypatch.setattr(app, "execute", execute)
    return app.main(["scenes"])


@pytest.mark.parametrize(
    ("outcome", "status", "line"),
    [
        (0, 0, ""),
        (1, 1, ""),
        (InputError("a.json", "no\nnumber", "one"), 2, "dofbench: a.json: found no number, expected one\n"),
        (KeyboardInterrupt(), 130, "dofbench: interrupted; rerun the same command to resume\n"),
        (
            OSError(errno.ENOSPC, "No space left on device", "out"),
            1,
            "dofbench: out: No space left on device; finished work is kept\n",
        ),
        (
            PermissionError(errno.EACCES, "Permission denied", "out"),
            1,
            "dofbench: out: Permission denied; finished work is kept\n",
        ),
    ],
)
def test_ending(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], outcome: Any, status: int, line: str
) -> None:
    assert ending(monkeypatch, outcome) == status
    assert capsys.readouterr().err == line


@pytest.mark.parametrize("bug", [ValueError("shapes"), FileNotFoundError(errno.ENOENT, "no such file", "x")])
def test_a_bug_shows_its_traceback(monkeypatch: pytest.MonkeyPatch, bug: Exception) -> None:
    with pytest.raises(type(bug)):
        ending(monkeypatch, bug)


def test_sigterm_unwinds_the_command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    cleaned = []

    def execute(settings: Any) -> int:
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            raise AssertionError("the signal did not arrive")
        finally:
            cleaned.append(True)

    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr(app, "execute", execute)
    assert app.main(["scenes"]) == 128 + signal.SIGTERM
    assert cleaned == [True]
    assert signal.getsignal(signal.SIGTERM) is before
    assert capsys.readouterr().err.count("\n") == 1


def test_sigterm_unwinds_after_pycolmap_was_loaded() -> None:
    """Importing pycolmap takes SIGTERM over for the whole process: it printed a stack and died without clean-up."""
    script = (
        "import os, signal, sys; from dofbench.cli import app\n"
        "def execute(settings):\n"
        "    from dofbench.scenes.colmap_binding import pycolmap\n"
        "    try: os.kill(os.getpid(), signal.SIGTERM)\n"
        "    finally: print('cleaned up')\n"
        "app.execute = execute; sys.exit(app.main(['scenes']))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 128 + signal.SIGTERM
    assert done.stdout == "cleaned up\n"
    assert done.stderr == "dofbench: interrupted; rerun the same command to resume\n"


def test_a_reader_that_leaves_is_no_failure() -> None:
    """`dofbench scenes | head` must not end with an error message."""
    script = (
        "import sys; from dofbench.cli import app\n"
        "def execute(settings):\n"
        "    while True: print('line', flush=True)\n"
        "app.execute = execute; sys.exit(app.main(['scenes']))"
    )
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.readline()
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait() == 128 + signal.SIGPIPE


# ---- what help costs ----


@pytest.mark.parametrize("arguments", [[], ["--help"], ["run", "--help"], ["make-dataset", "--help"]], ids=" ".join)
def test_help_loads_nothing_heavy(arguments: list[str]) -> None:
    script = (
        "import dofbench.cli.app\n"
        f"try: dofbench.cli.app.main({arguments!r}) if {arguments!r} else None\n"
        "except SystemExit as end: assert end.code == 0"
    )
    assert not {*HEAVY} & imported_by(script)


def test_python_dash_m_is_the_command() -> None:
    assert called(dofbench("--version")).stdout == f"dofbench {__version__}\n"
