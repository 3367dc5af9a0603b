"""Divides a photograph into two halves like the squares of a checkerboard: a fit on one half is scored on the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dofbench.metrics.ssim import ssim_map

TILES = 8  # number of tiles along the shorter side
SMALLEST = 16  # px, so that windows of SSIM fit into a tile
# Share of a tile's side: scored pixels lie at least this far from the other half, whose light is blurred into their
# surroundings
MARGIN = 1 / 8


@dataclass(frozen=True, eq=False)
class Tiles:
    """The tiles of an image. half: (H, W), 0 or 1 by tile, like the squares of a chessboard, beginning with 0. inside:
    (H, W), the pixels that are scored. side: of a tile, px."""

    half: np.ndarray
    inside: np.ndarray
    side: int

    @staticmethod
    def of(height: int, width: int) -> Tiles:
        """Tiles with an eighth of the shorter side, at least 16 px; tiles at the right and lower edge may be cut
        off."""
        side = max(SMALLEST, round(min(height, width) / TILES))
        margin = max(1, round(side * MARGIN))
        rows, columns = np.arange(height), np.arange(width)
        half = (rows[:, None] // side + columns[None, :] // side) % 2
        return Tiles(half.astype(np.uint8), _inner(rows, side, margin)[:, None] & _inner(columns, side, margin), side)

    def fitted(self, half: int) -> np.ndarray:
        """(H, W) bool: the pixels that a fit on that half uses, which are all pixels of the half."""
        return self.half == half

    def scored(self, half: int) -> np.ndarray:
        """(H, W) bool: the pixels of that half that are scored."""
        return self.inside & (self.half == half)

    def shrunk(self, factor: int, half: int) -> np.ndarray:
        """(H // factor, W // factor) bool: the cells of factor x factor pixels that lie completely in that half."""
        cells = _cells((self.half == half)[..., None].astype(np.float32), factor)[..., 0]
        return cells.mean(axis=(1, 3)) == 1


def shrink(image: np.ndarray, factor: int) -> np.ndarray:
    """(H // factor, W // factor, 3): means over cells of factor x factor pixels; remaining rows and columns are cut
    off."""
    return image if factor == 1 else _cells(image, factor).mean(axis=(1, 3))


def masked_psnr(prediction: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float:
    """PSNR over the pixels of `mask` (H, W) and all channels, dB, peak 1; infinite for equal images.

    Raises ValueError for an empty mask.
    """
    if not mask.any():
        raise ValueError("masked PSNR: expected at least one pixel, found none")
    error = float(np.mean(np.square(prediction[mask].astype(np.float64) - truth[mask])))
    return float("inf") if error == 0 else -10.0 * float(np.log10(error))


def tiled_ssim(prediction: np.ndarray, truth: np.ndarray, tiles: Tiles) -> float:
    """Mean SSIM over the windows that lie within one tile, so that no window covers both halves. Images as for
    `metrics.ssim`."""
    similarity = ssim_map(prediction, truth)
    reach = tiles.half.shape[0] - similarity.shape[0]  # size of a window minus one pixel
    first, last = slice(None, similarity.shape[0]), slice(reach, None)
    across = slice(None, similarity.shape[1]), slice(reach, None)
    rows = np.arange(tiles.half.shape[0]) // tiles.side
    columns = np.arange(tiles.half.shape[1]) // tiles.side
    whole = (rows[first] == rows[last])[:, None] & (columns[across[0]] == columns[across[1]])
    return float(similarity[whole].mean(dtype=np.float64))


def _inner(index: np.ndarray, side: int, margin: int) -> np.ndarray:
    """Which pixels of a line lie at least `margin` from the borders between tiles; the ends of the image aren't
    borders."""
    place, tile = index % side, index // side
    return ((place >= margin) | (tile == 0)) & ((place < side - margin) | (tile == tile[-1]))


def _cells(image: np.ndarray, factor: int) -> np.ndarray:
    height, width = image.shape[0] // factor, image.shape[1] // factor
    return image[: height * factor, : width * factor].reshape(height, factor, width, factor, -1)
