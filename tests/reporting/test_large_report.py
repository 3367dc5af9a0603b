"""A report of a thousand results: its pages stay small and open at once."""

from __future__ import annotations

import json
import os
import random
from collections.abc import Callable
from pathlib import Path

import pytest
from chromium import opened_in
from relisted import edit_json, write_again

from dofbench.core.files import sha256_file
from dofbench.evaluation.results.result import Spec
from dofbench.reporting.report_files import Written

SCENES, VARIANTS, SEEDS = 21, 16, 3
LARGEST = 5e6  # bytes
LONGEST = 1000  # ms, from the address to the end of loading


def spread_out(folder: Path, into: Path) -> None:
    """Copies of a folder's files by hard links, which take no space."""
    for file in [file for file in folder.rglob("*") if file.is_file()]:
        (into / file.relative_to(folder)).parent.mkdir(parents=True, exist_ok=True)
        os.link(file, into / file.relative_to(folder))


def scattered(scores: dict[str, float], chance: random.Random) -> None:
    for name in scores:
        scores[name] *= 1 + 0.02 * chance.random()


def copies(run: Path, data: Path, folder: Path) -> int:
    """Results of many scenes, variants and seeds, with scores and pictures; returns how many."""
    chance, result = random.Random(0), json.loads((run / "result.json").read_text())
    for scene in range(SCENES):
        place = folder / "data" / f"scene{scene:02}"
        spread_out(data, place)
        content = (place / "dataset.json").read_bytes()
        (place / "dataset.json").unlink()  # the others are links to it
        (place / "dataset.json").write_bytes(content)
        edit_json(place / "dataset.json", lambda manifest, name=place.name: manifest.update(name=name))
        checksum = sha256_file(place / "dataset.json")
        for number in range(VARIANTS * SEEDS):
            own = json.loads(json.dumps(result))
            noise = {"noise": round(0.01 * (1 + number // SEEDS), 2)}
            own["spec"] |= {"overrides": noise, "seed": number % SEEDS, "dataset": place.name}
            own["spec"]["options"] |= noise
            own["spec"]["dataset_checksum"] = checksum
            own |= {"key": Spec.model_validate(own["spec"]).key, "data": str(place), "data_from_here": ""}
            own["choices"] = f"{number // SEEDS}"
            for scores in (own["scores"], *(one["scores"] for one in (*own["views"], *own["curve"]))):
                scattered(scores, chance)
            target = folder / "results" / place.name / f"{number}"
            spread_out(run / "predictions", target / "predictions")
            write_again(target / "result.json", own)
    return SCENES * VARIANTS * SEEDS


@pytest.mark.slow  # a minute or two: most of it is the comparison of all rows with each other
def test_pages_of_a_thousand_results_are_small_and_open_at_once(
    plain: None, call: Callable, made: Callable[..., tuple[Written, Path, str]], tmp_path: Path
) -> None:
    run = call().folder.rename(tmp_path / "one")
    assert copies(run, tmp_path / "data", tmp_path / "many") > 1000
    (tmp_path / "many" / "results").rename(tmp_path / "results" / "many")
    _, out, _ = made()
    pages = sorted(out.rglob("*.html"))
    assert len(pages) == 4 * (1 + SCENES)
    assert {page.name: page.stat().st_size for page in pages if page.stat().st_size > LARGEST} == {}
    assert f"{SCENES * VARIANTS * SEEDS} runs" in (out / "report.html").read_text()
    for page in (*out.glob("*.html"), *(out / "scenes" / "scene00").glob("*.html")):
        assert opened_in(page) < LONGEST, page.name
