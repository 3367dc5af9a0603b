"""Where the figures of a page come from: commits that are there, commands that can be called, a machine with a name."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import subprocess
from collections.abc import Iterator
from pathlib import Path

from figure_pages import Page

from dofbench import cli

_FENCE = re.compile(r"^```(?:sh)?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_INDENTED = re.compile(r"(?:^    .*\n?)+", re.MULTILINE)
_CODE = re.compile(r"`([^`\n]+)`")
_SCRIPT = re.compile(r"\b(?:benchmarks|datasets)/.*")  # below the checkout, whatever folder is named before it
_ROOT = Path(__file__).resolve().parents[1]


def has_history(root: Path) -> bool:
    """Whether git can say which commits there were: not in a copy of the files, nor in a shallow clone."""
    if not (root / ".git").exists():
        return False
    asked = ["git", "rev-parse", "--is-shallow-repository"]
    return subprocess.run(asked, cwd=root, capture_output=True, text=True).stdout.strip() == "false"


def commit_problems(page: Page, root: Path) -> Iterator[str]:
    """The page's commits that aren't ancestors of what is checked out, a line each."""
    for commit in page.given.get("commits", []):
        asked = ["git", "merge-base", "--is-ancestor", f"{commit}^{{commit}}", "HEAD"]
        if subprocess.run(asked, cwd=root, capture_output=True).returncode:
            yield f"commit {commit}: not in the history"


def problems(page: Page) -> Iterator[str]:
    """What is missing or wrong in what a page says of the origin of its figures, a line each."""
    for part in ("commits", "machine"):
        if not page.given.get(part):
            yield f"no {part} in figures.toml"
    commands = list(calls(page))
    if not commands:
        yield "no command, neither on the page nor in figures.toml"
    for words in commands:
        if (problem := _wrong(words)) is not None:
            yield f"{shlex.join(words)}: {problem}"


def calls(page: Page) -> Iterator[list[str]]:
    """The calls of dofbench and of scripts in benchmarks/ and datasets/ on a page and in its figures.toml, as words.
    Code within a line counts if it is a whole call."""
    rest = _FENCE.sub("", page.text)
    # Not the mere name of a command
    within = [code for code in _CODE.findall(rest) if code.startswith("python ") or len(code.split()) > 2]
    blocks = [] if page.generated else [*_FENCE.findall(page.text), *_INDENTED.findall(rest), *within]
    for block in (*blocks, *page.given.get("commands", [])):
        for line in block.replace("\\\n", " ").splitlines():
            for call in re.split(r"&&|;", line):
                try:
                    words = shlex.split(call, comments=True)
                except ValueError:  # not a shell command, for example a formula
                    continue
                while words and re.match(r"\w+=", words[0]):  # a variable of the environment
                    words = words[1:]
                if len(words) > 1 and (words[0] == "dofbench" or (words[0] == "python" and _script(words[1]))):
                    yield words


def _script(word: str) -> Path | None:
    found = _SCRIPT.search(word)
    return None if found is None else _ROOT / found[0]


def _wrong(words: list[str]) -> str | None:
    if words[0] == "dofbench":
        shown = [word.replace("$scene", "fence") for word in words[1:] if word not in ("...", "…")]
        try:
            with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
                cli.parse(shown)
        except SystemExit as end:
            return None if end.code == 0 else "dofbench doesn't take this"
        return None
    script = _script(words[1])
    if script is None or not script.is_file():
        return "no such script"
    for word in words[2:]:
        if word.startswith("--") and not takes_option(script, option := word.removeprefix("--")):
            return f"the script has no --{option}"
    return None


def takes_option(script: Path, option: str) -> bool:
    """Whether a benchmark has `--option`: itself, or in the settings that it shares with others beside it."""
    source = script.read_text(encoding="utf-8")
    beside = [script.with_name(f"{name}.py") for name in re.findall(r"^from (\w+) import", source, re.MULTILINE)]
    source += "".join(file.read_text(encoding="utf-8") for file in beside if file.is_file())
    field = rf"^    {option.replace('-', '_')}: |add_argument\(\"--{option}\""
    return re.search(field, source, re.MULTILINE) is not None
