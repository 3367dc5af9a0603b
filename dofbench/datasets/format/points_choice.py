"""How a dataset gets the points that a method starts from."""

from __future__ import annotations

from typing import Literal

# scene: those of the scene that the dataset is made from. sharp, shallow: triangulated anew, by the given poses,
# between the sharp or the shallow photographs of the training views alone.
Points = Literal["scene", "sharp", "shallow"]
