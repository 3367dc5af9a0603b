"""A scene by make-scene, and its photograph once more by the renderer "thinlens"."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("mitsuba", reason="needs mitsuba, the extra [render]")


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    from dofbench.scenes.procedural import make_scene
    from dofbench.scenes.procedural.scene_options import MakeScene

    out = tmp_path_factory.mktemp("scene") / "tiles"
    make_scene(
        MakeScene(
            "tiles",
            out,
            views=2,
            width=64,
            height=48,
            samples=64,
            lens_views=1,
            lens_samples=512,
            focus=(0.2,),
            aperture=(3.0,),
        )
    )
    return out


@pytest.mark.slow
def test_more_rays_come_closer_to_the_scenes_own_photograph(scene):
    from dofbench.evaluation.renderer.validate import cases_in

    (case,) = cases_in(scene)
    assert case.geometry
    truth = case.make()
    few, many = (
        -10 * math.log10(np.mean((np.clip(truth.thin_lens(rays), 0, 1) - truth.photograph) ** 2)) for rays in (8, 128)
    )
    # With another lens or view, the PSNR would stay far below.
    assert many > few + 6 and many > 30
    assert truth.own_error_db > many
