"""Held-back tiles: colour losses don't use them, and scores use nothing else."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from made_up import Recorder
from small_scene import options as _options
from small_scene import training_set as _training_set
from tolerances import FLOAT32_SCALAR, PSNR_OF_FLOAT32

from dofbench.core.budget import Budget
from dofbench.core.contracts import TrainingSet
from dofbench.core.errors import InputError
from dofbench.core.held_out import TILE, held_out_tiles, tile_scores
from dofbench.core.images import resize
from dofbench.core.masks import touched
from dofbench.core.similarity import psnr, ssim
from dofbench.training.common import losses
from dofbench.training.common.held_out import held_out_mask, held_out_scores
from dofbench.training.gaussians.trainer import Trainer


@given(st.integers(17, 120), st.integers(17, 120), st.floats(0.01, 0.9), st.integers(0, 5), st.integers(0, 5))
def test_whole_tiles_are_drawn_for_every_view_by_itself(height, width, share, seed, view):
    mask = held_out_tiles(height, width, share, seed, view)
    tiles = mask[::TILE, ::TILE]
    assert mask.shape == (height, width)
    assert np.array_equal(np.kron(tiles, np.ones((TILE, TILE)))[:height, :width], mask)
    assert 1 <= tiles.sum() < tiles.size and abs(tiles.sum() - share * tiles.size) <= 1
    assert np.array_equal(mask, held_out_tiles(height, width, share, seed, view))


def test_views_and_seeds_differ():
    first = held_out_tiles(200, 300, 0.2, 0, 0)
    assert not np.array_equal(first, held_out_tiles(200, 300, 0.2, 0, 1))
    assert not np.array_equal(first, held_out_tiles(200, 300, 0.2, 1, 0))


@pytest.mark.parametrize(("width", "height"), [(50, 35), (33, 23), (100, 70), (99, 50)])
def test_a_shrunk_pixel_is_held_back_as_soon_as_one_of_its_own_is(width, height):
    mask = held_out_tiles(70, 100, 0.3, 0, 0)
    changed = resize(mask.astype(np.float32), width, height) > 1e-6
    found = touched(mask, width, height)
    assert not (changed & ~found).any()
    assert (found & ~changed).mean() < 0.02  # no more than rounding


def test_no_gradient_reaches_a_held_back_pixel():
    random = torch.Generator().manual_seed(0)
    target = torch.rand(48, 64, 3, generator=random)
    prediction = torch.rand(48, 64, 3, generator=random).requires_grad_()
    mask = torch.from_numpy(held_out_mask(48, 64, (48, 64), 0.3, 0, 0))
    loss = losses.reconstruction(losses.without_held_out(prediction, target, mask), target, 0.4, None)
    loss.backward()
    assert not prediction.grad[mask].any()
    assert (prediction.grad[~mask] != 0).all()


@pytest.mark.parametrize("coarse", [0.0, 0.5])
def test_what_lies_in_held_back_tiles_doesn_t_change_the_training(coarse):
    """Bit for bit with L1 alone; SSIM's windows reach into held-back tiles, where the photograph replaces the
    prediction."""
    options = _options(steps=12, held_back=0.3, ssim_weight=0.0, coarse_until=coarse)
    trained = []
    for level in (None, 0.9):
        views = []
        for number, view in enumerate(_training_set().views):
            image = view.image.copy()
            if level is not None:
                image[held_out_tiles(*image.shape[:2], 0.3, 0, number)] = level
            views.append(replace(view, image=image))
        trainer = Trainer(TrainingSet(tuple(views), _training_set().points), options, 0)
        trainer.fit(Budget(), Recorder())
        trained.append(trainer)
    for name, value in trained[0].gaussians.parameters.items():
        assert torch.equal(value, trained[1].gaussians.parameters[name]), name
    assert trained[0].lens_estimates() == trained[1].lens_estimates()
    assert trained[0].held_out_scores().psnr != trained[1].held_out_scores().psnr


def test_scores_are_those_of_the_pixels_held_back():
    random = np.random.default_rng(0)
    truth = random.uniform(size=(64, 96, 3)).astype(np.float32)
    prediction = np.clip(truth + random.normal(0, 0.05, truth.shape), 0, 1).astype(np.float32)
    mask = np.zeros((64, 96), dtype=bool)
    mask[16:48, 32:80] = True
    found = tile_scores(prediction, truth, mask)
    cut = np.s_[16:48, 32:80]
    assert found == pytest.approx(
        (psnr(prediction[cut], truth[cut]), ssim(prediction[cut], truth[cut])), rel=FLOAT32_SCALAR
    )
    prediction[~mask] = 0
    assert tile_scores(prediction, truth, mask) == pytest.approx(found, rel=FLOAT32_SCALAR)


def test_views_count_alike_and_light_above_white_is_white():
    photographs = {"a": np.full((40, 40, 3), 0.5, np.float32), "b": np.ones((40, 40, 3), np.float32)}
    renderings = [np.full((40, 40, 3), 0.6, np.float32), np.full((40, 40, 3), 1.7, np.float32)]
    scores = held_out_scores(photographs.items(), renderings.__getitem__, 0.3, 0)
    assert scores.views["a"][0] == pytest.approx(20.0, abs=PSNR_OF_FLOAT32)
    assert scores.views["b"][0] == pytest.approx(20 * np.log10(2550), abs=PSNR_OF_FLOAT32)
    assert scores.psnr == pytest.approx((20 + 20 * np.log10(2550)) / 2, abs=PSNR_OF_FLOAT32)
    of_each = [ssim for _, ssim in scores.views.values()]
    assert np.isfinite(of_each).all() and scores.ssim == pytest.approx(sum(of_each) / 2, abs=FLOAT32_SCALAR)


def test_held_back_pixels_of_a_training_are_scored_worse_than_the_rest():
    trainer = Trainer(_training_set(), _options(held_back=0.3), 0)
    trainer.fit(Budget(), Recorder())
    scores = trainer.held_out_scores()
    assert list(scores.views) == ["v0", "v1", "v2"]
    seen = [
        tile_scores(
            np.clip(trainer.render_view(number), 0, 1),
            view.image,
            ~held_out_tiles(*view.image.shape[:2], 0.3, 0, number),
        )[0]
        for number, view in enumerate(_training_set().views)
    ]
    assert scores.psnr < np.mean(seen)


def test_nothing_held_back_is_no_score():
    with pytest.raises(ValueError, match="share above 0"):
        Trainer(_training_set(), _options(), 0).held_out_scores()
    assert held_out_mask(40, 40, (40, 40), 0.0, 0, 0) is None
    with pytest.raises(InputError, match="held_back"):
        _options(held_back=1.0)
