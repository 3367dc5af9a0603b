"""Two halves of an image like the squares of a checkerboard: a fit on the first is scored on the second."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dofbench.core.similarity import centre, ssim_map, unmasked

TILES = 8  # number of tiles along the shorter side
SMALLEST = 16  # px, so that windows of SSIM fit into a tile
MARGIN = 1 / 8  # share of a tile's side: least distance of scored pixels from the other half


@dataclass(frozen=True, eq=False)
class Tiles:
    """The tiles of an image. half: (H, W), 0 or 1 by tile, starting with 0. inside: (H, W), valid pixels away from the
    tiles' borders. side: of a tile, px. mask: (H, W), True for valid pixels; None for all. both: whether both halves
    are scored, each fitted on the other, as up to `photographs-v1`."""

    half: np.ndarray
    inside: np.ndarray
    side: int
    mask: np.ndarray | None = None
    both: bool = False

    @staticmethod
    def of(height: int, width: int, mask: np.ndarray | None = None, *, both: bool = False) -> Tiles:
        """Tiles of an eighth of the shorter side, at least 16 px, cut off at the right and lower edge. Without valid
        pixels away from the tiles' borders, those at borders are scored."""
        side = max(SMALLEST, round(min(height, width) / TILES))
        margin = max(1, round(side * MARGIN))
        rows, columns = np.arange(height), np.arange(width)
        half = (rows[:, None] // side + columns[None, :] // side) % 2
        inside = _inner(rows, side, margin)[:, None] & _inner(columns, side, margin)
        if mask is not None:
            inside = inside & mask if (inside & mask).any() else mask
        return Tiles(half.astype(np.uint8), inside, side, mask, both)

    @property
    def fitted(self) -> np.ndarray:
        """(H, W) bool: the valid pixels of the first half, on which fits are made; all valid ones if it has none."""
        return self._first(self.half == 0)

    @property
    def scored(self) -> np.ndarray:
        """(H, W) bool: the pixels of the second half that are scored: those inside; without any, those at borders; all
        valid ones if it has none."""
        second = self.half == 1
        return self.inside if self.both else self._first(self.inside & second, second)

    def shrunk(self, factor: int) -> np.ndarray:
        """(H // factor, W // factor) bool: the cells of factor x factor fitted pixels; without any, those with a fitted
        pixel, or else all."""
        share = _cells(self.fitted[..., None].astype(np.float32), factor)[..., 0].mean(axis=(1, 3))
        for least in (1.0, 1e-6):
            if (share >= least).any():
                return share >= least
        return share >= 0

    def _first(self, *choices: np.ndarray) -> np.ndarray:
        """The first choice with valid pixels, or all valid pixels."""
        valid = np.ones_like(self.inside) if self.mask is None else self.mask
        return next((chosen for choice in choices if (chosen := choice & valid).any()), valid)


def shrink(image: np.ndarray, factor: int) -> np.ndarray:
    """Means over cells of factor x factor pixels, (H // factor, W // factor, 3); the rest is cut off."""
    return image if factor == 1 else _cells(image, factor).mean(axis=(1, 3))


def masked_psnr(prediction: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float:
    """PSNR over the pixels of `mask` (H, W), dB, peak 1; infinite for equal images. ValueError for an empty mask."""
    if not mask.any():
        raise ValueError("masked PSNR: expected at least one pixel, found none")
    error = float(np.mean(np.square(prediction[mask].astype(np.float64) - truth[mask])))
    return float("inf") if error == 0 else -10.0 * float(np.log10(error))


def tiled_ssim(prediction: np.ndarray, truth: np.ndarray, tiles: Tiles) -> float:
    """Mean SSIM over the windows within one scored tile, centred on a valid pixel. Images and masks as for `ssim`."""
    similarity = ssim_map(*unmasked(prediction, truth, tiles.mask))
    reach = tiles.half.shape[0] - similarity.shape[0]  # size of a window minus one pixel
    first, last = slice(None, similarity.shape[0]), slice(reach, None)
    across = slice(None, similarity.shape[1]), slice(reach, None)
    rows = np.arange(tiles.half.shape[0]) // tiles.side
    columns = np.arange(tiles.half.shape[1]) // tiles.side
    whole = (rows[first] == rows[last])[:, None] & (columns[across[0]] == columns[across[1]])
    if not tiles.both:
        whole = whole & (centre(tiles.half, similarity) == 1)
    if tiles.mask is not None and (valid := whole & centre(tiles.mask, similarity)).any():
        whole = valid
    return float(similarity[whole].mean(dtype=np.float64))


def _inner(index: np.ndarray, side: int, margin: int) -> np.ndarray:
    """Which pixels of a line are at least `margin` from the borders between tiles, the image's ends excluded."""
    place, tile = index % side, index // side
    return ((place >= margin) | (tile == 0)) & ((place < side - margin) | (tile == tile[-1]))


def _cells(image: np.ndarray, factor: int) -> np.ndarray:
    height, width = image.shape[0] // factor, image.shape[1] // factor
    return image[: height * factor, : width * factor].reshape(height, factor, width, factor, -1)
