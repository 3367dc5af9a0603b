"""The script that measures a GPU, on a pretended one at toy size: every part runs, is kept, and is on the page."""

from __future__ import annotations

import csv
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import small_dataset
import torch
from pretended_device import pretended
from small_dataset import write_dataset
from tolerances import FLOAT32_GRADIENT, FLOAT32_VALUE
from torch import Tensor

from benchmarks.gpu import measure
from benchmarks.gpu.tables import write_tables
from dofbench.core.cameras import Camera
from dofbench.core.files import read_json
from dofbench.runtime.ops import load


@pytest.fixture
def device(monkeypatch: pytest.MonkeyPatch) -> None:
    """What torch says of a GPU and its memory."""
    cuda = {
        "synchronize": lambda device=None: None,
        "is_available": lambda: True,
        "get_device_name": lambda device: "a pretended GPU",
        "get_device_properties": lambda device: SimpleNamespace(
            name="a pretended GPU", total_memory=8e10, multi_processor_count=132
        ),
    }
    for name, value in cuda.items():
        monkeypatch.setattr(torch.cuda, name, value)


def toy(folder: Path) -> Any:
    """A picture of a few pixels, and a dataset of which one training takes two steps; another one isn't there."""
    return measure.Settings(
        out=folder / "tables", work=folder, data=(folder / "waves", folder / "absent"), steps=(2,), preset="smoke",
        warm=1, profiled=1, repeats=1, size=toy_size(),
        counts=(4,), widths=(16,), radii=(1.0,),
    )  # fmt: skip


def toy_size() -> Any:
    return measure.Size(16, 12, 8, 2.0, nodes=4, rays=2, samples=3, planes=16)


def rows(folder: Path, table: str) -> list[dict[str, str]]:
    """The rows of a table that was written."""
    with (folder / "tables" / f"{table}.csv").open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.slow
def test_every_part_runs_and_is_kept(device: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"WIDTH": 16, "HEIGHT": 12, "FOCAL": 50.0}.items():
        monkeypatch.setattr(small_dataset, name, value)
    write_dataset(tmp_path / "waves", train=2, test=1)
    with pretended(monkeypatch):
        assert measure.main(toy(tmp_path)) == 0
        kept = (tmp_path / "gpu.json").read_bytes()
        assert measure.main(toy(tmp_path)) == 0
    assert (tmp_path / "gpu.json").read_bytes() == kept  # nothing was measured again
    found = read_json(tmp_path / "gpu.json")["parts"]
    ops = {row["op"]: row for row in rows(tmp_path, "ops")}
    trainings = {row["dataset"]: row for row in rows(tmp_path, "trainings")}
    assert list(found) == [
        "machine", "ops", "agreement", "step waves", "step absent", "training waves 2", "training absent 2", "cost",
    ]  # fmt: skip
    for op, largest in found["agreement"].items():
        if op != "seconds":
            assert largest["repeats"] == 1
            assert max(one for one, _ in largest["value_each"]) == largest["value"]
            assert largest["value"] < FLOAT32_VALUE and largest.get("gradient", 0) < FLOAT32_GRADIENT, op
            assert float(ops[op]["forward_ms"]) > 0 and float(ops[op]["forward_floor_ms"]) > 0
            assert float(ops[op]["value"]) == pytest.approx(largest["value"])
            assert ("both_ms" in found["ops"][op]) == ("gradient" in largest) == (op != "stereo")
    # A picture of three channels is read and one of them written; for the gradient as much again, and that written.
    assert found["ops"]["tone"]["forward_bytes"] == 2 * 4 * 16 * 12 * 3
    assert found["ops"]["tone"]["both_bytes"] == 5 * 4 * 16 * 12 * 3
    assert found["training waves 2"]["status"] == "ok" and found["training waves 2"]["fps_lens"] > 0
    assert trainings["waves"]["status"] == "ok" and "absent is no dataset" in trainings["absent"]["left_out"]


def test_a_part_that_fails_is_named_and_the_others_go_on(
    device: None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def fails(settings: object) -> dict[str, object]:
        raise ValueError("no such clock")

    clock = {"memory_gb": 80.0, "copy_gb_per_s": 1.0, "nvidia_smi": "nothing", "packages": {}}
    monkeypatch.setattr(measure, "agreement", fails)
    made = [("machine", lambda: clock), ("agreement", lambda: measure.agreement(None))]
    monkeypatch.setattr(measure, "parts", lambda settings: made)
    assert measure.main(toy(tmp_path)) == 1
    assert "failed: agreement: ValueError: no such clock" in capsys.readouterr().err
    (failed,) = rows(tmp_path, "failed")
    assert (failed["part"], failed["problem"]) == ("agreement", "ValueError: no such clock")
    monkeypatch.setattr(measure, "agreement", lambda settings: {})
    assert measure.main(toy(tmp_path)) == 0
    monkeypatch.setattr(measure, "code_version", lambda *given: "other code")
    monkeypatch.setattr(measure, "parts", lambda settings: iter(()))
    measure.main(toy(tmp_path))
    assert read_json(tmp_path / "gpu.json")["parts"] == {}


def test_without_a_gpu_it_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if torch.cuda.is_available():
        pytest.skip("this machine has a GPU")
    assert measure.main(toy(tmp_path)) == 2
    assert capsys.readouterr().err.startswith("no GPU that torch can use")


def test_a_peer_draws_the_same_picture_from_what_it_is_given(
    device: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """gsplat isn't installed here: the definition of this project's rasteriser, called as gsplat is, stands for it."""

    def rasterization(
        means: Tensor, quats: Tensor, scales: Tensor, opacities: Tensor, colors: Tensor, viewmats: Tensor, Ks: Tensor,
        width: int, height: int, *, near_plane: float, eps2d: float, sh_degree: int, render_mode: str,
        rasterize_mode: str,
    ) -> tuple[Tensor, Tensor, dict[str, Any]]:  # fmt: skip
        assert (render_mode, rasterize_mode) == ("RGB+ED", "antialiased")
        (fx, _, cx), (_, fy, cy), _ = Ks[0].tolist()
        camera = Camera(width, height, fx, fy, cx, cy, np.array(viewmats[0].tolist()))
        seen = load("rasterize", "reference")(
            means, scales.log(), quats, opacities.logit(), colors[:, 0].contiguous(), colors[:, 1:].contiguous(),
            camera=camera, near=near_plane, filter_2d=eps2d, sh_degree=sh_degree,
        )  # fmt: skip
        return torch.cat([seen.color, seen.depth[..., None]], 2)[None], seen.alpha[None, ..., None], {}

    monkeypatch.setitem(sys.modules, "gsplat", SimpleNamespace(rasterization=rasterization))
    monkeypatch.setattr(measure, "CALLS", {})
    settings = toy(tmp_path)
    with pretended(monkeypatch):
        apart, took = measure.agreement(settings)["gsplat"], measure.ops(settings)["gsplat"]
    assert apart["repeats"] == 1
    assert apart["value"] < FLOAT32_VALUE and apart["gradient"] < FLOAT32_GRADIENT
    assert min(took[name] for name in ("forward_ms", "forward_bytes", "both_ms", "both_bytes")) > 0


def test_rows_of_another_gpu_stay(tmp_path: Path) -> None:
    def found(gpu: str, ms: float) -> dict[str, Any]:
        return {"gpu": gpu, "parts": {"ops": {"tone": {"forward_ms": ms}, "seconds": 1.0}}}

    for gpu, ms in (("A", 1.0), ("B", 2.0), ("A", 3.0)):
        write_tables(tmp_path / "tables", found(gpu, ms))
    assert [(row["gpu"], row["op"], row["forward_ms"]) for row in rows(tmp_path, "ops")] == [
        ("B", "tone", "2"), ("A", "tone", "3"),
    ]  # fmt: skip
