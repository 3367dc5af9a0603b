"""The hooks of .pre-commit-config.yaml ask what .ci/run asks, of programs that the extra `dev` brings."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

HOOK = re.compile(r"^      - id: (?P<id>[\w-]+)\n(?P<rest>(?:        .*\n)+)", re.MULTILINE)


@pytest.fixture
def hooks(repository: Path) -> dict[str, dict[str, str]]:
    """By id, what each hook says of itself."""
    text = (repository / ".pre-commit-config.yaml").read_text()
    found = {
        hook["id"]: dict(line.strip().split(": ", 1) for line in hook["rest"].splitlines())
        for hook in HOOK.finditer(text)
    }
    assert len(found) == text.count("- id:") and "repo: local" in text and text.count("repo:") == 1
    return found


def test_hooks_run_with_the_arguments_that_ci_uses(hooks, repository: Path) -> None:
    linted = re.findall(r'^"\$work/lint/bin/(ruff)" (.+)$', (repository / ".ci" / "run").read_text(), re.MULTILINE)
    types = (repository / "tests" / "test_types.py").read_text()
    assert '"-m", "mypy", "--cache-dir", str(tmp_path), *words]' in types and "status, said = checked()" in types
    assert [hook["entry"] for hook in hooks.values()] == [*(" ".join(words) for words in linted), "mypy"]


def test_hooks_need_no_network_and_no_list_of_files(hooks) -> None:
    for hook in hooks.values():
        assert hook["language"] == "system" and hook["pass_filenames"] == "false"


def test_programs_of_hooks_are_in_the_extra_dev(hooks, repository: Path) -> None:
    extra = tomllib.loads((repository / "pyproject.toml").read_text())["project"]["optional-dependencies"]["dev"]
    names = {re.split(r"[<>=~]", package)[0] for package in extra}
    assert {hook["entry"].split()[0] for hook in hooks.values()} | {"pre-commit"} <= names


@pytest.mark.parametrize("hook", ["ruff-check", "ruff-format", "mypy"])
def test_the_program_knows_the_arguments(hooks, hook: str, repository: Path) -> None:
    program, *arguments = hooks[hook]["entry"].split()
    found = shutil.which(program, path=str(Path(sys.executable).parent))
    if found is None:
        pytest.skip(f"{program} is not installed here; it comes with the extra dev")
    done = subprocess.run([found, *arguments, "--help"], cwd=repository, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_pre_commit_takes_the_file(repository: Path) -> None:
    found = shutil.which("pre-commit", path=str(Path(sys.executable).parent))
    if found is None:
        pytest.skip("pre-commit is not installed here; it comes with the extra dev")
    command = [found, "validate-config", str(repository / ".pre-commit-config.yaml")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
