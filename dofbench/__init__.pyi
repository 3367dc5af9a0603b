"""The public names. Modules may change from version to version; these names don't."""

from .core.blur import Blur as Blur
from .core.budget import Budget as Budget
from .core.cameras import Camera as Camera
from .core.contracts import FitOutcome as FitOutcome
from .core.contracts import Method as Method
from .core.contracts import Observer as Observer
from .core.contracts import PointCloud as PointCloud
from .core.contracts import Rendering as Rendering
from .core.contracts import TrainingSet as TrainingSet
from .core.contracts import TrainingView as TrainingView
from .core.errors import InputError as InputError
from .core.errors import Status as Status
from .core.images import read_image as read_image
from .core.images import write_png as write_png
from .core.jobs import Outcome as Outcome
from .core.lens import ApertureShape as ApertureShape
from .core.lens import DisparityRange as DisparityRange
from .core.lens import Lens as Lens
from .core.lens import PhysicalLens as PhysicalLens
from .datasets.format.dataset import Dataset as Dataset
from .datasets.format.dataset import DatasetView as DatasetView
from .datasets.synthesis import make_dataset as make_dataset
from .datasets.synthesis.dataset_options import MakeDataset as MakeDataset
from .datasets.synthesis.verify import check_dataset as check_dataset
from .evaluation.metrics import METRICS as METRICS
from .evaluation.metrics import Metric as Metric
from .evaluation.metrics import score_image as score_image
from .evaluation.results.result import Result as Result
from .evaluation.results.result import read_result as read_result
from .evaluation.results.run_spec import RunSpec as RunSpec
from .methods.external.external_method import External as External
from .optics.defocus import defocus_numpy as defocus_numpy
from .reporting import report as report
from .reporting.report_options import Report as Report
from .running.load_run import LoadedRun as LoadedRun
from .running.load_run import load_run as load_run
from .running.one_run import run as run
from .scenes.loading import load_scene as load_scene
from .scenes.procedural import make_scene as make_scene
from .scenes.procedural.scene_options import MakeScene as MakeScene
from .scenes.reconstruction import reconstruct as reconstruct
from .scenes.reconstruction.reconstruct_options import Reconstruct as Reconstruct
from .scenes.scene import Scene as Scene
from .scenes.scene import SceneView as SceneView

__version__: str
