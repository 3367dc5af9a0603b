"""How many pictures a second the viewer makes while the camera moves.

python -m benchmarks.speed.viewer RESULT [WIDTH HEIGHT SECONDS]
"""

from __future__ import annotations

import io
import statistics
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from dofbench.viewing.camera_paths import alike, spiral
from dofbench.viewing.picture import Look, picture
from dofbench.viewing.subject import open_subject
from dofbench.viewing.viewer import next_width


def main(result: Path, width: int = 504, height: int = 378, seconds: float = 10.0) -> None:
    """Print pictures a second, JPEG coding included, and their median width, after a second to settle."""
    from PIL import Image

    subject = open_subject(result)
    cameras = [photograph.camera for photograph in subject.photographs]
    path = spiral(alike(cameras, cameras[0]), 1 / (subject.bounds.q_min + 0.5 * subject.bounds.extent))
    look = Look(half_opening=subject.opening, focus_disparity=subject.bounds.q_min + 0.5 * subject.bounds.extent)
    picture([subject], path(0.0).resized(64, 48), look, draft=True)  # JIT compilation
    wide, begun, times, widths = width // 2, time.perf_counter(), [], []
    while (now := time.perf_counter() - begun) < seconds + 1:
        camera = path(now / (seconds + 1))
        camera = replace(camera, fy=camera.fx, cy=camera.cx * height / width)
        start = time.perf_counter()
        shown = picture([subject], camera.resized(wide, round(wide * height / width)), look, draft=True)
        Image.fromarray(shown.pixels).save(io.BytesIO(), format="JPEG", quality=70)
        taken = time.perf_counter() - start
        if now > 1:
            times.append(taken)
            widths.append(wide)
        wide = next_width(wide, taken, width)
    rate, slow = len(times) / sum(times), float(np.quantile(times, 0.95))
    print(
        f"{rate:.1f} pictures a second, 95 % within {1000 * slow:.0f} ms, median width {statistics.median(widths):.0f}"
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]), *map(int, sys.argv[2:]))
