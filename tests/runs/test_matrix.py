"""A matrix of runs: which runs it consists of, its messages, and that each run equals that of a separate command."""

from __future__ import annotations

import io
import itertools
import re
import shlex
from collections.abc import Callable
from pathlib import Path

import pytest
from fake_method import fake_run
from harness_fakes import Here
from rich.console import Console
from small_dataset import write_dataset

from dofbench.cli import app
from dofbench.cli import run_methods as command
from dofbench.cli.run_methods import run_methods
from dofbench.core.budget import Budget, parse_budget
from dofbench.core.errors import InputError
from dofbench.core.jobs import Job
from dofbench.evaluation.results.result import read_result
from dofbench.evaluation.results.run_lock import run_lock
from dofbench.evaluation.results.run_spec import RunSpec
from dofbench.running.run_options import Runs

MINUTE, BOTH = Budget(seconds=60.0), Budget(steps=7000, seconds=300.0)


@pytest.fixture
def call(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable:
    """A single run, as `fake_run`."""
    write_dataset(tmp_path / "other", name="ripples", seed=1)
    return fake_run(tmp_path, monkeypatch)


@pytest.fixture
def matrix(call, tmp_path: Path) -> Callable[..., tuple[bool, list[str], str]]:
    """`matrix(seeds=2, …)` makes a matrix of the fakes: whether all went well, the runs made, what was said."""

    def matrix(fatal: int | None = None, **changes) -> tuple[bool, list[str], str]:
        here, stream = Here(fatal), io.StringIO()
        settings = Runs(
            **{
                "method": "fake,pinhole",
                "data": f"{tmp_path / 'data'},{tmp_path / 'other'}",
                "out": tmp_path / "results",
                **changes,
            }
        )
        good = run_methods(settings, Console(file=stream, width=400), here)
        return good, here.made, stream.getvalue()

    return matrix


def results(folder: Path) -> dict[str, bytes]:
    """Every result's bytes, by its folder."""
    return {str(file.parent.relative_to(folder)): file.read_bytes() for file in sorted(folder.rglob("result.json"))}


def test_every_combination_is_a_run() -> None:
    cells = Runs(method="a, b", data="x,y", seeds=2, seed=5, budget=(MINUTE, BOTH), preset="p,q").cells()
    assert len(cells) == len(set(cells)) == 2 * 2 * 2 * 2 * 2
    assert [cell.seed for cell in cells] == [5] * 16 + [6] * 16  # the first seed's first
    assert {(cell.data, cell.budget) for cell in cells} == {
        (Path(data), budget) for data in "xy" for budget in (MINUTE, BOTH)
    }
    assert {(cell.method, cell.preset) for cell in cells} == {("a", "p"), ("a", "q"), ("b", "p"), ("b", "q")}


@pytest.mark.parametrize("shards", [1, 2, 3, 7])
def test_shards_are_all_runs_together_and_each_once(shards: int) -> None:
    call = {"method": "a,b,c,d", "data": "x,y", "seeds": 3}
    shares = [Runs(**call, shard=f"{number}/{shards}").cells() for number in range(1, shards + 1)]
    assert sorted(map(str, itertools.chain(*shares))) == sorted(map(str, Runs(**call).cells()))
    assert max(map(len, shares)) - min(map(len, shares)) <= 1
    if shards == 2:  # methods cost differently: no share has one method alone
        assert all(len({cell.method for cell in share}) == 4 for share in shares)


def test_one_of_each_is_the_run_it_always_was() -> None:
    parsed = app.parse("run --method a --data x --seed 3 --budget 300s,7000it --set k=1 l=2".split())
    assert parsed.cells() == (RunSpec(method="a", data=Path("x"), seed=3, budget=BOTH, set=("k=1", "l=2")),)


def test_a_folder_with_a_comma_is_one(tmp_path: Path) -> None:
    (tmp_path / "a,b").mkdir()
    assert [cell.data for cell in Runs(method="m", data=str(tmp_path / "a,b")).cells()] == [tmp_path / "a,b"]


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"seeds": 0}, "--seeds"),
        ({"jobs": 0}, "--jobs"),
        ({"method": "a,a"}, "a 2 times"),
        ({"data": "x,,y"}, "--data"),
        ({"budget": ()}, "--budget"),
        ({"budget": (MINUTE, parse_budget("1min"))}, "60s 2 times"),
        ({"preset": "p,p"}, "p 2 times"),
        ({"shard": "2"}, "--shard"),
        ({"shard": "3/2", "seeds": 4}, "one of so many"),
        ({"shard": "2/2"}, "a share with a run in it"),
    ],
)
def test_impossible_matrices(changes: dict, match: str) -> None:
    with pytest.raises(InputError, match=match):
        Runs(**{"method": "a", **changes}).cells()


@pytest.mark.slow
def test_a_run_of_a_matrix_is_the_single_run(call, matrix, tmp_path: Path) -> None:
    single = call(method="pinhole", data=tmp_path / "other", seed=1)
    before = (single.folder / "result.json").read_bytes()
    good, made, said = matrix(seeds=2)
    assert good and len(made) == 7 and "8 runs, 1 of them cached" in said
    assert (single.folder / "result.json").read_bytes() == before
    for file in sorted((tmp_path / "results").rglob("result.json")):
        result = read_result(file)
        (cell,) = app.parse(shlex.split(result.command)[1:]).cells()
        assert call(method=cell.method, data=cell.data, seed=cell.seed, out=cell.out).reused
        assert file.parent == cell.out / result.spec.folder


@pytest.mark.slow
def test_nothing_runs_twice_and_more_is_added(matrix, tmp_path: Path) -> None:
    assert len(matrix(seeds=1)[1]) == 4
    before = results(tmp_path / "results")
    assert matrix(seeds=1)[:2] == (True, [])
    _, made, _ = matrix(seeds=2)
    assert len(made) == 4 and all("seed1" in name for name in made)
    _, made, _ = matrix(seeds=1, budget=(Budget(steps=8), Budget(steps=9)))
    assert len(made) == 4  # the preset's own budget is 8it: those are there
    assert before.items() <= results(tmp_path / "results").items()
    assert len(matrix(seeds=1, rerun=True)[1]) == 4


def test_an_interrupted_call_goes_on(matrix, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        matrix(fatal=3)
    before = results(tmp_path / "results")
    good, made, _ = matrix()
    assert good and len(before) == 3 and len(made) == 1
    assert before.items() <= results(tmp_path / "results").items()


def test_a_dry_run_lists_every_run(matrix, tmp_path: Path) -> None:
    good, made, said = matrix(dry_run=True, seeds=2)
    assert good and not made and not (tmp_path / "results").exists()
    assert said.count("to be run, time unknown: dofbench run --method ") == 8 and "8 runs, 0 of them" in said
    assert "no finished run of this kind" in said
    assert "fake (quick, seed 0, cpu) on waves, refocus-v3; seeds 0, 1" in said
    assert "  no delta_a, delta_f, delta_r: the method learns no lens" in said
    matrix(method="fake", data=str(tmp_path / "data"))
    _, _, said = matrix(dry_run=True, seeds=2)
    assert said.count("cached: dofbench") == 1 and len(re.findall(r"to be run, about \d+ s: ", said)) == 3
    assert said.count("to be run, time unknown") == 4  # nothing is known of the other dataset
    assert re.search(r"8 runs, 1 of them cached\nabout \d+ s to go", said)
    _, _, said = matrix(dry_run=True, seeds=2, budget=(Budget(seconds=1000.0),))
    assert said.count("to be run, about 1008 s") >= 4  # by the budget alone, where nothing else is known
    assert re.search(r"about 1[34]\d min to go, 1 at a time", said)


def test_a_failing_run_names_itself_and_stops_nothing(matrix, tmp_path: Path) -> None:
    good, made, said = matrix(set=("trouble=crash",), method="fake")
    assert not good and len(made) == 2
    assert said.count("failed: ") == 2 and said.count("crashed: RuntimeError: something broke") == 2
    assert "0 of 2 runs ok" in said
    assert len(matrix(set=("trouble=crash",), method="fake")[1]) == 2  # the machine's fault, perhaps: tried again
    good, made, said = matrix(set=("trouble=lost",), method="fake")
    assert not good and len(made) == 2 and said.count("diverged: loss is nan at step 3") == 2
    good, made, said = matrix(set=("trouble=lost",), method="fake", dry_run=True)
    assert said.count("cached, diverged: dofbench run") == 2
    assert matrix(set=("trouble=lost",), method="fake")[:2] == (False, [])


def test_one_method_s_failure_is_its_own(matrix, tmp_path: Path) -> None:
    code = tmp_path / "methods" / "pinhole" / "behaviour.py"
    code.write_text(code.read_text().replace("    if step <", '    raise RuntimeError("broken")\n    if step <'))
    good, made, said = matrix()
    assert not good and len(made) == 4 and "2 of 4 runs ok" in said
    assert len(re.findall(r"^failed: .*/pinhole-quick-seed0-.*: crashed: .*$", said, re.MULTILINE)) == 2


def test_a_result_that_cannot_be_read_is_named_and_kept(matrix, tmp_path: Path) -> None:
    matrix()
    file = next((tmp_path / "results").rglob("pinhole*/result.json"))
    file.write_text("{")
    good, made, said = matrix()
    assert not good and len(made) == 1 and file.read_text() == "{"
    assert f"failed: {file.parent}: {file}: found no JSON" in said


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"method": "fake,nobodys"}, r"nobodys on .*: method: found 'nobodys'"),
        ({"preset": "best"}, "fake on .*: preset of fake: found 'best'"),
        ({"set": ("nose=1",)}, "fake on .*: option nose"),
    ],
)
def test_a_wrong_call_is_one_line_before_anything_runs(matrix, tmp_path: Path, changes: dict, match: str) -> None:
    with pytest.raises(InputError, match=match):
        matrix(**changes)
    assert not (tmp_path / "results").exists()


@pytest.fixture
def builtin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The folders in which the built-in dataset was made, which here is a small one in tmp_path/builtin."""
    made: list[Path] = []
    monkeypatch.setattr(command, "builtin_folder", lambda: tmp_path / "builtin")
    monkeypatch.setattr(command, "make_dataset", lambda settings: made.append(write_dataset(settings.out)))
    return made


@pytest.mark.parametrize("methods", [("fake",), ("fake", "pinhole")], ids=["one run", "a matrix"])
def test_without_data_the_builtin_dataset_is_made_once(matrix, tmp_path: Path, builtin: list[Path], methods) -> None:
    call = {"method": ",".join(methods), "data": None}
    _, _, said = matrix(**call, dry_run=True)
    assert "would first make the built-in dataset" in said and not builtin
    with pytest.raises(InputError, match="preset of fake"):
        matrix(**call, preset="best")
    assert not builtin  # a wrong call makes nothing
    assert matrix(**call)[0] and matrix(**call)[0] and builtin == [tmp_path / "builtin"]
    found = [read_result(file) for file in (tmp_path / "results").rglob("result.json")]
    out = tmp_path / "results"
    assert {result.command for result in found} == {f"dofbench run --method {method} --out {out}" for method in methods}
    assert {result.data for result in found} == {str(tmp_path / "builtin")}


def test_one_dataset_under_two_names_is_refused(matrix, tmp_path: Path) -> None:
    copy = write_dataset(tmp_path / "copy")
    with pytest.raises(InputError, match="every dataset once"):
        matrix(data=f"{tmp_path / 'data'},{copy}")


def test_what_another_process_has_at_work_comes_last(call, matrix, tmp_path: Path) -> None:
    end = call()
    spec = read_result(end.folder).spec
    (end.folder / "result.json").unlink()
    with run_lock(end.folder, spec, "waves", "noon"):
        _, _, said = matrix(dry_run=True)
        assert said.count("at work in another process") == 1

        class Keeps:
            """An executor that keeps the jobs and does none."""

            at_a_time = 1

            def run(self, given, watcher):
                jobs.extend(given)
                return []

        jobs: list[Job] = []
        run_methods(
            Runs(method="fake,pinhole", data=str(tmp_path / "data"), out=tmp_path / "results"),
            Console(quiet=True),
            Keeps(),
        )
        assert [job.busy() for job in jobs] == [True, False]
    assert not any(job.busy() for job in jobs)
