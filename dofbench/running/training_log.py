"""Learning curves for TensorBoard (`dofbench run --log tensorboard`)."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.images import to_8bit
from dofbench.evaluation.results.result import CurvePoint

LOG_FOLDER = "tensorboard"  # in the run's folder


def check_logger(logger: str | None) -> None:
    """Raise InputError where the package that writes the log is missing (extra `tensorboard`)."""
    if logger is not None and importlib.util.find_spec("tensorboard") is None:
        raise InputError(f"--log {logger}", "no package tensorboard", 'pip install "dofbench[tensorboard]"')


class TensorBoardLog:
    """Writes points of a learning curve to a folder, with the views rendered for them; use it in a `with` block.

    Scalars are the numbers of result.json, rounded to single precision: TensorBoard's data server drops doubles.
    Nothing is rendered for the log, since a rendering could draw random numbers and so change the training.
    """

    def __init__(self, folder: Path):
        from torch.utils.tensorboard import SummaryWriter

        self._writer = SummaryWriter(str(folder))
        self._images: dict[str, np.ndarray] = {}

    def __enter__(self) -> TensorBoardLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._writer.close()

    def show(self, kind: str, view: str, image: np.ndarray) -> None:
        """Keep an image for the next point. image: (H, W, 3), encoded, 0 to 1; non-finite values are shown black."""
        self._images[f"{kind}/{view}"] = image

    def add(self, point: CurvePoint) -> None:
        """Write a point and its images.

        The file is flushed, so that it can be watched, and so that the writer's thread is idle when training resumes.
        """
        scalars = {"loss": point.loss, "time/train_s": point.train_s, "time/train_cpu_s": point.train_cpu_s}
        scalars |= {f"scores/{column}": value for column, value in point.scores.items()}
        for tag, value in scalars.items():
            if value is not None:
                self._writer.add_scalar(tag, value, point.steps)
        for tag, image in self._images.items():
            shown = to_8bit(np.nan_to_num(image, nan=0.0, posinf=0.0, neginf=0.0))
            self._writer.add_image(tag, shown, point.steps, dataformats="HWC")
        self._images.clear()
        self._writer.flush()


def write_log(folder: Path, curve: Iterable[CurvePoint]) -> None:
    """Write a finished curve, without images."""
    with TensorBoardLog(folder) as log:
        for point in curve:
            log.add(point)
