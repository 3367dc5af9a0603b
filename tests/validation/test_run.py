"""The command: its tables, and that it continues from finished scores of the same code only."""

from __future__ import annotations

import csv
import io
import signal

import numpy as np
import pytest
from called import called, dofbench, killed
from rich.console import Console

from dofbench.cli import app
from dofbench.core.errors import InputError
from dofbench.core.images import write_exr
from dofbench.evaluation.renderer import planes, renderer_scores
from dofbench.evaluation.renderer import validate as run
from dofbench.evaluation.renderer.renderer_scores import FOLDER, score
from dofbench.evaluation.renderer.validation_options import ValidateRenderer
from dofbench.evaluation.renderer.variants import VARIANTS, Variant


def rows(folder):
    with (folder / "renderer.csv").open() as file:
        return list(csv.DictReader(file))


def validate(*truths, out, planes=False, pictures=False):
    text = io.StringIO()
    run.validate_renderer(ValidateRenderer(truths, out, planes, pictures), Console(file=text, width=200))
    return text.getvalue()


@pytest.fixture
def few(monkeypatch):
    """Two renderers of the many."""
    chosen = tuple(variant for variant in VARIANTS if variant.name in ("no blur", "scatter"))
    monkeypatch.setattr(run, "VARIANTS", chosen)
    return chosen


@pytest.fixture
def counted(monkeypatch, few):
    """What was scored: (scene, focus, variant)."""
    calls = []

    def counting(case, truth, variant):
        calls.append((case.name, case.focus, variant.name))
        return score(case, truth, variant)

    monkeypatch.setattr(run, "score", counting)
    return calls


@pytest.mark.slow
def test_tables_of_everything(rendered, blb, lightfield, tmp_path, monkeypatch):
    for file in (blb / "277").glob("bokeh_01_*.exr"):
        file.unlink()
    monkeypatch.setattr(planes, "SCENES", {name: planes.SCENES[name] for name in ("two walls", "highlights")})
    monkeypatch.setattr(run, "PLANE_RADII", (4.0,))
    monkeypatch.setattr(run, "PLANE_FOCUSES", (0.1,))
    said = validate(rendered, blb / "277", lightfield, out=tmp_path / "out", planes=True, pictures=True)
    assert "left" in said
    found = rows(tmp_path / "out")
    assert {row["variant"] for row in found} == {variant.name for variant in VARIANTS}
    planar = {"planes", "planes, hexagonal aperture"}
    assert {row["source"] for row in found} == planar | {"rendered", "BLB", "light field"}

    def mean(*wanted):
        rows_of = [row for row in found if (row["source"], row["region"], row["variant"]) == wanted]
        return np.mean([float(row["psnr"]) for row in rows_of])

    for source in ("planes", "rendered", "BLB", "light field"):
        names = ("no blur", "scatter", "scatter, 8-bit input")
        by_variant = {name: mean(source, "all", name) for name in names}
        assert by_variant["scatter"] > by_variant["no blur"]
        if source in ("rendered", "BLB"):  # highlights 30 times as bright as white
            assert by_variant["scatter"] > by_variant["scatter, 8-bit input"] + 1
    # Only where there is a scene to look at through a lens.
    assert {row["source"] for row in found if row["variant"].startswith("thinlens")} == planar
    assert {row["region"] for row in found} >= {"all", "blurred", "depth edge", "frame"}
    text = (tmp_path / "out" / "renderer.md").read_text()
    assert "43.30 dB / 0.9932" in text and "Unfinished" not in text and str(tmp_path) not in text
    for heading in ("## rendered", "## BLB", "| layered, 16 |", "By scene", "Error against run time"):
        assert heading in text
    assert (tmp_path / "out" / "precision.png").is_file()
    assert len(list((tmp_path / "out" / "pictures").glob("*.png"))) == 2 + 2 + 2 + 2 + 3


def test_a_second_call_scores_nothing(rendered, tmp_path, counted):
    validate(rendered, out=tmp_path)
    first, table = len(counted), (tmp_path / "renderer.csv").read_bytes()
    assert first == 2 * 2
    (tmp_path / "renderer.md").unlink()
    assert "2 of 2 photographs are scored already" in validate(rendered, out=tmp_path)
    assert len(counted) == first and (tmp_path / "renderer.csv").read_bytes() == table
    assert (tmp_path / "renderer.md").is_file()


@pytest.mark.slow
def test_what_changed_is_scored_again_and_the_rest_kept(rendered, tmp_path, counted, few, monkeypatch):
    validate(rendered, out=tmp_path)
    counted.clear()
    write_exr(rendered / "lens" / "a_0.5.exr", np.full((120, 160, 3), 0.2))
    validate(rendered, out=tmp_path)
    assert {focus for _, focus, _ in counted} == {0.5}
    counted.clear()
    monkeypatch.setattr(run, "VARIANTS", (*few, Variant("copy", few[1].render)))
    validate(rendered, out=tmp_path)
    assert {name for _, _, name in counted} == {"copy"}
    counted.clear()
    monkeypatch.setattr(renderer_scores, "package_digest", lambda packages: "f" * 64)
    validate(rendered, out=tmp_path)
    assert {name for _, _, name in counted} >= {"scatter", "copy"}
    assert all(file.name.startswith("ffff") for file in (tmp_path / FOLDER).iterdir())


@pytest.mark.slow
def test_an_interrupted_run_leaves_tables_and_goes_on(rendered, blb, tmp_path, counted, monkeypatch):
    whole = tmp_path / "whole"
    validate(rendered, blb, out=whole)
    total = len(counted)
    counted.clear()

    def interrupted(case, truth, variant):
        if len(counted) == total // 2:
            raise KeyboardInterrupt
        counted.append((case.name, case.focus, variant.name))
        return score(case, truth, variant)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(run, "score", interrupted)
        validate(rendered, blb, out=tmp_path / "out")
    assert 0 < len(rows(tmp_path / "out")) < len(rows(whole))
    assert "Unfinished" in (tmp_path / "out" / "renderer.md").read_text()
    validate(rendered, blb, out=tmp_path / "out")
    assert len(counted) == total  # nothing twice

    def scores(folder):
        return [{key: value for key, value in row.items() if not key.startswith("seconds")} for row in rows(folder)]

    assert scores(tmp_path / "out") == scores(whole)
    assert "Unfinished" not in (tmp_path / "out" / "renderer.md").read_text()


@pytest.mark.slow
def test_half_a_file_of_scores_counts_as_none(rendered, tmp_path, counted):
    validate(rendered, out=tmp_path)
    counted.clear()
    kept = sorted((tmp_path / FOLDER).iterdir())
    kept[0].write_bytes(kept[0].read_bytes()[:200])
    validate(rendered, out=tmp_path)
    assert len({focus for _, focus, _ in counted}) == 1


@pytest.mark.slow
def test_killed_at_any_moment_it_goes_on(blb, tmp_path):
    """As a user calls it, ended by SIGKILL once something is kept, and called again."""
    call = dofbench("validate-renderer", blb / "277", "--no-planes", "--no-pictures", "--out", tmp_path / "out")
    done = killed(call, lambda: bool(list((tmp_path / "out" / FOLDER).glob("*.json"))))
    assert done.returncode == -signal.SIGKILL, done.stdout
    kept = {file.name: file.stat().st_mtime_ns for file in (tmp_path / "out" / FOLDER).glob("*.json")}
    assert kept
    done = called(call)
    assert done.returncode == 0, done.stderr
    assert len({(row["name"], row["aperture"], row["focus"]) for row in rows(tmp_path / "out")}) == 4


def test_a_wrong_folder_is_one_line_and_status_2(tmp_path, capsys):
    assert app.main(["validate-renderer", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "scene.json" in said


def test_nothing_to_do_is_said(tmp_path):
    with pytest.raises(InputError, match="no folder"):
        validate(out=tmp_path)
