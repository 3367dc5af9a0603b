"""Training of radiance fields on a device: the CPU's losses, and how often the host waits for the device."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from made_up import Recorder
from pretended_device import pretended
from tiny_scene import TINY_FIELD, tiny_scene
from tolerances import FLOAT32_VALUE
from waits_of_steps import Steps

from dofbench.core.budget import Budget
from dofbench.core.contracts import FitOutcome
from dofbench.core.errors import Status
from dofbench.methods.deblurnerf.method import DeblurNeRF
from dofbench.methods.dofnerf.method import DoFNeRF
from dofbench.methods.dpnerf.method import DPNeRF
from dofbench.methods.lensnerf.method import LensNeRF
from dofbench.methods.pdrf.method import PDRF
from dofbench.training.fields.field_method import FieldMethod
from dofbench.training.fields.field_trainer import FieldTrainer

STEPS = 4  # within them the grid grows, cells are looked at and the grid's roughness counts
BAD = 1  # the view with a NaN in its photograph

# How many samples rays have in occupied cells decides how much there is to compute: asked once a rendering.
SAMPLES = "_local_scalar_dense in gpu.py field_samples"


def trainer_on(
    device: str, kind: type[FieldMethod] = FieldMethod, bad_view: int | None = None, **overrides: object
) -> FieldTrainer:
    method, scene = kind({**TINY_FIELD, **overrides}, 0, device), tiny_scene(bad_view)
    model = method.model(scene, torch.Generator().manual_seed(0))
    return FieldTrainer(scene, method._options, model, 0, device)


def trained(trainer: FieldTrainer, waits: list[str]) -> Steps:
    observer = Steps(lambda: trainer.loss, waits)
    assert trainer.fit(Budget(steps=STEPS), observer).status is Status.OK
    return observer


@pytest.mark.parametrize(
    ("kind", "overrides", "renderings"),
    [
        (FieldMethod, {"colour_per_view": "affine"}, 1),
        (LensNeRF, {"lens_points": 2, "lens_activation": "ends", "lens_update": "dense"}, 1),
        (DoFNeRF, {"patch_side": 4, "patch_from": 0.0, "colour_per_view": "gain"}, 1),
        (DeblurNeRF, {}, 1),
        (DPNeRF, {"proposal_samples": 3}, 1),
        (PDRF, {"kernel_points": 3}, 2),
    ],
)
def test_a_training_on_a_device_has_the_losses_of_one_on_the_cpu(
    kind: type[FieldMethod], overrides: dict[str, object], renderings: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = trained(trainer_on("cpu", kind, **overrides), [])
    with pretended(monkeypatch) as waits:
        found = trained(trainer_on("cuda", kind, **overrides), waits)
    np.testing.assert_allclose(found.own, expected.own, rtol=FLOAT32_VALUE)
    # The first step also has what comes before it, and the first look.
    assert found.waits[1:] == [{SAMPLES: renderings}] * (STEPS - 1)
    assert len(set(found.losses)) == 1 and found.losses[0] == found.own[0]


class Spoiling(Recorder):
    """Does something after the second step."""

    def __init__(self, spoil: Callable[[], object]) -> None:
        super().__init__()
        self._spoil = spoil

    def after_step(self, step: int, loss: float) -> bool:
        if step == 2:
            self._spoil()
        return super().after_step(step, loss)


def spoiled(device: str, what: str) -> tuple[FieldTrainer, FitOutcome]:
    """A training in which a NaN turns up after the second step."""
    if what == "lens":
        trainer = trainer_on(device, LensNeRF, lens_points=2)
        return trainer, trainer.fit(Budget(steps=STEPS), Spoiling(lambda: trainer._model.lenses.spoil(np.nan)))
    trainer = trainer_on(device)

    @torch.no_grad()
    def spoil() -> None:
        trainer.scene.field.parameters[what].view(-1)[11].fill_(np.nan)

    return trainer, trainer.fit(Budget(steps=STEPS), Spoiling(spoil))


@pytest.mark.parametrize("what", ["basis", "lens"])
def test_a_value_that_is_not_finite_changes_nothing_and_is_told_with_its_step(
    what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, expected = spoiled("cpu", what)
    with pretended(monkeypatch):
        trainer, found = spoiled("cuda", what)
    assert expected.status is found.status is Status.DIVERGED and expected.steps == 3
    events = [(event.step, event.view, event.stage) for event in (expected.nonfinite[0], found.nonfinite[0])]
    assert events[0] == events[1] and events[0][0] == 3
    assert left(trainer) == pytest.approx(left(before), abs=FLOAT32_VALUE, nan_ok=True)


def test_a_bad_pixel_ends_training_before_its_first_step(monkeypatch: pytest.MonkeyPatch) -> None:
    with pretended(monkeypatch):
        trainer = trainer_on("cuda", bad_view=BAD)
        begun = left(trainer)
        found = trainer.fit(Budget(steps=STEPS), Recorder())
        assert np.array_equal(left(trainer), begun)
    assert found.status is Status.DIVERGED and found.steps == 1
    assert [(event.step, event.view, event.stage) for event in found.nonfinite] == [(1, f"v{BAD}", "photograph")]


def left(trainer: FieldTrainer) -> np.ndarray:
    """All numbers of the field."""
    field = trainer.scene.field
    return np.concatenate([one.numpy(force=True).reshape(-1) for one in field.parameters.values()])
