"""`dofbench stability` as a user calls it."""

from __future__ import annotations

import csv
from importlib import import_module

import pytest
from called import called, dofbench

from dofbench.cli.app import main
from dofbench.evaluation.stability.catalogue import Limit
from dofbench.evaluation.stability.measure import measured
from dofbench.runtime.ops import load

HEADER = "case,group,backend,precision,error,bound,verdict,note"
CALL = ["stability", "--kernel", "ssim", "--group", "invariants"]


def table(out):
    text = (out / "stability.csv").read_text()
    return text.splitlines()[0], list(csv.DictReader(text.splitlines()))


@pytest.mark.slow
def test_one_kernel_of_one_group_as_a_user_runs_it(tmp_path):
    done = called(dofbench(*CALL, "--out", tmp_path))
    assert done.returncode == 0, done.stderr
    header, rows = table(tmp_path)
    assert header == HEADER
    assert {row["verdict"] for row in rows} == {"met"} and {row["group"] for row in rows} == {"invariants"}
    assert {(row["backend"], row["precision"]) for row in rows} >= {
        ("reference", "float64"),
        ("reference", "float32"),
        ("cpu", "float32"),
    }
    for row in rows:
        assert float(row["error"]) <= float(row["bound"])
    page = (tmp_path / "stability.md").read_text()
    assert "# Numerical stability" in page and "an image has SSIM 1 with itself" in page
    assert sorted(path.name for path in tmp_path.iterdir()) == ["stability.csv", "stability.md"]


def test_a_bound_that_is_not_met_ends_with_status_1_and_keeps_its_row(tmp_path, monkeypatch, capsys):
    kernel = load("ssim", "cpu", function="ssim")
    monkeypatch.setattr(
        import_module("dofbench.runtime.ops.ssim.cpu"), "ssim", lambda *args, **options: kernel(*args, **options) - 0.01
    )
    case = "invariants/ssim-of-itself-textured"
    assert main(["stability", "--case", case, "--out", str(tmp_path)]) == 1
    _, rows = table(tmp_path)
    assert [row["verdict"] for row in rows] == ["met", "met", "not met"]
    assert "not met: invariants/ssim-of-itself-textured cpu float32" in " ".join(capsys.readouterr().err.split())


def test_a_known_limit_is_in_the_table_with_its_reason_and_status_0(tmp_path):
    assert main(["stability", "--case", "invariants/order-at-equal-depth", "--out", str(tmp_path)]) == 0
    _, rows = table(tmp_path)
    assert {row["verdict"] for row in rows} == {"known limit"} and all("stored first" in row["note"] for row in rows)


def test_a_known_limit_that_is_met_on_this_machine_fails_nothing_and_says_so(tmp_path, monkeypatch):
    """A machine may round better than the one on which the limit was found."""
    limit = Limit("invariants/ssim-symmetric", ("cpu float32",), "Rounded badly somewhere.")
    monkeypatch.setattr(import_module("dofbench.evaluation.stability.measure"), "read_limits", lambda: (limit,))
    assert main(["stability", "--case", "invariants/ssim-symmetric", "--out", str(tmp_path)]) == 0
    _, rows = table(tmp_path)
    assert [row["verdict"] for row in rows] == ["met", "met", "met here"] and "Rounded badly" in rows[-1]["note"]
    page = (tmp_path / "stability.md").read_text()
    assert "2 met, 1 met here." in page


def test_an_interrupted_run_goes_on_from_what_is_measured(tmp_path, monkeypatch):
    run, count = import_module("dofbench.evaluation.stability.measure"), []

    def counted(case, setting):
        count.append(case.id)
        if len(count) == 4:
            raise KeyboardInterrupt
        return measured(case, setting)

    monkeypatch.setattr(run, "measured", counted)
    call = [*CALL, "--out", str(tmp_path)]
    assert main(call) == 130
    assert not (tmp_path / "stability.csv").exists()
    assert main(call) == 0
    _, rows = table(tmp_path)
    assert len(count) == len(rows) + 1  # the one that was interrupted, twice


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--group", "optics"], "--group: found 'optics'"),
        (["--kernel", "blur"], "--kernel: found 'blur'"),
        (["--method", "nobodys"], "method: found 'nobodys'"),
        (["--case", "lens/none"], "--case: found 'lens/none'"),
        (["--kernel", "ssim", "--method", "dofgaussian"], "--kernel: found --method as well"),
        (["--kernel", "stereo", "--group", "light"], "no case that fits"),
    ],
)
def test_a_wrong_call_is_one_line_and_status_2(options, words, tmp_path, capsys):
    assert main(["stability", *options, "--out", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_dry_run_lists_the_cases_and_runs_none(tmp_path, capsys):
    assert main([*CALL, "--dry-run", "--out", str(tmp_path / "none")]) == 0
    assert "invariants/ssim-symmetric" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()
