"""The command line: one table of commands. Options and their help are declared in the classes of options alone.

Exit status: 0 done, 1 something failed (each failure is named), 2 the call is wrong, 3 `check` found nothing wrong but
couldn't compute scores again, 128 + n ended by signal n. A command's modules are imported once the command is known, so
that help appears at once.
"""

from __future__ import annotations

import importlib
import io
import os
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from types import FrameType
from typing import Any

from dofbench import __version__
from dofbench.core.clock import loading
from dofbench.core.errors import InputError, Interrupted, interruption, one_line, out_of_memory, unknown

DONE, FAILED, WRONG_CALL, NOT_RECOMPUTED = 0, 1, 2, 3
_INTERRUPTED = "interrupted; rerun the same command to resume"
_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGUSR2)
_REPEATED = 1.0  # seconds within which a second signal is the first one that came twice


@dataclass(frozen=True)
class Command:
    """A command: one line about it, and where its options and its function are, as "module:name" below `dofbench`.

    The function is called with the options; it returns an exit status, or a value that is false where something failed.
    """

    summary: str
    options: str
    function: str


COMMANDS = {
    "run": Command(
        "Train methods on datasets and score them.", "running.run_options:Runs", "cli.run_methods:run_methods"
    ),
    "report": Command("Write leaderboards and pages.", "reporting.report_options:Report", "reporting:report"),
    "view": Command(
        "Look at trained scenes and datasets in the browser.", "viewing.view_options:View", "viewing.view:view"
    ),
    "render": Command("Render a film of a trained scene.", "viewing.render_options:Render", "viewing.render:render"),
    "refocus": Command(
        "Give one image another focus and aperture.",
        "viewing.refocus_options:Refocus",
        "viewing.refocus:refocus",
    ),
    "methods": Command(
        "List the methods, or one's presets and options.", "cli.small_commands:Methods", "cli.small_commands:methods"
    ),
    "scenes": Command("List the scenes.", "cli.small_commands:Scenes", "cli.small_commands:scenes"),
    "fetch": Command("Download a named dataset.", "datasets.fetching.fetch_options:Fetch", "datasets.fetching:fetch"),
    "make-dataset": Command(
        "Make a dataset with synthetic or real defocus.",
        "datasets.synthesis.dataset_options:MakeDatasets",
        "datasets.synthesis:make_datasets",
    ),
    "make-scene": Command(
        "Render a procedural scene with a thin-lens camera.",
        "scenes.procedural.scene_options:MakeScene",
        "scenes.procedural:make_scene",
    ),
    "reconstruct": Command(
        "Find camera poses by structure from motion.",
        "scenes.reconstruction.reconstruct_options:Reconstruct",
        "scenes.reconstruction:reconstruct",
    ),
    "ablate": Command("Run ablation tables.", "running.ablation_options:Ablate", "cli.ablate:make_tables"),
    "score": Command(
        "Score finished runs again, or by further metrics.", "cli.small_commands:Score", "cli.small_commands:score"
    ),
    "check": Command("Verify a dataset or results.", "cli.small_commands:Check", "cli.small_commands:check"),
    "warm-up": Command(
        "Compile kernels before the first run: for containers and jobs.", "cli.warm_up:WarmUp", "cli.warm_up:warm_up"
    ),
    "validate-renderer": Command(
        "Compare the renderers with thin-lens images and light fields.",
        "evaluation.renderer.validation_options:ValidateRenderer",
        "evaluation.renderer.validate:validate_renderer",
    ),
    "stability": Command(
        "Test numerically extreme cases against error bounds.",
        "evaluation.stability.stability_options:Stability",
        "evaluation.stability.measure:stability",
    ),
}
_HELP = """\
usage: dofbench COMMAND [OPTIONS]

Benchmark of view synthesis from images with a shallow depth of field: make datasets with known lenses,
train methods on them, and compare the methods.

commands:
{commands}

Options of a command: dofbench COMMAND --help. The version: dofbench --version."""


def parse(arguments: Sequence[str]) -> Any:
    """The options that the command line gives. Raises InputError, or SystemExit after printing help or an error."""
    if not arguments or arguments[0] not in COMMANDS:
        raise unknown("command", arguments[0] if arguments else "", COMMANDS)
    name, *words = arguments
    from tyro import cli, conf

    from dofbench.core.options import unframed_errors

    options = _found(COMMANDS[name].options)
    _check_names(options, words)
    look = (conf.DisallowNone, conf.FlagCreatePairsOff, conf.PositionalMetavarFromFieldName)
    with unframed_errors():
        return cli(options, prog=f"dofbench {name}", args=words, config=look)


def _check_names(options: Any, words: Sequence[str]) -> None:
    """Raise InputError for an unknown option, for a required one that is missing, and for one that is given twice: the
    parser would ignore its first values."""
    known = {"--help"}
    for field in fields(options):
        known.add(f"--no-{field.name}".replace("_", "-") if field.default is True else f"--{field.name}")
    known = {name.replace("_", "-") for name in known}
    seen: set[str] = set()
    for word in words:
        option = word.partition("=")[0].replace("_", "-")
        if not word.startswith("--"):
            continue
        if option not in known:
            raise unknown("option", option, known)
        if option in seen:
            raise InputError(option, "the option twice", "once, with all its values behind it: --set a=1 b=2")
        seen.add(option)
    if {"-h", "--help"} & set(words):
        return
    for field in fields(options):
        if field.default is not MISSING or field.default_factory is not MISSING:
            continue
        positional = "Positional" in str(field.type)
        subject = field.name if positional else f"--{field.name}".replace("_", "-")
        if all(word.startswith("--") for word in words) if positional else subject not in seen:
            raise InputError(subject, "nothing", "a value; --help describes it")


def execute(options: Any) -> int:
    """Do what the options ask for and return the exit status. Raises InputError for a wrong input."""
    kind = f"{type(options).__module__}:{type(options).__name__}".removeprefix("dofbench.")
    command = next(command for command in COMMANDS.values() if command.options == kind)
    with loading.running():
        function = _found(command.function)
    outcome = function(options)
    return outcome if type(outcome) is int else DONE if outcome else FAILED


def _found(place: str) -> Any:
    module, name = place.split(":")
    return getattr(importlib.import_module(f"dofbench.{module}"), name)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command line (default: this process's) and return its exit status."""
    arguments = sys.argv[1:] if arguments is None else arguments
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a file's name may be no UTF-8, or more than a terminal can show
            stream.reconfigure(errors="backslashreplace")
    if list(arguments) == ["--version"]:
        print(f"dofbench {__version__}")
        return DONE
    if list(arguments) in (["--help"], ["-h"]):
        width = max(map(len, COMMANDS))
        print(_HELP.format(commands="\n".join(f"  {name:{width}}  {one.summary}" for name, one in COMMANDS.items())))
        return DONE
    from dofbench.runtime.threads import configure_processor, configure_threads

    configure_threads()
    configure_processor()
    try:
        with _signals_as_exceptions():
            _check_utf8(arguments)
            return execute(parse(arguments))
    except InputError as mistake:
        return _end(WRONG_CALL, one_line(mistake))
    except BrokenPipeError:
        # The reader of our output has closed the pipe (`| head`). Without this line Python would print an error at
        # exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE
    except (Exception, KeyboardInterrupt) as error:
        # A signal within compiled code may come out of it as another error.
        if (stop := interruption(error)) is not None:
            return _end(128 + (stop.number if isinstance(stop, Interrupted) else signal.SIGINT), _INTERRUPTED)
        line = one_line(error) or ("out of memory; finished work is kept" if out_of_memory(error) else "")
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
    """Run the installed program: `main`, in a child process for commands that train, and end with its status."""
    if sys.argv[1:2] in (["run"], ["ablate"]):
        from dofbench.runtime.supervised import in_child

        in_child(FAILED)
    sys.exit(main())


def _end(status: int, message: str) -> int:
    print(f"dofbench: {message}", file=sys.stderr)
    return status


@contextmanager
def _signals_as_exceptions() -> Iterator[None]:
    """End a command by SIGTERM or SIGUSR2 as by Ctrl-C: through its `finally` blocks, with files whole.

    A signal that comes twice within a second, from the terminal and forwarded by the parent process, counts once.
    """
    last: dict[int, float] = {}

    def interrupt(number: int, frame: FrameType | None) -> None:
        now = time.monotonic()
        earlier, last[number] = last.get(number), now
        if earlier is None or now - earlier >= _REPEATED:
            raise Interrupted(number)

    previous = {number: signal.signal(number, interrupt) for number in _ENDING}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
