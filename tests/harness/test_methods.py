"""Finding and loading method folders."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from fake_method import METHOD_TOML, write_method

from dofbench.core.budget import Budget
from dofbench.core.errors import InputError
from dofbench.methods.cards import find_method, method_files, read_once


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    root = write_method(tmp_path / "methods")
    monkeypatch.setenv("DOFBENCH_METHODS", str(root))
    return root / "fake"


def test_the_shipped_methods_describe_themselves() -> None:
    methods = {name: find_method(name) for name in method_files()}
    assert {"dofgaussian", "mipsplatting"} <= set(methods)
    assert methods["dofgaussian"].card.capabilities.refocus
    assert not methods["mipsplatting"].card.capabilities.refocus
    for entry in methods.values():
        for name in entry.card.presets:
            entry.preset(name)


def test_a_card_is_read_once_within_a_block_alone(folder: Path) -> None:
    file = folder / "method.toml"
    with read_once():
        before = find_method("fake").card.summary
        file.write_text(file.read_text().replace(before, "Another summary"))
        assert find_method("fake").card.summary == before != "Another summary"
    assert find_method("fake").card.summary == "Another summary"
    with read_once():
        assert find_method("fake").card.summary == "Another summary"


def test_relative_imports_work(folder: Path) -> None:
    method = find_method("fake").create({"noise": 0.5}, 7, "cpu")
    assert method.options["noise"] == 0.5
    assert type(method).__module__ == "dofbench.methods.fake.trainer"


def test_another_folder_of_the_same_id_is_loaded_anew(folder: Path, tmp_path: Path, monkeypatch) -> None:
    first = type(find_method("fake").create({}, 0, "cpu"))
    other = write_method(tmp_path / "others")
    code = other / "fake" / "trainer.py"
    code.write_text(code.read_text() + "\n\nFake.mark = 'other'\n")
    monkeypatch.setenv("DOFBENCH_METHODS", str(other))
    second = type(find_method("fake").create({}, 0, "cpu"))
    assert second.mark == "other" and not hasattr(first, "mark")


def test_presets(folder: Path) -> None:
    entry = find_method("fake")
    assert entry.preset(None) == ("quick", {}, Budget(steps=8))
    assert entry.preset("slow") == ("slow", {"steps": 12, "noise": 0.2}, None)
    with pytest.raises(InputError, match="'fast', expected one of quick, slow"):
        entry.preset("fast")


def test_a_preset_extends_another_and_one_is_for_the_built_in_dataset(folder: Path) -> None:
    file = folder / "method.toml"
    text = file.read_text().replace('default_preset = "quick"', 'default_preset = "slow"\nbuiltin_preset = "short"')
    file.write_text(text + '\n[presets.short]\nextends = "slow"\nsteps = 3\n')
    entry = find_method("fake")
    assert entry.preset("short") == ("short", {"steps": 3, "noise": 0.2}, None)
    assert entry.preset(None, builtin=True)[0] == "short" and entry.preset(None)[0] == "slow"
    assert entry.preset("quick", builtin=True)[0] == "quick"


def test_a_preset_is_for_a_gpu(folder: Path) -> None:
    file = folder / "method.toml"
    text = file.read_text().replace('default_preset = "quick"', 'default_preset = "quick"\ngpu_preset = "slow"')
    file.write_text(text)
    entry = find_method("fake")
    assert entry.preset(None)[0] == "quick" == entry.preset("quick", device="cuda:1")[0]
    assert entry.preset(None, device="cuda:1")[0] == "slow" == entry.preset(None, device="cuda", builtin=True)[0]
    file.write_text(text.replace('default_preset = "quick"', 'default_preset = "quick"\nbuiltin_preset = "quick"'))
    assert find_method("fake").preset(None, device="cuda", builtin=True)[0] == "quick"
    file.write_text(text.replace('gpu_preset = "slow"', 'gpu_preset = "huge"'))
    with pytest.raises(InputError, match="gpu_preset = 'huge', expected one of quick, slow"):
        find_method("fake")


LIKE_FAKE = """\
name = "Fake again"
summary = "As the fake, but noisier"
paper = "Nobody, 2021"
class = "trainer:Fake"
like = "fake"
kernels = ["tone"]

[stages.colours]
decided_by = "colour_spread"
option = "tints"
off = 0

[presets.slow]
noise = 0.9

[presets.own]
extends = "slow"
steps = 3
"""


@pytest.fixture
def like(folder: Path) -> Path:
    """A method beside the fake that is like it."""
    other = folder.parent / "fake2"
    other.mkdir()
    for code in folder.glob("*.py"):
        (other / code.name).write_text(code.read_text())
    (other / "method.toml").write_text(LIKE_FAKE)
    return other / "method.toml"


def test_a_method_like_another_says_what_differs(like: Path) -> None:
    entry, base = find_method("fake2"), find_method("fake")
    assert entry.card.capabilities == base.card.capabilities and entry.card.default_preset == "quick"
    assert entry.card.name == "Fake again" and entry.card.kernels == ("tone",)
    assert entry.preset("slow") == ("slow", {"steps": 12, "noise": 0.9}, None)
    assert entry.preset("own") == ("own", {"steps": 3, "noise": 0.9}, None)
    assert entry.preset("quick") == base.preset("quick") and base.preset("slow")[1]["noise"] == 0.2
    assert entry.card.stages.keys() == base.card.stages.keys() and entry.card.stages["colours"].option == "tints"
    assert entry.card.claims is None  # what others published isn't shared
    assert entry.create({"noise": 0.9}, 7, "cpu").options["noise"] == 0.9


@pytest.mark.parametrize(
    ("new", "match"),
    [
        ('like = "nobody"', "like = 'nobody', expected another method: .*fake"),
        ('like = "fake2"', "like = 'fake2', expected another method"),
        ("like = 3", "like: Input should be a valid string"),
        ('like = "fake"\nstages = 3', "stages: Input should be a valid dictionary"),
        ('like = "fake"\npresets = 3', "presets: Input should be a valid dictionary"),
    ],
)
def test_a_wrong_like_is_one_line(like: Path, new: str, match: str) -> None:
    text = LIKE_FAKE.split("[stages.colours]")[0] if "= 3" in new else LIKE_FAKE
    like.write_text(text.replace('like = "fake"', new))
    with pytest.raises(InputError, match=match) as caught:
        find_method("fake2")
    assert "fake2/method.toml" in caught.value.subject


def test_a_method_is_like_one_with_a_whole_card(like: Path) -> None:
    third = like.parents[1] / "fake3"
    third.mkdir()
    (third / "method.toml").write_text(LIKE_FAKE.replace('like = "fake"', 'like = "fake2"'))
    with pytest.raises(InputError, match="which is itself like 'fake'"):
        find_method("fake3")


def test_unknown_method_lists_what_there_is(folder: Path) -> None:
    with pytest.raises(InputError, match="'none', expected one of .*fake"):
        find_method("none")


def test_unknown_option_lists_the_known_ones(folder: Path) -> None:
    with pytest.raises(InputError, match="option nose.*lens_per, noise"):
        find_method("fake").create({"nose": 1}, 0, "cpu")


def test_one_id_in_two_folders_is_refused(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other = write_method(tmp_path / "others")
    monkeypatch.setenv("DOFBENCH_METHODS", os.pathsep.join([str(folder.parent), str(other)]))
    with pytest.raises(InputError, match="one folder of that name"):
        method_files()


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("refocus = ", "refocuss = ", "capabilities.refocus: Field required"),
        ('class = "trainer:Fake"', 'class = "trainer"', "class"),
        ('default_preset = "quick"', 'default_preset = "fast"', "one of quick, slow"),
        ('default_preset = "quick"', 'default_preset = "quick"\nbuiltin_preset = "fast"', "one of quick, slow"),
        ("[presets.slow]", '[presets.slow]\nextends = "fast"', "presets.slow: extends = 'fast', expected one of quick"),
        ('decided_by = "points"', 'decided_by = "weather"', "stage sparse_depth: unknown decider 'weather'"),
        ('decided_by = "points"', 'decided_by = "lens"', "2 stages decided by lens"),
        ('option = "depth"\n', "", "stage sparse_depth: no option that switches it"),
        ('option = "depth"\n', 'option = "depth"\ntried_as = "x"\n', "stage sparse_depth: tried_as needs"),
        ("learns_lens = true", "learns_lens = false", "stage lens: decided by lens, of a method that learns no lens"),
        ("name =", "name", "no TOML"),
    ],
)
def test_a_wrong_method_toml_is_one_line(folder: Path, old: str, new: str, match: str) -> None:
    file = folder / "method.toml"
    file.write_text(file.read_text().replace(old, new, 1))
    with pytest.raises(InputError, match=match) as caught:
        find_method("fake")
    assert "method.toml" in caught.value.subject


def test_a_class_without_the_contract_is_refused(folder: Path) -> None:
    code = folder / "trainer.py"
    code.write_text(code.read_text().replace("def lens_estimates", "def estimates"))
    with pytest.raises(InputError, match="no lens_estimates"):
        find_method("fake").create({}, 0, "cpu")


def test_a_missing_class_is_refused(folder: Path) -> None:
    (folder / "method.toml").write_text(
        METHOD_TOML.format(name="Fake", refocus="true", learns_lens="true", needs_points="true", stages="").replace(
            "trainer:Fake", "trainer:Fakir"
        )
    )
    with pytest.raises(InputError, match="trainer:Fakir"):
        find_method("fake").create({}, 0, "cpu")
