"""A training that was cut off goes on in a new object, from what was pickled, and ends with the same bits."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest
from made_up import Recorder
from small_scene import training_set

from dofbench.core.budget import Budget
from dofbench.core.content import content_folder
from dofbench.core.contracts import Method, Resumes
from dofbench.methods.cards import find_method

METHODS = sorted(file.parent.name for file in content_folder("methods").glob("*/method.toml"))
STEPS = 40


class Keeping(Recorder):
    """Pickles the training after a step, as when the process is about to die."""

    def __init__(self, method: Method, at: int):
        super().__init__()
        self._method, self._at, self.kept = method, at, b""

    def after_step(self, step: int, loss: float) -> bool:
        if step == self._at and isinstance(self._method, Resumes):
            self.kept = pickle.dumps((self._method.training_state(), self._method.constant_state()))
        return super().after_step(step, loss)


def files(method: Method, folder: Path) -> dict[str, bytes]:
    folder.mkdir()
    method.save(folder)
    return {file.name: file.read_bytes() for file in folder.iterdir()}


# Density control, the lens' trials and blur that begins later lie before step 33, most of them after step 9. The fast
# suite has one of each family: Gaussians, with a learned blur, with a lens and its trials, and fields.
FAST = {("3dgs", 9), ("bags", 33), ("lensselect", 33), ("dofnerf", 33)}
CASES = [("3dgs", 9), ("lensselect", 9), *((name, 33) for name in METHODS)]


@pytest.mark.parametrize(
    ("name", "at"), [case if case in FAST else pytest.param(*case, marks=pytest.mark.slow) for case in CASES]
)
def test_the_rest_is_the_same(name: str, at: int, tmp_path: Path) -> None:
    entry = find_method(name)
    _, options, _ = entry.preset("smoke")
    whole, cut = (entry.create({**options, "steps": STEPS}, 3, "cpu") for _ in range(2))
    seen, rest = Keeping(whole, at), Recorder()
    whole.fit(training_set(), Budget(steps=STEPS), seen)
    assert isinstance(cut, Resumes)
    cut.resume_from(*pickle.loads(seen.kept))
    outcome = cut.fit(training_set(), Budget(steps=STEPS), rest)
    assert outcome.steps == STEPS and rest.losses == seen.losses[at:]
    assert files(cut, tmp_path / "cut") == files(whole, tmp_path / "whole")
    assert cut.describe() == whole.describe() and cut.lens_estimates() == whole.lens_estimates()
    pixels = training_set().views[1].image[..., 0] >= 0
    name = training_set().views[1].name
    assert (cut.predict_photograph(name, pixels) == whole.predict_photograph(name, pixels)).all()
