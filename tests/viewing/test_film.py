"""Films: each frame is rendered once, a film goes on where it stopped, and a video shows its frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from known_scene import CAMERA, Known
from tolerances import LEVEL_8BIT

from dofbench.core.errors import InputError
from dofbench.core.images import read_image, write_png
from dofbench.viewing.camera_paths import dolly, resized_to
from dofbench.viewing.film import Frame, frames_of, render_frames, write_animation, write_video
from dofbench.viewing.lens_track import LensTrack, Track

TRACK = LensTrack(Track.even([7.0 / 90]), Track.even([0.2, 0.8]))


def film(count: int = 5) -> list[Frame]:
    return frames_of(dolly(resized_to(CAMERA, 64), 0.1), TRACK, count)


def test_a_focus_pull_is_rendered_frame_by_frame(tmp_path: Path) -> None:
    frames = film()
    assert [frame.lens.focus_disparity for frame in frames] == pytest.approx([0.2, 0.29375, 0.5, 0.70625, 0.8])
    files = render_frames(Known().render, frames, tmp_path)
    for frame, file in zip(frames, files, strict=True):
        expected = Known().render(frame.camera, frame.lens).image
        assert np.abs(read_image(file) - expected).max() <= 0.51 * LEVEL_8BIT  # half a level, and float32
    assert frames_of(dolly(CAMERA, 0.1), None, 1)[0].lens is None


def test_a_film_goes_on_where_it_stopped(tmp_path: Path) -> None:
    class Stops(Known):
        def render(self, camera, lens):
            if len(self.rendered) == 2:
                raise KeyboardInterrupt
            return super().render(camera, lens)

    with pytest.raises(KeyboardInterrupt):
        render_frames(Stops().render, film(), tmp_path)
    kept = {file: file.read_bytes() for file in (tmp_path / "frames").iterdir()}
    assert sorted(file.name for file in kept) == ["0001.png", "0002.png"]
    second = Known()
    files = render_frames(second.render, film(), tmp_path)
    assert len(second.rendered) == 3 and all(file.read_bytes() == data for file, data in kept.items())
    other = render_frames(Known().render, film(), tmp_path / "again")
    assert [one.read_bytes() for one in files] == [one.read_bytes() for one in other], "the same frames"


def test_frames_of_another_film_or_model_are_not_mixed(tmp_path: Path) -> None:
    render_frames(Known().render, film(), tmp_path, model="one")
    for frames, model in ((film(6), "one"), (film(), "two")):
        with pytest.raises(InputError, match="frames of another film"):
            render_frames(Known().render, frames, tmp_path, model=model)


def test_a_video_shows_its_frames(tmp_path: Path) -> None:
    av = pytest.importorskip("av", reason="no package av: pip install dofbench[film]")
    files = render_frames(Known().render, film(), tmp_path)
    write_video(files, tmp_path / "film.mp4", fps=12, quality=1)
    with av.open(str(tmp_path / "film.mp4")) as container:
        stream = container.streams.video[0]
        assert float(stream.average_rate) == 12 and stream.codec_context.name == "h264"
        shown = [frame.to_ndarray(format="rgb24") / 255 for frame in container.decode(stream)]
    assert len(shown) == 5
    for image, file in zip(shown, files, strict=True):
        # Colours have half the resolution in the video, so brightness is compared: five levels in the mean.
        assert np.abs((image - read_image(file)).mean(axis=2)).mean() < 5 / 255
    assert not list(tmp_path.glob(".*")), "no part is left"


def test_an_animation_shows_its_frames(tmp_path: Path) -> None:
    from PIL import Image

    files = render_frames(Known().render, film(), tmp_path)
    write_animation(files, tmp_path / "film.webp", fps=20, quality=95)
    with Image.open(tmp_path / "film.webp") as animation:
        animation.load()
        assert animation.n_frames == 5 and animation.info["duration"] == 50
        for index, file in enumerate(files):
            animation.seek(index)
            shown = np.asarray(animation.convert("RGB")) / 255
            # Lossy, and with colours at half the resolution: five levels in the mean.
            assert np.abs((shown - read_image(file)).mean(axis=2)).mean() < 5 / 255


def test_frames_that_make_no_video_are_named(tmp_path: Path) -> None:
    pytest.importorskip("av", reason="no package av: pip install dofbench[film]")
    for name, shape in (("a", (6, 8, 3)), ("b", (8, 8, 3)), ("c", (7, 8, 3))):
        write_png(tmp_path / f"{name}.png", np.zeros(shape))
    with pytest.raises(InputError, match="8 x 8 pixels, expected 8 x 6"):
        write_video([tmp_path / "a.png", tmp_path / "b.png"], tmp_path / "film.mp4")
    with pytest.raises(InputError, match="even numbers"):
        write_video([tmp_path / "c.png"], tmp_path / "film.mp4")
    assert not (tmp_path / "film.mp4").exists()
