"""dofbench: datasets with a known lens, and a benchmark of depth-of-field-aware view synthesis.

`__all__` lists the public names, which other programs and `examples/` may use. A name is loaded when it is first used,
so `import dofbench` is fast. Modules may change without an entry in CHANGELOG.md; these names don't.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dofbench.core.blur import Blur as Blur
    from dofbench.core.budget import Budget as Budget
    from dofbench.core.cameras import Camera as Camera
    from dofbench.core.contracts import FitOutcome as FitOutcome
    from dofbench.core.contracts import Method as Method
    from dofbench.core.contracts import Observer as Observer
    from dofbench.core.contracts import PointCloud as PointCloud
    from dofbench.core.contracts import Rendering as Rendering
    from dofbench.core.contracts import TrainingSet as TrainingSet
    from dofbench.core.contracts import TrainingView as TrainingView
    from dofbench.core.errors import InputError as InputError
    from dofbench.core.errors import Status as Status
    from dofbench.core.images import read_image as read_image
    from dofbench.core.images import write_png as write_png
    from dofbench.core.lens import ApertureShape as ApertureShape
    from dofbench.core.lens import DisparityRange as DisparityRange
    from dofbench.core.lens import Lens as Lens
    from dofbench.core.lens import PhysicalLens as PhysicalLens
    from dofbench.dataset.dataset import Dataset as Dataset
    from dofbench.dataset.dataset import DatasetView as DatasetView
    from dofbench.external.external_method import External as External
    from dofbench.metrics import METRICS as METRICS
    from dofbench.metrics import Metric as Metric
    from dofbench.metrics import score_image as score_image
    from dofbench.optics.defocus import defocus_numpy as defocus_numpy
    from dofbench.procedural import make_scene as make_scene
    from dofbench.procedural.scene_options import MakeScene as MakeScene
    from dofbench.reporting import report as report
    from dofbench.reporting.report_options import Report as Report
    from dofbench.results.result import Result as Result
    from dofbench.results.result import read_result as read_result
    from dofbench.results.run_spec import Run as Run
    from dofbench.running.load_run import LoadedRun as LoadedRun
    from dofbench.running.load_run import load_run as load_run
    from dofbench.running.one_run import RunEnd as RunEnd
    from dofbench.running.one_run import run as run
    from dofbench.scenes.loading import load_scene as load_scene
    from dofbench.scenes.reconstruction import reconstruct as reconstruct
    from dofbench.scenes.reconstruction.reconstruct_options import Reconstruct as Reconstruct
    from dofbench.scenes.scene import Scene as Scene
    from dofbench.scenes.scene import SceneView as SceneView
    from dofbench.synthesis import make_dataset as make_dataset
    from dofbench.synthesis.dataset_options import MakeDataset as MakeDataset
    from dofbench.synthesis.verify import check_dataset as check_dataset

__version__ = "0.1.0"

# Name -> module that has it. tests/test_public.py compares this with the imports above, which type checkers read.
_PLACES = {
    # cameras and lenses
    "Camera": "core.cameras",
    "Lens": "core.lens",
    "PhysicalLens": "core.lens",
    "DisparityRange": "core.lens",
    "ApertureShape": "core.lens",
    "Blur": "core.blur",
    "defocus_numpy": "optics.defocus",
    # scenes
    "Scene": "scenes.scene",
    "SceneView": "scenes.scene",
    "load_scene": "scenes.loading",
    "Reconstruct": "scenes.reconstruction.reconstruct_options",
    "reconstruct": "scenes.reconstruction",
    "MakeScene": "procedural.scene_options",
    "make_scene": "procedural",
    # datasets
    "MakeDataset": "synthesis.dataset_options",
    "make_dataset": "synthesis",
    "check_dataset": "synthesis.verify",
    "Dataset": "dataset.dataset",
    "DatasetView": "dataset.dataset",
    # what a method sees, is and gives back
    "Method": "core.contracts",
    "TrainingSet": "core.contracts",
    "TrainingView": "core.contracts",
    "PointCloud": "core.contracts",
    "Budget": "core.budget",
    "Observer": "core.contracts",
    "FitOutcome": "core.contracts",
    "Rendering": "core.contracts",
    "External": "external.external_method",
    # runs, results, reports
    "Run": "results.run_spec",
    "run": "running.one_run",
    "RunEnd": "running.one_run",
    "load_run": "running.load_run",
    "LoadedRun": "running.load_run",
    "Result": "results.result",
    "read_result": "results.result",
    "Report": "reporting.report_options",
    "report": "reporting",
    # scores, images, errors
    "METRICS": "metrics",
    "Metric": "metrics",
    "score_image": "metrics",
    "read_image": "core.images",
    "write_png": "core.images",
    "InputError": "core.errors",
    "Status": "core.errors",
}

__all__ = [
    "METRICS",
    "ApertureShape",
    "Blur",
    "Budget",
    "Camera",
    "Dataset",
    "DatasetView",
    "DisparityRange",
    "External",
    "FitOutcome",
    "InputError",
    "Lens",
    "LoadedRun",
    "MakeDataset",
    "MakeScene",
    "Method",
    "Metric",
    "Observer",
    "PhysicalLens",
    "PointCloud",
    "Reconstruct",
    "Rendering",
    "Report",
    "Result",
    "Run",
    "RunEnd",
    "Scene",
    "SceneView",
    "Status",
    "TrainingSet",
    "TrainingView",
    "__version__",
    "check_dataset",
    "defocus_numpy",
    "load_run",
    "load_scene",
    "make_dataset",
    "make_scene",
    "read_image",
    "read_result",
    "reconstruct",
    "report",
    "run",
    "score_image",
    "write_png",
]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    value = getattr(import_module(f"{__name__}.{_PLACES[name]}"), name)
    globals()[name] = value  # asked for once
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
