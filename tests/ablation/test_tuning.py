"""The table `tuning`: as many variants for every method, on development scenes alone; and roles in tables."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from pathlib import Path

import pytest
from fake_method import fake_run
from harness_fakes import Here
from rich.console import Console
from small_dataset import write_dataset

from dofbench.cli import app
from dofbench.cli.ablate import make_tables
from dofbench.core.content import content_folder
from dofbench.core.errors import InputError
from dofbench.core.evidence import PHOTOGRAPHER_SAYS, ROLE_SAYS
from dofbench.methods.cards import find_method
from dofbench.methods.frozen_presets import choices_digest
from dofbench.reporting.boards import NOTES
from dofbench.running.ablation_options import Ablate
from dofbench.running.ablation_tables import TUNING, read_tables, tables_of

TABLE = """
[[tables]]
id = "{id}"
title = "{title}"
columns = ["aif_psnr"]
reference = "base"

[[tables.rows]]
label = "base"

[[tables.rows]]
label = "noisy"
set = {{ noise = 0.8 }}
"""
TABLES = TABLE.format(id="tuning", title="Tried") + TABLE.format(id="other", title="Another")
# dofgaussian is as its paper has it, and isn't tuned.
METHODS = sorted({path.parent.name for path in content_folder("methods").glob("*/method.toml")} - {"dofgaussian"})


@pytest.fixture
def ablate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """`ablate(data, …)` makes the tables of a fake method; returns what was said."""
    fake_run(tmp_path, monkeypatch)
    for method in ("fake", "pinhole"):
        (tmp_path / "methods" / method / "ablations.toml").write_text(f'method = "{method}"\n{TABLES}')

    def call(*data: Path, **changes) -> str:
        stream = io.StringIO()
        asked = {"method": "fake", "seeds": 2, "results": tmp_path / "results", "out": tmp_path / "out", **changes}
        assert make_tables(Ablate(data=",".join(map(str, data)), **asked), Console(file=stream, width=400), Here())
        return stream.getvalue()

    return call


def scene(folder: Path, name: str, role, by: str | None) -> Path:
    return write_dataset(folder / name, name=name, role=role, role_by=by)


def test_every_method_has_as_many_variants() -> None:
    tables = {method: {one.id: one for one in read_tables(tables_of(method)).tables} for method in METHODS}
    counts = {method: len(found[TUNING].rows) for method, found in tables.items()}
    assert set(counts.values()) == {12}, counts
    for method, found in tables.items():
        base, *others = found[TUNING].rows
        assert base.label == found[TUNING].reference and not base.set
        assert all(row.set and row.method is None and row.preset is None for row in others)
        assert {"seed", "budget", "steps"}.isdisjoint(key for row in others for key in row.set)
        # Every variant is another run than the preset's, and than the other variants'.
        entry = find_method(method)
        _, options, _ = entry.preset("cpu")
        entry.create({**options}, 0, "cpu")
        digests = set()
        for row in found[TUNING].rows:
            entry.create({**options, **row.set}, 0, "cpu")  # raises for an unknown option
            digests.add(choices_digest(entry, {**options, **row.set}, budget=None, force_all=False))  # type: ignore[arg-type]
        assert len(digests) == len(found[TUNING].rows)


def test_the_method_s_own_tables_are_taken(ablate: Callable[..., str], tmp_path: Path) -> None:
    data = scene(tmp_path, "fern", "development", "llff/fern")
    ablate(data, table=TUNING)
    ablate(data, table=TUNING, method="pinhole", out=tmp_path / "out" / "pinhole")
    for folder, method in ((tmp_path / "out", "fake"), (tmp_path / "out" / "pinhole", "pinhole")):
        table = list(csv.DictReader(io.StringIO((folder / "tuning.csv").read_text())))
        assert {row["method"] for row in table} == {method} and {row["role"] for row in table} == {"development"}
        assert {(row["row"], row["options"], row["budget"]) for row in table} == {
            ("base", "", "8it"),
            ("noisy", "noise=0.8", "8it"),
        }
        assert len(table) == 4 and all(row["value"] for row in table)


def test_nothing_is_tuned_on_a_report_scene(ablate: Callable[..., str], tmp_path: Path, capsys) -> None:
    report = scene(tmp_path, "room", "report", "llff/room")
    with pytest.raises(InputError, match="table tuning: found room, a report scene, expected development scenes"):
        ablate(report, table=TUNING)
    words = ["ablate", "--method", "fake", "--table", TUNING, "--data", str(report), "--out", str(tmp_path / "none")]
    assert app.main(words) == 2
    error = capsys.readouterr().err
    assert "room, a report scene" in error and error.count("\n") == 1
    assert not (tmp_path / "none").exists() and not (tmp_path / "results").exists()
    said = ablate(report)  # all tables of the file: the others are made
    assert "skipping table tuning: room is a test scene" in said
    assert not (tmp_path / "out" / "tuning.md").exists() and (tmp_path / "out" / "other.md").exists()
    ablate(scene(tmp_path, "mine", None, None), table=TUNING)  # a scene of one's own


@pytest.mark.slow
@pytest.mark.parametrize("other", [("development", "llff/fern"), (None, None)])
def test_a_table_never_averages_over_roles(ablate: Callable[..., str], tmp_path: Path, other: tuple) -> None:
    report = scene(tmp_path, "room", "report", "llff/room")
    with pytest.raises(InputError, match="--data: found report scenes and other, expected scenes of one role"):
        ablate(report, scene(tmp_path, "other", *other), table="other")
    ablate(report, scene(tmp_path, "attic", "report", "report/attic"), table="other")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("role", "by", "sign"), [("development", "llff/fern", "†"), ("report", "llff/room", "‡"), (None, None, "")]
)
def test_rows_are_marked_and_sections_say_the_role(
    ablate: Callable[..., str], tmp_path: Path, role, by: str | None, sign: str
) -> None:
    first, second = (scene(tmp_path, name, role, by) for name in ("one", "two"))
    second = write_dataset(second, name="two", role=role, role_by=by, test=3)
    ablate(first, second, table="other")
    page = (tmp_path / "out" / "other.md").read_text()
    assert page.count(f"{ROLE_SAYS[role]} {PHOTOGRAPHER_SAYS['scatter']} Trained on") == 2
    rows = [line.split("|")[1].strip() for line in page.splitlines() if line.startswith(("| base", "| noisy"))]
    expected = [f"{label} {sign}".strip() for label in ("base", "noisy")]
    # mean, difference, and the two datasets; what the rows are comes last, without figures
    assert rows == [*expected, expected[1], *expected, *expected, "base", "noisy"]
    assert page.count(NOTES[sign]) == 4 if sign else not any(note in page for note in NOTES.values())
