"""Images kept as 8-bit levels read as the very floats that were given; others are kept as they are."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up import frontal

from dofbench.core.contracts import TrainingView
from dofbench.core.images import from_8bit, read_image, write_png
from dofbench.core.masks import PackedMask
from dofbench.core.stored_image import TABLES, StoredImage


def levels(seed: int = 0, height: int = 5, width: int = 7) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3)).astype(np.uint8)


def same_bits(one: np.ndarray, other: np.ndarray) -> bool:
    return one.dtype == other.dtype and one.tobytes() == other.tobytes()


@pytest.mark.parametrize("table", TABLES)
def test_every_level_by_either_rule_takes_a_byte_and_comes_back_to_the_bit(table: np.ndarray) -> None:
    image = table[np.arange(256 * 3).reshape(16, 16, 3) % 256]
    kept = StoredImage.of(image)
    assert kept.nbytes == image.size and same_bits(kept.floats(), image)


def test_a_file_is_kept_as_its_levels(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", levels())
    image = read_image(tmp_path / "a.png")
    kept = StoredImage.of(image)
    assert (kept.values == levels()).all() and same_bits(kept.floats(), image)


@given(st.integers(0, 99), st.sampled_from(["ulp", "nan", "below", "above", "minus zero", "double", "mixed"]))
def test_what_levels_cannot_give_is_kept_as_it_is(seed: int, kind: str) -> None:
    image = from_8bit(levels(seed))
    image[1, 2, 0] = {
        "ulp": np.nextafter(TABLES[0][77], np.float32(1)) if TABLES[0][77] >= TABLES[1][77] else TABLES[0][77] / 3,
        "nan": np.nan,
        "below": -0.1,
        "above": 1.1,
        "minus zero": -0.0,
    }.get(kind, image[1, 2, 0])
    if kind == "double":
        image = image.astype(np.float64)
    if kind == "mixed":
        image[0], image[1] = TABLES[0][3], TABLES[1][3]
        assert TABLES[0][3] != TABLES[1][3]
    kept = StoredImage.of(image)
    assert kept.table is None and kept.floats() is image


def test_a_training_view_reads_as_floats_and_keeps_levels() -> None:
    image, mask = from_8bit(levels()), np.ones((5, 7), bool)
    mask[1:3, 2] = False
    view = TrainingView("v", frontal(7, 5, 9.0), image)
    masked = replace(view, mask=mask)
    for one in (view, pickle.loads(pickle.dumps(view)), copy.deepcopy(view), replace(view, name="w")):
        assert same_bits(one.image, image) and one.stored.nbytes == image.size
    assert masked.stored.nbytes == image.size and same_bits(masked.image[mask], image[mask])
    darker = replace(view, image=image * np.float32(0.3))
    assert same_bits(darker.image, image * np.float32(0.3))
    with pytest.raises(TypeError):
        TrainingView("v", frontal(7, 5, 9.0))  # type: ignore[call-arg]


@given(st.integers(1, 20), st.integers(1, 20), st.integers(0, 99))
def test_a_packed_mask_takes_a_bit_a_pixel(height: int, width: int, seed: int) -> None:
    mask = np.random.default_rng(seed).random((height, width)) < 0.5
    packed = PackedMask.of(mask)
    assert (packed.bools() == mask).all() and packed.bools().dtype == bool
    assert packed.bits.nbytes == -(-mask.size // 8)
