"""Runs tests for `mutation_run.py`, in a process of its own whose working directory is the copy of the checkout.

    map ORDER TEST_FILE...       which lines each test runs, and how long it takes
    serve ORDER TEST_FILE...     what becomes of mutants

Importing and collecting the tests takes half a minute, most tests milliseconds. So all is collected once, and every
mutant gets a fork of that process, in which the changed function's code is exchanged. A mutant of what runs at import
gets a process of its own instead, started after the file was changed.
"""

from __future__ import annotations

import ast
import contextlib
import gc
import importlib
import json
import os
import resource
import select
import shutil
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import pytest

MEMORY = 12 << 30  # bytes that a mutant may address beyond what the process has before
PATIENCE = 10.0  # a test that takes so many times its time, and `GRACE` seconds more, doesn't end
GRACE = 30.0  # for a machine that others use too


def module_of(file: str) -> str:
    """The name under which a source file is imported."""
    parts = list(Path(file).with_suffix("").parts)
    parts = parts[:-1] if parts[-1] == "__init__" else parts
    return ".".join(parts if parts[0] == "dofbench" else ["dofbench", *parts])


class _Quick:
    """Examples of hypothesis aren't made smaller after a failure: that something fails is all that is asked."""

    @pytest.hookimpl(trylast=True)
    def pytest_collection(self, session: pytest.Session) -> None:
        """After the tests' conftest has chosen a profile, and before any test is imported."""
        import hypothesis

        known = hypothesis.settings.get_profile("dofbench")
        phases = [hypothesis.Phase.explicit, hypothesis.Phase.generate]
        hypothesis.settings.register_profile(
            "mutation", known, phases=phases, database=None, derandomize=True, report_multiple_bugs=False
        )
        hypothesis.settings.load_profile("mutation")


class Mapping(_Quick):
    """Runs every test once, unchanged, and writes for each its seconds, whether it passed, and the lines that it ran.

    What runs while a fixture of several tests is made counts for every test that asks for the fixture.
    """

    def __init__(self, out: Path, sources: Sequence[str]) -> None:
        import coverage

        self._out, self._sources = out, sources
        self._coverage = coverage.Coverage(data_file=None, include=[str(Path.cwd() / one) for one in sources])
        self._tests: dict[str, dict[str, Any]] = {}
        self._context = ""

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtestloop(self) -> Iterator[None]:
        """Trace the tests, not their collection."""
        self._coverage.start()
        result = yield
        self._coverage.stop()
        self._write()
        return result

    def _switch(self, context: str) -> str:
        before, self._context = self._context, context
        self._coverage.switch_context(context or "nothing")
        return before

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """One test, with everything that it calls."""
        info = getattr(item, "_fixtureinfo", None)
        shared = []
        for definitions in (info.name2fixturedefs if info else {}).values():
            shared += [_shared(definitions[-1])] if definitions[-1].scope != "function" else []
        self._tests[item.nodeid] = {"seconds": 0.0, "passed": True, "fixtures": shared}
        before = self._switch(item.nodeid)
        try:
            return (yield)
        finally:
            self._switch(before)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Iterator[Any]:
        """What a shared fixture runs is kept apart from the test that happens to be the first to ask for it."""
        if fixturedef.scope == "function":
            return (yield)
        before = self._switch(_shared(fixturedef))
        try:
            return (yield)
        finally:
            self._switch(before)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add up a test's phases. A test that is skipped can't notice anything."""
        known = self._tests[report.nodeid]
        known["seconds"] += report.duration
        known["passed"] = known["passed"] and report.outcome == "passed"

    def _write(self) -> None:
        names = list(self._tests)
        numbers: dict[str, list[int]] = {}
        for number, name in enumerate(names):
            for context in (name, *self._tests[name]["fixtures"]):
                numbers.setdefault(context, []).append(number)
        data = self._coverage.get_data()
        lines: dict[str, dict[str, list[int]]] = {}
        for file in self._sources:
            by_line = data.contexts_by_lineno(str(Path.cwd() / file))
            lines[file] = {
                str(line): sorted({number for context in contexts for number in numbers.get(context, ())})
                for line, contexts in by_line.items()
            }
        tests = [{"name": name, **{k: self._tests[name][k] for k in ("seconds", "passed")}} for name in names]
        self._out.write_text(json.dumps({"tests": tests, "lines": lines}))


def _shared(definition: Any) -> str:
    return f"fixture {definition.baseid}::{definition.argname}"


class Serving(_Quick):
    """Runs mutants in forks, and writes one line of JSON for each to the file `answers`.

    A job: id, file (its path), mutated (the file's new text; None to run the tests on what lies there), tests (their
    names and seconds, in the order in which they are run).
    """

    def __init__(self, jobs: Sequence[dict[str, Any]], sources: Sequence[str], answers: int, grace: float) -> None:
        self._jobs, self._sources, self._answers, self._grace = jobs, sources, answers, grace
        self._failed = ""
        self._trusted: dict[str, bool] = {}
        self._functions: dict[tuple[str, str, int], list[FunctionType]] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Remember a failure in any phase."""
        if report.failed:
            self._failed = report.nodeid

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Instead of running the tests, run the mutants."""
        self._items = {item.nodeid: item for item in session.items}
        if any(job["mutated"] is not None for job in self._jobs):
            self._get_ready()
        # A fork's folders are thrown away after it, and no fork sees another's.
        self._folder = session.config._tmp_path_factory.getbasetemp()  # type: ignore[attr-defined]
        for job in self._jobs:
            start = time.monotonic()
            answer = {"id": job["id"], **dict(zip(("outcome", "test", "ran"), self._outcome(job), strict=True))}
            answer["seconds"] = time.monotonic() - start
            os.write(self._answers, (json.dumps(answer) + "\n").encode())
        return True

    def _get_ready(self) -> None:
        for file in self._sources:
            importlib.import_module(module_of(file))
        gc.collect()
        for one in gc.get_objects():
            if isinstance(one, FunctionType):
                code = one.__code__
                self._functions.setdefault((code.co_filename, code.co_qualname, code.co_firstlineno), []).append(one)
        gc.freeze()  # pages that the collector doesn't touch stay shared

    def _outcome(self, job: dict[str, Any]) -> tuple[str, str, int]:
        tests = [(name, seconds) for name, seconds in job["tests"] if name in self._items]
        if not tests:
            return "not run by any test", "", 0
        while True:
            outcome, test = self._fork(job, tests)
            # A test that fails without the mutant as well, alone in a fork, says nothing about it.
            if not test or job["mutated"] is None or self._trust(test, dict(tests)[test]):
                return outcome, test, len(tests)
            tests = [one for one in tests if one[0] != test]

    def _trust(self, test: str, seconds: float) -> bool:
        if test not in self._trusted:
            outcome, _ = self._fork({"mutated": None}, [(test, seconds)])
            self._trusted[test] = outcome == "survived"
        return self._trusted[test]

    def _fork(self, job: dict[str, Any], tests: Sequence[tuple[str, float]]) -> tuple[str, str]:
        """Outcome, and the test to which it is due."""
        reader, writer = os.pipe()
        pid = os.fork()
        if pid == 0:
            status = 1
            try:
                os.close(reader)
                os.setpgid(0, 0)
                self._child(job, tests, writer)
                status = 0
            finally:
                os._exit(status)
        os.close(writer)
        with contextlib.suppress(OSError):
            os.setpgid(pid, pid)
        times = dict(tests)
        found, running, told = ("crashed", tests[0][0]), tests[0][0], b""
        while True:
            ready, _, _ = select.select([reader], [], [], self._grace + PATIENCE * times[running])
            if not ready:
                found = ("timed out", running)
                break
            more = os.read(reader, 65536)
            if not more:
                break
            told += more
            *lines, told = told.split(b"\n")
            for line in lines:
                word, _, name = line.decode().partition(" ")
                if word == "start":
                    running, found = name, ("crashed", name)
                else:
                    found = (word, name)
        os.close(reader)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        for one in self._folder.iterdir():
            shutil.rmtree(one, ignore_errors=True)
        return found

    def _child(self, job: dict[str, Any], tests: Sequence[tuple[str, float]], writer: int) -> None:
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
        if job["mutated"] is not None and not self._exchange(job["file"], job["mutated"]):
            os.write(writer, b"unchanged \n")
            return
        items = [self._items[name] for name, _ in tests]
        for item, following in zip(items, [*items[1:], None], strict=True):
            os.write(writer, f"start {item.nodeid}\n".encode())
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            if self._failed:
                os.write(writer, f"failed {self._failed}\n".encode())
                return
        os.write(writer, b"survived \n")

    def _exchange(self, file: str, mutated: str) -> bool:
        """Give every function whose code differs between the file and its changed text the code of the latter. False if
        there is none: the change is of something that runs at import."""
        path = str(Path.cwd() / file)
        pairs = list(_pairs(_compiled(Path(path).read_text(), path), _compiled(mutated, path)))
        done = False
        for old, new in pairs:
            for function in self._functions.get((path, old.co_qualname, old.co_firstlineno), ()):
                if old != new:
                    try:
                        function.__code__ = new
                    except ValueError:  # the change took the last use of an outer function's variable
                        return False
                    done = True
        return done


def _compiled(text: str, path: str) -> CodeType:
    return compile(ast.parse(text, path), path, "exec", dont_inherit=True)


def _pairs(old: CodeType, new: CodeType) -> Iterator[tuple[CodeType, CodeType]]:
    yield old, new
    before, after = ([one for one in code.co_consts if isinstance(one, CodeType)] for code in (old, new))
    if [one.co_qualname for one in before] == [one.co_qualname for one in after]:
        for one, other in zip(before, after, strict=True):
            yield from _pairs(one, other)


def main() -> None:
    """What the module's docstring says."""
    what, file, *tests = sys.argv[1:]
    order = json.loads(Path(file).read_text())
    sys.path.insert(0, str(Path.cwd()))  # the copy's dofbench, whatever is installed
    plugin = Mapping(Path(order["out"]), order["sources"]) if what == "map" else None
    if plugin is None:
        answers = int(os.environ["MUTATION_ANSWERS"])
        plugin = Serving(order["jobs"], order["sources"], answers, order.get("grace", GRACE))
    options = ["-q", "--tb=no", "-p", "no:cacheprovider", "-p", "no:faulthandler", f"--basetemp={order['temporary']}"]
    sys.exit(pytest.main([*options, *tests], plugins=[plugin]))
