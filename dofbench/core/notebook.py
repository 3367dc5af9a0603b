"""Small pictures in HTML, for the `_repr_html_` of what notebooks show."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Mapping

import numpy as np

from dofbench.core.images import resize, to_8bit
from dofbench.core.lens import DisparityRange

_SIDE, _QUALITY = 220, 85  # pixels of the longer side of a picture; of its WebP


def as_html(
    title: str, pictures: Iterable[tuple[str, np.ndarray]] = (), scores: Mapping[str, str] | None = None
) -> str:
    """A line of text, the pictures side by side above their captions, and scores by label.

    pictures: (caption, image); image (H, W, 3) floats, encoded, values outside [0, 1] saturate.
    """
    parts, shown = [f"<p><code>{html.escape(title)}</code></p>"], ""
    for caption, image in pictures:
        text = html.escape(caption)
        picture = f'<img src="{_uri(image)}" alt="{text}"><figcaption>{text}</figcaption>'
        shown += f'<figure style="display:inline-block;margin:0 8px 8px 0">{picture}</figure>'
    parts += [f"<div>{shown}</div>"] if shown else []
    if scores:
        rows = "".join(
            f"<tr><td>{html.escape(label)}</td><td>{html.escape(text)}</td></tr>" for label, text in scores.items()
        )
        parts.append(f"<table>{rows}</table>")
    return "".join(parts)


def disparity_picture(depth: np.ndarray) -> np.ndarray:
    """Depth (H, W), scene units, as grey disparity (H, W, 3), white near; black where unknown or where nothing is."""
    known = np.isfinite(depth) & (depth > 0)
    if not known.any():
        return np.zeros((*depth.shape, 3), np.float32)
    disparity = np.where(known, 1.0 / np.where(known, depth, 1.0), 0.0)
    grey = np.where(known, np.clip(DisparityRange.of(depth).normalise(disparity), 0.0, 1.0), 0.0)
    return np.repeat(grey[..., None], 3, axis=2).astype(np.float32)


def _uri(image: np.ndarray) -> str:
    import cv2

    height, width = image.shape[:2]
    factor = min(1.0, _SIDE / max(height, width))
    image = np.clip(np.nan_to_num(np.asarray(image, np.float32)), 0.0, 1.0)
    small = resize(image, max(1, round(width * factor)), max(1, round(height * factor)))
    done, coded = cv2.imencode(".webp", to_8bit(small)[..., ::-1], [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])
    if not done:
        raise RuntimeError("the picture can't be encoded as WebP")
    return "data:image/webp;base64," + base64.b64encode(coded.tobytes()).decode()
