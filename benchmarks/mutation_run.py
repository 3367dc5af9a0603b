"""Whether the tests notice when the code changes: mutants drawn at random, and for each whether any test fails.

    python benchmarks/mutation_run.py --seed 16 --count 300 --out reports/mutation

A mutant is one small change of the code, such as another sign, a condition negated or a statement left out
(`mutation_sites.py`). Drawn from are the optics, the learned lens and depth, the Gaussians, the metrics, the statistics
of pairs and the kernels' references: as many statements as asked for, each as likely as any other, then one of the
statement's sites, then one of the site's mutants. A draw depends on the seed and on the statement alone, so that most
of it stays the same when other code changes.

Of each mutant those tests run that run its line, the cheapest first, up to the first that fails. Which lines a test
runs is measured by coverage.py, once, and again for what has changed. All happens in a copy of the checkout (`--work`),
on one core. mutants.csv has what became of each mutant; what it has already isn't run again,
unless the code has changed, or a mutant survived and the tests have changed. README.md beside it counts, and lists the
survivors with their reasons, which stand in survivors.toml.

No known tool does this here: mutmut (3.8) puts all of a function's mutants behind a wrapper in the source, by which
compiled kernels and digests of the code change too; cosmic-ray (8.7) runs one command, here of nine minutes, for each.
"""

from __future__ import annotations

import csv
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tyro
from mutation_page import survivors, write_page
from mutation_sites import Mutant, mutants_of

from dofbench.core.errors import InputError
from dofbench.core.files import replacing

ROOT = Path(__file__).resolve().parents[1]
SOURCES = (
    "dofbench/optics/**/*.py",
    "dofbench/learning/**/*.py",
    "dofbench/gaussians/**/*.py",
    "dofbench/metrics/**/*.py",
    "dofbench/reporting/paired.py",
    "dofbench/reporting/differences.py",
    "kernels/*/reference.py",
)
# The tests that run this code in their own process.
TESTS = (
    "gaussians", "kernels", "metrics", "methods", "priors", "ablation", "harness", "depth", "photographs", "validation",
    "stability", "reporting/test_differences.py", "reporting/test_paired.py", "reporting/test_report.py",
    "reporting/test_verdict.py", "test_blur.py", "test_defocus.py", "test_layered.py", "test_lens.py",
    "test_mixed_pixels.py", "test_networks.py", "test_photographs_run.py", "test_tone.py",
)  # fmt: skip
FIELDS = (
    "id", "file", "line", "function", "operator", "before", "after", "outcome", "killed_by", "tests", "seconds", "code",
    "suite", "commit",
)  # fmt: skip
KILLED = ("failed", "crashed", "timed out")


@dataclass(frozen=True)
class Settings:
    """What to draw, and where it goes."""

    out: Path
    """Folder for mutants.csv and README.md; survivors.toml there has the reasons."""
    seed: int = 16
    """Of the draw."""
    count: int = 300
    """How many mutants are drawn."""
    limit: float = 60.0
    """Seconds of tests that are run for a mutant at most, the cheapest tests first; one that survives them survives."""
    work: Path = field(default_factory=lambda: Path(tempfile.gettempdir()) / "dofbench-mutation")
    """Folder of the copy and of the tests' map, which the next call finds again."""


def main(settings: Settings) -> None:
    """Draw, run what isn't known, and write the page."""
    settings.out.mkdir(parents=True, exist_ok=True)
    settings.work.mkdir(parents=True, exist_ok=True)
    copy = settings.work / "checkout"
    _copy(ROOT, copy)
    commit = _commit()  # of what was copied, whatever is committed while the mutants run
    sources = sorted({str(path.relative_to(copy)) for glob in SOURCES for path in copy.glob(glob)})
    code = _digest(copy, [*copy.glob("dofbench/**/*.py"), *copy.glob("kernels/**/*.py")])
    files = [str(path.relative_to(copy)) for path in _test_files(copy)]
    suite = _digest(copy, copy.glob("tests/**/*.py"))
    drawn = draw([mutant for file in sources for mutant in mutants_of(copy, file)], settings.seed, settings.count)
    table = settings.out / "mutants.csv"
    known = {row["id"]: row for row in csv.DictReader(table.open())} if table.is_file() else {}
    equal = {mark for mark, one in survivors(settings.out).items() if one["kind"] == "equivalent"}
    rows = {one.id: known[one.id] for one in drawn if one.id in known and _holds(known[one.id], code, suite, equal)}
    left = [one for one in drawn if one.id not in rows]
    print(f"{len(drawn)} mutants of {len(sources)} files, {len(rows)} of them known", flush=True)
    if left:
        tests = Map(settings.work, copy, sources, files, code)
        marks = {"code": code, "suite": suite, "commit": commit}
        for mutant, answer in _run(settings, copy, sources, left, tests, known):
            rows[mutant.id] = _row(mutant, answer) | marks
            _publish(settings, [rows[one.id] | {"line": str(one.line)} for one in drawn if one.id in rows])
            print(f"{len(rows)}: {mutant.file}:{mutant.line} {answer['outcome']} {answer['test']}", flush=True)
    _publish(settings, [rows[one.id] | {"line": str(one.line)} for one in drawn])


def _publish(settings: Settings, rows: Sequence[dict[str, str]]) -> None:
    with replacing(settings.out / "mutants.csv") as temporary, temporary.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, FIELDS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    write_page(settings.out, rows, seed=settings.seed, count=settings.count, killed=KILLED)


def draw(mutants: Sequence[Mutant], seed: int, count: int) -> list[Mutant]:
    """So many statements, each as likely as any other; of each one site, of that one mutant. In the order of the text.
    Each choice is that of the smallest hash, so that a statement is drawn or not whatever stands beside it."""

    def rank(what: str) -> str:
        return hashlib.sha256(f"{seed} {what}".encode()).hexdigest()

    statements: dict[tuple[str, int], list[Mutant]] = {}
    for one in mutants:
        statements.setdefault((one.file, one.line), []).append(one)
    chosen = sorted(statements.values(), key=lambda those: rank(those[0].id))[:count]
    drawn = []
    for those in chosen:
        sites: dict[tuple[tuple[int, int], str], list[Mutant]] = {}
        for one in those:
            sites.setdefault((one.site, one.operator), []).append(one)
        site = min(sites.values(), key=lambda of: rank("site " + of[0].id))
        drawn.append(min(site, key=lambda one: rank("mutant " + one.id)))
    return sorted(drawn, key=lambda one: (one.file, one.line))


class Map:
    """Which tests run which lines. Kept for each file of tests, and measured again when it or the code changes."""

    def __init__(self, work: Path, copy: Path, sources: Sequence[str], files: Sequence[str], code: str) -> None:
        self.seconds: dict[str, float] = {}
        self._lines: dict[str, dict[int, set[str]]] = {file: {} for file in sources}
        self._names: dict[str, set[tuple[str, int]]] = {}
        helping = _digest(
            copy,
            (
                path
                for path in copy.glob("tests/**/*.py")
                if not path.name.startswith("test_") and path.name != "tolerances.py"
            ),
        )
        folder = work / "map"
        folder.mkdir(exist_ok=True)
        parts = {file: folder / (file.replace("/", "-") + ".json") for file in files}
        digests = {file: f"{code} {helping} {_digest(copy, [copy / file])}" for file in files}
        stale = [
            file for file in files
            if not parts[file].is_file() or json.loads(parts[file].read_text())["digest"] != digests[file]
        ]  # fmt: skip
        if stale:
            start, fresh = time.monotonic(), work / "fresh.json"
            fresh.unlink(missing_ok=True)
            _start(work, copy, "map", stale, {"out": str(fresh), "sources": sources}).wait()
            if not fresh.is_file():
                raise InputError(work / "map.log", "no map of the tests", "coverage installed, and tests that collect")
            for file, part in _by_file(json.loads(fresh.read_text()), stale).items():
                parts[file].write_text(json.dumps({"digest": digests[file], **part}))
            print(f"map of {len(stale)} files of tests: {time.monotonic() - start:.0f} s", flush=True)
        self._words: dict[str, set[str]] = {}
        for file in files:
            self._add(json.loads(parts[file].read_text()))
            self._words[file] = set(re.findall(r"[A-Za-z_]\w*", (copy / file).read_text()))
        for file in sources:
            for line, text in enumerate((copy / file).read_text().splitlines(), 1):
                for name in re.findall(r"[A-Za-z_]\w*", text.partition("#")[0]):
                    self._names.setdefault(name, set()).add((file, line))

    def _add(self, part: dict[str, Any]) -> None:
        names = [test["name"] if test["passed"] else "" for test in part["tests"]]
        self.seconds |= {test["name"]: test["seconds"] for test in part["tests"] if test["passed"]}
        for file, lines in part["lines"].items():
            for line, numbers in lines.items():
                self._lines[file].setdefault(int(line), set()).update(names[one] for one in numbers if names[one])

    def tests(self, mutant: Mutant, limit: float, first: str) -> list[tuple[str, float]]:
        """The tests that run the mutant's lines, with their seconds: `first`, if it is one, then the cheapest, up to
        `limit` seconds in all.

        What runs at import has no test of its own: taken are the tests that run a line that mentions its name, or whose
        own file does, or else all that run anything of its file.
        """
        lines = range(mutant.line, mutant.end + 1)
        found = set().union(*(self._lines[mutant.file].get(line, ()) for line in lines))
        if not mutant.name:
            for name in mutant.mentioned:
                found |= set().union(*(self._lines[file].get(line, ()) for file, line in self._names.get(name, ())))
                found |= {test for test in self.seconds if name in self._words[test.partition("::")[0]]}
            found = found or set().union(*self._lines[mutant.file].values())
        chosen, spent = [], 0.0
        for name in sorted(found, key=lambda name: (name != first, self.seconds[name], name)):
            spent += self.seconds[name]
            if chosen and spent > limit:
                break
            chosen.append((name, self.seconds[name]))
        return chosen


def _run(
    settings: Settings, copy: Path, sources: Sequence[str], mutants: Sequence[Mutant], tests: Map, known: dict[str, Any]
) -> Iterator[tuple[Mutant, dict[str, Any]]]:
    by_id = {one.id: one for one in mutants}
    jobs, later = [], []
    for one in mutants:
        file = copy / one.file
        job = {
            "id": one.id,
            "file": one.file,
            "mutated": one.applied(file.read_text()),
            "tests": tests.tests(one, settings.limit, known.get(one.id, {}).get("killed_by", "")),
        }
        (jobs if one.name else later).append(job)
    for answer in _serve(settings.work, copy, sources, jobs):
        if answer["outcome"] == "unchanged":
            later.append(next(job for job in jobs if job["id"] == answer["id"]))
        else:
            yield by_id[answer["id"]], answer
    trusted: dict[str, bool] = {}
    for number, job in enumerate(later, 1):
        while True:
            with _changed(copy / job["file"], job["mutated"], number):
                answer = _alone(settings.work, copy, sources, job)
            test = answer["test"]
            if test and test not in trusted:
                alone = [one for one in job["tests"] if one[0] == test]
                unchanged = list(_serve(settings.work, copy, sources, [job | {"mutated": None, "tests": alone}]))
                if not unchanged:
                    raise InputError(settings.work / "serve.log", "no verdict on unchanged code", "tests that collect")
                trusted[test] = unchanged[0]["outcome"] == "survived"
            if not test or trusted[test]:
                break
            job["tests"] = [one for one in job["tests"] if one[0] != test]
        yield by_id[job["id"]], answer


def _alone(work: Path, copy: Path, sources: Sequence[str], job: dict[str, Any]) -> dict[str, Any]:
    """A mutant of what runs at import, in a process of its own: the cheapest tests first, since it has to collect."""
    start = time.monotonic()
    cheap = {name.partition("::")[0] for name, _ in job["tests"][:20]}
    rest = [one for one in job["tests"] if one[0].partition("::")[0] not in cheap]
    ran = 0
    for part in ([one for one in job["tests"] if one not in rest], rest):
        if not part:
            continue
        (answer,) = list(_serve(work, copy, sources, [job | {"mutated": None, "tests": part}])) or [None]
        ran += len(part)
        if answer is None or answer["outcome"] in KILLED or answer["ran"] < len(part):
            # A change that keeps tests from being collected is noticed as well.
            found = answer if answer and answer["outcome"] in KILLED else {"outcome": "crashed", "test": part[0][0]}
            return {**found, "ran": ran, "seconds": time.monotonic() - start}
    outcome = "survived" if ran else "not run by any test"
    return {"outcome": outcome, "test": "", "ran": ran, "seconds": time.monotonic() - start}


class _changed:
    """A block in which a file of the copy has another text. Its time is one that no other text of it had, since by it
    Python tells whether compiled code is old."""

    def __init__(self, file: Path, text: str, number: int) -> None:
        self._file, self._text, self._number = file, text, number

    def __enter__(self) -> None:
        self._before, self._times = self._file.read_bytes(), self._file.stat()
        self._file.write_text(self._text)
        now = time.time() + 10 * self._number
        os.utime(self._file, (now, now))

    def __exit__(self, *_: object) -> None:
        self._file.write_bytes(self._before)
        os.utime(self._file, ns=(self._times.st_atime_ns, self._times.st_mtime_ns))


def _serve(work: Path, copy: Path, sources: Sequence[str], jobs: Sequence[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    if not jobs:
        return
    files = sorted({name.partition("::")[0] for job in jobs for name, _ in job["tests"]})
    reader, writer = os.pipe()
    process = _start(work, copy, "serve", files, {"jobs": jobs, "sources": sources}, answers=writer)
    os.close(writer)
    try:
        with os.fdopen(reader) as answers:
            for line in answers:
                yield json.loads(line)
    finally:
        process.terminate()
        process.wait()


def _by_file(whole: dict[str, Any], files: Sequence[str]) -> dict[str, dict[str, Any]]:
    """A map of several files of tests, cut into one for each file."""
    owners = [test["name"].partition("::")[0] for test in whole["tests"]]
    numbers = {file: [number for number, owner in enumerate(owners) if owner == file] for file in files}
    parts = {}
    for file, own in numbers.items():
        place = {number: index for index, number in enumerate(own)}
        lines = {
            source: {line: found for line, ran in by_line.items() if (found := [place[n] for n in ran if n in place])}
            for source, by_line in whole["lines"].items()
        }
        parts[file] = {"tests": [whole["tests"][number] for number in own], "lines": lines}
    return parts


def _start(
    work: Path, copy: Path, what: str, files: Sequence[str], order: dict[str, Any], answers: int | None = None
) -> subprocess.Popen[bytes]:
    file = work / f"{what}.json"
    file.write_text(json.dumps({"temporary": str(work / "temporary"), **order}))
    environment = os.environ | {
        "CI": "1",  # hypothesis draws the same examples in every run
        "DOFBENCH_DATA": os.environ.get("DOFBENCH_DATA", str(ROOT.parent / "shared" / "data")),
        "NUMBA_CACHE_DIR": str(work / "numba"),
        "NUMBA_THREADING_LAYER": "workqueue",  # GNU's OpenMP gives up in a fork
        "OMP_NUM_THREADS": "1",
        "PYTHONPATH": os.pathsep.join([str(copy), str(ROOT / "benchmarks")]),
    }
    if answers is not None:
        environment["MUTATION_ANSWERS"] = str(answers)
    command = [sys.executable, "-c", "import mutation_child; mutation_child.main()", what, str(file), *files]
    with (work / f"{what}.log").open("ab") as log:
        return subprocess.Popen(
            command, cwd=copy, env=environment, stdout=log, stderr=log, pass_fds=[] if answers is None else [answers]
        )


def _copy(root: Path, copy: Path) -> None:
    """Bring the copy up to date with the checkout's files, committed or not; what lies there beside them stays."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "-c", "-o", "--exclude-standard"],
        cwd=root,
        capture_output=True,
        text=True,
        check=True,
    )
    names = {name for name in listed.stdout.split("\0") if name and (root / name).is_file()}
    kept = copy.parent / "copied.json"
    for name in set(json.loads(kept.read_text())) - names if kept.is_file() else ():
        (copy / name).unlink(missing_ok=True)
    for name in names:
        there, stat = copy / name, (root / name).stat()
        if not there.is_file() or (there.stat().st_mtime_ns, there.stat().st_size) != (stat.st_mtime_ns, stat.st_size):
            there.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(root / name, there)
    kept.write_text(json.dumps(sorted(names)))


def _test_files(copy: Path) -> list[Path]:
    found = []
    for name in TESTS:
        path = copy / "tests" / name
        found += sorted(path.rglob("test_*.py")) if path.is_dir() else [path]
    return found


def _holds(row: dict[str, str], code: str, suite: str, equal: Collection[str]) -> bool:
    """Whether a row still says what becomes of its mutant. equal: ids of mutants that no test can kill."""
    return row["code"] == code and (row["outcome"] in KILLED or row["suite"] == suite or row["id"] in equal)


def _row(mutant: Mutant, answer: dict[str, Any]) -> dict[str, str]:
    return {
        "id": mutant.id,
        "file": mutant.file,
        "line": str(mutant.line),
        "function": mutant.name,
        "operator": mutant.operator,
        "before": mutant.before,
        "after": mutant.after,
        "outcome": answer["outcome"],
        "killed_by": answer["test"],
        "tests": str(answer["ran"]),
        "seconds": f"{answer['seconds']:.2f}",
    }


def _digest(root: Path, files: Iterable[Path]) -> str:
    whole = hashlib.sha256()
    for name in sorted(str(file.relative_to(root)) for file in files):
        whole.update(name.encode() + b"\0" + hashlib.sha256((root / name).read_bytes()).digest())
    return whole.hexdigest()[:12]


def _commit() -> str:
    found = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return found.stdout.strip()


if __name__ == "__main__":
    main(tyro.cli(Settings))
