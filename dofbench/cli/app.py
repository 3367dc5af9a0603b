"""The command line. Options and their help are declared in the settings classes alone.

Exit status: 0 done, 1 something failed (each failure is named), 2 the call is wrong, 3 `check` found nothing wrong but
couldn't compute scores again, 128 + n ended by signal n. Modules that are slow to import are loaded only once the
command is known, so that help appears at once.
"""

from __future__ import annotations

import io
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, Union

import tyro

from dofbench import __version__
from dofbench.cli.methods_options import Methods
from dofbench.core.clock import loading
from dofbench.core.errors import InputError, interruption, one_line, out_of_memory
from dofbench.datasets.synthesis.dataset_options import MakeDatasets
from dofbench.evaluation.renderer.validation_options import ValidateRenderer
from dofbench.evaluation.stability.stability_options import Stability
from dofbench.reporting.report_options import Report
from dofbench.running.ablation_options import Ablate
from dofbench.running.run_options import Runs
from dofbench.runtime.supervised import Repeats, in_child
from dofbench.runtime.threads import configure_threads
from dofbench.scenes.procedural.scene_options import MakeScene
from dofbench.scenes.reconstruction.reconstruct_options import Reconstruct

DONE, FAILED, WRONG_CALL, NOT_RECOMPUTED = 0, 1, 2, 3
_INTERRUPTED = "interrupted; the same command goes on from what is finished"

_DESCRIPTION = (
    "Make shallow depth-of-field datasets whose lens is known, train methods on them, and compare the methods. "
    "Help on one command: dofbench COMMAND --help. The version: dofbench --version."
)


@dataclass(frozen=True)
class Scenes:
    """List the scenes that make-dataset can read: built-in, named datasets, and those in the folders given."""

    folders: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """Folders that are scenes or hold scenes."""

    data_root: Path | None = None
    """Folder to look for named datasets in; without it, the one in DOFBENCH_DATA, if that is set."""


@dataclass(frozen=True)
class Check:
    """Check a dataset or results: digests, checksums, protocol, whether all parts agree, and scores computed again."""

    path: Annotated[Path, tyro.conf.Positional]
    """Dataset folder, result folder, or a folder of results."""

    data: Path | None = None
    """The dataset's folder, to compute scores again, if it isn't where the results say. Without it: status 3."""


@dataclass(frozen=True)
class Score:
    """Score finished runs again, without training, from the pictures and the model that they stored, and add missing
    metrics in a file of its own (added.json). Scores that a result already has must come out the same again."""

    results: Annotated[tuple[Path, ...], tyro.conf.Positional] = (Path("results"),)
    """Results, or folders of results."""

    metrics: str | None = None
    """Columns, comma-separated: psnr for refocused views, aif_psnr for all-in-focus ones. Default: all there are."""

    data: Path | None = None
    """The dataset's folder, if it isn't where the results say."""


class Interrupted(KeyboardInterrupt):
    """A signal asked the process to end; `number` is the signal's."""

    def __init__(self, number: int):
        self.number = number
        super().__init__(number)


_repeats = Repeats()


def _interrupt(number: int, frame: FrameType | None) -> None:
    if not _repeats(number):
        raise Interrupted(number)


Command = (
    MakeDatasets
    | MakeScene
    | Reconstruct
    | Runs
    | Ablate
    | Score
    | Report
    | Check
    | Scenes
    | Methods
    | ValidateRenderer
    | Stability
)


def parse(arguments: Sequence[str]) -> Command:
    """The settings that the command line gives. Raises InputError, or SystemExit after printing help or an error."""
    commands = {
        "make-dataset": MakeDatasets,
        "make-scene": MakeScene,
        "reconstruct": Reconstruct,
        "run": Runs,
        "ablate": Ablate,
        "score": Score,
        "report": Report,
        "check": Check,
        "scenes": Scenes,
        "methods": Methods,
        "validate-renderer": ValidateRenderer,
        "stability": Stability,
    }
    named = tuple(Annotated[settings, tyro.conf.subcommand(name)] for name, settings in commands.items())
    look = (tyro.conf.DisallowNone, tyro.conf.FlagCreatePairsOff, tyro.conf.PositionalMetavarFromFieldName)
    _refuse_twice(arguments)
    with _input_errors_unframed():
        return tyro.cli(  # type: ignore[call-overload]  # of alternatives that no checker can know
            Union[named],  # noqa: UP007 - the alternatives are known only here
            prog="dofbench",
            description=_DESCRIPTION,
            args=list(arguments),
            config=look,
        )


def _refuse_twice(arguments: Sequence[str]) -> None:
    """Raise InputError for an option that is given twice: the parser would silently ignore its first values."""
    seen: set[str] = set()
    for word in arguments:
        option = word.partition("=")[0].replace("_", "-")
        if word.startswith("--") and option in seen:
            raise InputError(option, "the option twice", "once, with all its values behind it: --set a=1 b=2")
        seen.add(option)


def execute(settings: Any) -> int:
    """Do what the settings ask for and return the exit status. Raises InputError for a wrong input."""
    match settings:
        case MakeDatasets():
            from dofbench.datasets.synthesis import make_datasets

            return DONE if make_datasets(settings) else FAILED
        case MakeScene():
            from dofbench.scenes.procedural import make_scene

            make_scene(settings)
            return DONE
        case Reconstruct():
            from dofbench.scenes.reconstruction import reconstruct

            return DONE if reconstruct(settings) else FAILED
        case Runs():
            with loading.running():
                from dofbench.cli.run_methods import run_methods

            return DONE if run_methods(settings) else FAILED
        case Ablate():
            from dofbench.cli.ablate import make_tables

            return DONE if make_tables(settings) else FAILED
        case Score():
            from dofbench.running.rescore import score

            return DONE if score(settings.results, settings.metrics, settings.data) else FAILED
        case Report():
            from dofbench.reporting import report

            return DONE if report(settings) else FAILED
        case Check():
            from dofbench.cli.check import Verdict, check

            verdict = check(settings.path, data=settings.data)
            return {Verdict.GOOD: DONE, Verdict.NOT_RECOMPUTED: NOT_RECOMPUTED}.get(verdict, FAILED)
        case Scenes():
            from dofbench.scenes.listing import print_scenes

            return DONE if print_scenes(settings.folders, settings.data_root) else FAILED
        case Methods():
            if settings.method is not None and settings.freeze is not None:
                from dofbench.cli.freeze_preset import freeze_preset

                freeze_preset(settings.method, settings.freeze)
                return DONE
            from dofbench.cli.list_methods import print_methods

            return DONE if print_methods(settings.method) else FAILED
        case ValidateRenderer():
            from dofbench.evaluation.renderer.validate import validate_renderer

            validate_renderer(settings)
            return DONE
        case Stability():
            from dofbench.evaluation.stability.measure import stability

            return DONE if stability(settings) else FAILED
    raise AssertionError(f"no command for {type(settings).__name__}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command line (default: this process's) and return its exit status."""
    arguments = sys.argv[1:] if arguments is None else arguments
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a file's name may be no UTF-8, or more than a terminal can show
            stream.reconfigure(errors="backslashreplace")
    if list(arguments) == ["--version"]:
        print(f"dofbench {__version__}")
        return DONE
    configure_threads()
    try:
        _check_utf8(arguments)
        settings = parse(arguments)
        if isinstance(settings, MakeDatasets | MakeScene | Reconstruct | Runs | Ablate | Score | Check | Stability):
            # Importing pycolmap installs a handler for SIGTERM that prints a stack trace and aborts. These commands
            # need pycolmap anyway, so it is imported first and our handler replaces the other one.
            with loading.running():
                import pycolmap  # noqa: F401
        with _signals_as_exceptions():
            return execute(settings)
    except InputError as mistake:
        return _end(WRONG_CALL, one_line(mistake))
    except KeyboardInterrupt as stop:
        number = stop.number if isinstance(stop, Interrupted) else signal.SIGINT
        return _end(128 + number, _INTERRUPTED)
    except BrokenPipeError:
        # The reader of our output has closed the pipe (`| head`). Without this line Python would print an error at
        # exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE
    except Exception as error:
        if interruption(error) is not None:  # within an import of compiled code, which makes another error of it
            return _end(128 + signal.SIGINT, _INTERRUPTED)
        line = one_line(error) or ("out of memory; what is finished stays" if out_of_memory(error) else "")
        if not line:
            raise
        return _end(FAILED, line)


def _check_utf8(arguments: Sequence[str]) -> None:
    """Raise InputError where an argument or the current folder isn't UTF-8: libraries crash on such a path, and no
    record can hold it."""
    try:
        words = (*arguments, str(Path.cwd()))
    except FileNotFoundError:
        raise InputError("the current folder", "that it was deleted", "one that is there") from None
    for word in words:
        try:
            word.encode()
        except UnicodeEncodeError:
            raise InputError(word, "a name that isn't UTF-8", "arguments and a current folder in UTF-8") from None


def console() -> None:
    """What `cli.entry` runs: `main`, for runs in a child process, then an end without the interpreter's clean-up.

    When the interpreter exits, OpenImageIO's binding prints a page about objects that colour-science still holds, which
    means nothing to a user. Skipping the clean-up loses nothing: every file is closed or renamed by then.
    """
    if sys.argv[1:2] in (["run"], ["ablate"]):
        in_child(FAILED)
    signal.signal(signal.SIGINT, _interrupt)
    status = main()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


def _end(status: int, message: str) -> int:
    print(f"dofbench: {message}", file=sys.stderr)
    return status


@contextmanager
def _input_errors_unframed() -> Iterator[None]:
    """Let an InputError from a settings class pass through tyro, which would print any ValueError in a frame and
    exit."""
    text = io.StringIO()
    try:
        with redirect_stderr(text):
            yield
    except SystemExit as end:
        behind: BaseException | None = end
        while behind is not None and not isinstance(behind, InputError):
            behind = behind.__context__
        if behind is not None:
            raise behind from None
        sys.stderr.write(text.getvalue())
        raise


@contextmanager
def _signals_as_exceptions() -> Iterator[None]:
    """SIGTERM ends a command the way Ctrl-C does: through its `finally` blocks, with files whole."""
    previous = signal.signal(signal.SIGTERM, _interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous)
