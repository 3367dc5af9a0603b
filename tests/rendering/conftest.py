"""Scenes are rendered with tiny images: the vectorised variant where it runs, else the scalar one."""

from __future__ import annotations

import pytest


@pytest.fixture(scope="session")
def variant():
    """The variant chosen for this session; skips without mitsuba."""
    pytest.importorskip("mitsuba", reason="mitsuba is not installed (extra: render)")
    from dofbench.scenes.procedural.variant import choose_variant

    return choose_variant()[0]
