"""Freezing presets: by content and commit, and told apart in results."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from fake_method import write_method

from dofbench.cli import app
from dofbench.core.content import content_folder
from dofbench.core.errors import InputError
from dofbench.evaluation.results.result import read_result
from dofbench.methods.cards import find_method, preset_budget
from dofbench.methods.frozen_presets import choices_digest, freeze, frozen_presets, preset_digest, state_of


def git(folder: Path, *words: str) -> str:
    identity = ("-c", "user.name=nobody", "-c", "user.email=nobody@nowhere")
    done = subprocess.run(["git", "-C", str(folder), *identity, *words], capture_output=True, text=True, check=True)
    return done.stdout.strip()


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The fake method in a repository of its own, with everything committed."""
    root = write_method(tmp_path / "methods")
    monkeypatch.setenv("DOFBENCH_METHODS", str(root))
    git(tmp_path, "init", "-q", str(root))
    git(root, "add", ".")
    git(root, "commit", "-qm", "A method")
    return root


def change(root: Path, old: str, new: str, file: str = "method.toml") -> None:
    path = root / "fake" / file
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))


def test_a_preset_is_frozen_at_a_commit(checkout: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert frozen_presets(checkout / "fake") == {}
    assert app.main(["methods", "fake", "--freeze", "quick"]) == 0
    said = capsys.readouterr().out
    (entry,) = frozen_presets(checkout / "fake").values()
    assert entry.commit == git(checkout, "rev-parse", "HEAD") and entry.commit[:12] in said
    assert entry.digest == preset_digest(find_method("fake"), "quick")
    assert app.main(["methods", "fake"]) == 0
    assert f"quick: fixed at {entry.commit[:12]}, the default" in capsys.readouterr().out
    # A second preset can be frozen before the file is committed, and the first one stays as it was.
    git(checkout, "commit", "-q", "--allow-empty", "-m", "Something else")
    assert freeze("fake", "quick") == entry
    presets = [name for name in find_method("fake").card.presets if name != "quick"]
    freeze("fake", presets[0])
    assert frozen_presets(checkout / "fake")["quick"] == entry and len(frozen_presets(checkout / "fake")) == 2


def test_a_changed_preset_is_told_and_not_frozen_over(checkout: Path, capsys: pytest.CaptureFixture[str]) -> None:
    freeze("fake", "quick")
    git(checkout, "add", ".")
    change(checkout, "[presets.quick]", "[presets.quick]\nnoise = 0.7")
    git(checkout, "commit", "-qam", "Another preset")
    with pytest.raises(InputError, match="found other options than at .*expected another name"):
        freeze("fake", "quick")
    assert app.main(["methods", "fake"]) == 0 and ", and changed since" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("edit", "found"),
    [
        (lambda root: change(root, 'summary = "A fake"', 'summary = "A forgery"'), "uncommitted changes"),
        (lambda root: (root / "fake" / "new.py").touch(), "uncommitted changes"),
        (lambda root: git(root, "rm", "-q", "--cached", "fake/method.toml"), "no commit"),
    ],
)
def test_only_what_is_committed_is_frozen(checkout: Path, edit: Callable[[Path], object], found: str) -> None:
    edit(checkout)
    with pytest.raises(InputError, match=found):
        freeze("fake", "quick")
    assert not (checkout / "fake" / "frozen.toml").exists()


def test_a_wrong_call_is_one_line(checkout: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["--freeze", "quick"], ["fake", "--freeze", "perfect"], ["nobody", "--freeze", "quick"]):
        assert app.main(["methods", *words]) == 2
        assert capsys.readouterr().err.count("\n") == 1
    (checkout / "fake" / "frozen.toml").write_text('[presets.quick]\ncommit = "abc"\n')
    with pytest.raises(InputError, match=r"frozen.toml: found presets.quick.commit: .*; presets.quick.digest"):
        frozen_presets(checkout / "fake")


@pytest.mark.parametrize(
    ("call", "state"),
    [
        ({}, "frozen"),
        ({"seed": 3}, "frozen"),
        ({"inputs": "all-in-focus"}, "frozen"),  # the plan leaves the lens out: the preset is the same
        ({"set": ("noise=0.2",)}, "frozen"),  # what the preset has anyway
        ({"set": ("noise=0.4",)}, "changed"),
        ({"budget": "5it"}, "other budget"),
        ({"budget": "5it", "set": ("noise=0.4",)}, "changed"),
        ({"force_all": True}, "changed"),
    ],
)
def test_a_result_says_whether_the_frozen_preset_made_it(
    checkout: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: dict, state: str
) -> None:
    from fake_method import fake_run

    change(checkout, "[presets.quick]", "[presets.quick]\nnoise = 0.2")
    git(checkout, "commit", "-qam", "Noise of its own")
    freeze("fake", "quick")
    frozen = (checkout / "fake" / "frozen.toml").read_text()
    card = (checkout / "fake" / "method.toml").read_text()
    run = fake_run(tmp_path / "runs", monkeypatch)
    (tmp_path / "runs" / "methods" / "fake" / "frozen.toml").write_text(frozen)
    (tmp_path / "runs" / "methods" / "fake" / "method.toml").write_text(card)
    result = read_result(run(**call).folder)
    budget = result.spec.budget
    assert state_of("fake", "quick", result.choices, budget) == state
    for method, preset in (("fake", "slow"), ("nobody", "quick")):
        assert state_of(method, preset, result.choices, budget) == "not frozen"
    assert state_of("fake", "quick", None, budget) == "changed"


def test_a_preset_that_changed_since_is_not_told_from_the_frozen_one_by_its_budget_alone(
    checkout: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from fake_method import fake_run

    freeze("fake", "quick")
    frozen = (checkout / "fake" / "frozen.toml").read_text()
    change(checkout, "[presets.quick]", "[presets.quick]\nnoise = 0.2")
    card = (checkout / "fake" / "method.toml").read_text()
    run = fake_run(tmp_path / "runs", monkeypatch)
    (tmp_path / "runs" / "methods" / "fake" / "frozen.toml").write_text(frozen)
    (tmp_path / "runs" / "methods" / "fake" / "method.toml").write_text(card)
    result = read_result(run(budget="5it").folder)
    assert state_of("fake", "quick", result.choices, result.spec.budget) == "changed"


def test_a_changed_default_or_stage_is_another_preset() -> None:
    """With the real method: what its card doesn't say is part of what was chosen."""
    entry = find_method("lensselect")
    digest = preset_digest(entry, "cpu")
    assert digest == preset_digest(entry, "cpu") and digest != preset_digest(entry, "thinlens")
    stages = dict(entry.card.stages)
    del stages["harmonics"]
    other = entry.card.model_copy(update={"stages": stages})
    assert digest != preset_digest(type(entry)(entry.id, entry.folder, other), "cpu")


def test_a_default_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    entry = find_method("mipsplatting")
    digest = preset_digest(entry, "cpu")
    kind = entry.method_class()
    options = kind.available_options()
    fewer = tuple(option for option in options if option.name != "filter_2d")
    assert len(fewer) == len(options) - 1
    monkeypatch.setattr(kind, "available_options", classmethod(lambda cls: fewer))
    assert preset_digest(entry, "cpu") != digest


def test_every_shipped_method_says_what_is_frozen() -> None:
    for card in content_folder("methods").glob("*/method.toml"):
        file = card.parent / "frozen.toml"
        presets = frozen_presets(card.parent)
        assert file.is_file() and presets.keys() <= find_method(card.parent.name).card.presets.keys()
        assert bool(presets) is not ("No preset is frozen yet" in file.read_text())


def test_an_old_result_has_no_digest(checkout: Path) -> None:
    old = Path(__file__).parent / "old_results" / "v1-ok.json"
    assert read_result(old).choices is None and json.loads(old.read_text())["schema_version"] == 1


def test_the_neutral_value_of_a_newer_option_is_no_choice() -> None:
    entry = find_method("lensselect")
    name, options, budget = entry.preset("cpu")
    told = [
        choices_digest(entry, {**options, **more}, preset_budget(entry, name, options, budget), force_all=False)
        for more in ({}, {"lens_focus_from": "option"}, {"lens_focus_from": "exif"})
    ]
    assert told[0] == told[1] == frozen_presets(entry.folder)["cpu"].digest != told[2]
