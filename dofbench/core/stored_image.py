"""Images kept as small as they can be without losing a bit: one byte a value where they come from 8-bit files."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_LEVELS = np.arange(256, dtype=np.float32)
# What a level stands for: OpenImageIO multiplies by the reciprocal, `from_8bit` divides, and half of the levels differ
# in their last bit.
TABLES = _LEVELS * np.float32(1 / 255), _LEVELS / np.float32(255)


@dataclass(frozen=True, eq=False)
class StoredImage:
    """An image (H, W, 3). values: its 8-bit levels, with the table, (256,) float32, of what each stands for; without a
    table the image itself, such as one from a raw file, or one that was resized."""

    values: np.ndarray
    table: np.ndarray | None = None

    @staticmethod
    def of(image: np.ndarray) -> StoredImage:
        """Keep an image of floats, as levels where they give the same bits."""
        if image.dtype == np.float32 and image.size and image.min() >= 0 and image.max() <= 1:
            levels = (image * np.float32(255) + np.float32(0.5)).astype(np.uint8)
            for table in TABLES:
                if np.array_equal(_looked_up(levels, table).view(np.int32), image.view(np.int32)):
                    return StoredImage(levels, table)
        return StoredImage(image)

    def floats(self) -> np.ndarray:
        """The image that was given; a new array where it is kept as levels."""
        return self.values if self.table is None else _looked_up(self.values, self.table)

    @property
    def nbytes(self) -> int:
        """Bytes that are kept."""
        return int(self.values.nbytes)


def _looked_up(levels: np.ndarray, table: np.ndarray) -> np.ndarray:
    import cv2

    return np.asarray(cv2.LUT(levels.reshape(-1), table)).reshape(levels.shape)


class StoredField:
    """The field of a dataclass that reads as an image of floats, and keeps it as a `StoredImage`."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, owner: object, kind: type) -> np.ndarray:
        if owner is None:
            raise AttributeError(self._name)  # the field has no default
        stored: StoredImage = vars(owner)[self._name]
        return stored.floats()

    def __set__(self, owner: object, image: np.ndarray) -> None:
        vars(owner)[self._name] = StoredImage.of(image)
