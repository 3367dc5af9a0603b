"""Carrying out a plan: train, score, and write the result."""

from __future__ import annotations

import os
import shutil
import sys
import traceback
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, replace
from functools import partial

from rich.console import Console

from dofbench.core.budget import Budget
from dofbench.core.clock import StageTimes, loading, planning, timestamp
from dofbench.core.contracts import LENS_MEASURED, Decision, FitOutcome, Method, Resumes, TrainingSet
from dofbench.core.errors import InputError, Status, interruption
from dofbench.core.files import read_json, refuse_links_outside, sha256_file, write_json
from dofbench.core.jobs import Outcome
from dofbench.core.progress import Progress, say
from dofbench.datasets.format.dataset import Dataset
from dofbench.evaluation.metrics import METRICS
from dofbench.evaluation.results import provenance
from dofbench.evaluation.results.added_scores import ADDED_FILE
from dofbench.evaluation.results.protocol import EXIF_COLUMNS, PROTOCOLS
from dofbench.evaluation.results.result import (
    MODEL_FOLDER,
    PREDICTIONS_FOLDER,
    RESULT_FILE,
    SCHEMA_VERSION,
    CurvePoint,
    Event,
    Git,
    Result,
    StageTime,
    read_result,
    write_result,
)
from dofbench.evaluation.results.run_lock import record_out_of_memory, run_lock
from dofbench.evaluation.scoring.evaluate import Evaluation, Evaluator
from dofbench.evaluation.scoring.held_out_scores import held_out_scores
from dofbench.methods.cards import MethodEntry, find_method
from dofbench.running.checkpoints import Checkpoints
from dofbench.running.compiling import miniature, start_compiling
from dofbench.running.data_plan import revised
from dofbench.running.failures import classify
from dofbench.running.observer import OneStep, TrainingObserver
from dofbench.running.plan import Plan
from dofbench.running.show_result import show_cached, show_log, show_result
from dofbench.running.snapshots import SNAPSHOT_FOLDER, Snapshots
from dofbench.running.training_log import LOG_FOLDER, TensorBoardLog, write_log
from dofbench.runtime.compilation import compile_all
from dofbench.runtime.device_host import feeding
from dofbench.runtime.freed_memory import keep_freed_memory
from dofbench.runtime.supervised import on_death, supervised

IMPORT, PLAN, WARM_UP, TRAIN = "import", "plan", "warm up", "train"
TRAINED_FILE = "trained.json"
_SPENT = ("train_s", "train_cpu_s", "cold_start_s", "peak_mb")


def execute(plan: Plan, console: Console, progress: Progress) -> Outcome:
    """Train, score and write the result, or return the cached one.

    A run that fails still writes its result, with a typed status. Raises HeldElsewhere while another process has the
    same run at work, InputError when code or data changed since the plan was made, and KeyboardInterrupt when it was
    interrupted (after writing a result that says so).
    """
    already_compiled = kernels_compiled()
    with planning.running():
        entry, dataset = find_method(plan.spec.method), Dataset.load(plan.data)
        plan.check_unchanged(entry, dataset)
    keep_freed_memory()
    with run_lock(plan.folder, plan.spec, plan.scene, timestamp()):
        if not plan.settings.rerun and (earlier := cached(plan)) is not None:
            # Of a process that died after its result was written.
            (plan.folder / TRAINED_FILE).unlink(missing_ok=True)
            show_cached(console, plan, earlier)
            return Outcome(plan.name, folder=plan.folder, status=earlier.status, reused=True)
        start_compiling(entry, plan.spec.device)
        with loading.running():
            method = entry.create(dict(plan.spec.options), plan.spec.seed, plan.spec.device)
        stages = StageTimes()
        stages[IMPORT].move(loading)  # the method's own modules, and all that this process imported before
        stages[PLAN].move(planning)
        run = Execution(plan, entry, dataset, method, console, progress, stages, already_compiled)
        return Outcome(plan.name, folder=plan.folder, status=run.go())


def cached(plan: Plan) -> Result | None:
    """The finished result of the same run; None without one, or where running again could end otherwise."""
    if not (plan.folder / RESULT_FILE).is_file():
        return None
    earlier = read_result(plan.folder)
    return earlier if earlier.key == plan.spec.key and earlier.finished else None


@dataclass(eq=False)
class _Trained:
    """The end of training, kept on disk until the result is written, so that it can go on from there. held_out: scores
    and reasons for missing ones, which only the method as trained gives."""

    outcome: FitOutcome
    curve: list[CurvePoint]
    peak_mb: float
    compiled: int
    stages: dict[str, dict[str, float]]
    held_out: tuple[dict[str, float], dict[str, str]] = field(default_factory=lambda: ({}, {}))


class Execution:
    """One run at work: holds what it has measured so far, for the result that it writes in any case."""

    def __init__(
        self,
        plan: Plan,
        entry: MethodEntry,
        dataset: Dataset,
        method: Method,
        console: Console,
        progress: Progress,
        stages: StageTimes,
        already_compiled: int,
    ):
        self.plan, self.spec, self.folder, self.budget = plan, plan.spec, plan.folder, plan.budget
        self.entry, self.dataset, self.protocol = entry, dataset, PROTOCOLS[plan.spec.protocol]
        self.console, self.progress = console, progress
        self.stages, self.already_compiled = stages, already_compiled
        self._use(method)
        self.observer: TrainingObserver | None = None
        self.checkpoints: Checkpoints | None = None
        self.resumed: list[int] = []
        self.do_nothing: dict[str, float] = {}
        self.description: dict[str, float] = {}
        self.started = timestamp()

    def go(self) -> Status:
        """Train and score; whatever happens, a result is written."""
        refuse_links_outside(self.folder)
        if self.plan.settings.rerun:
            (self.folder / TRAINED_FILE).unlink(missing_ok=True)
        trained: _Trained | None = None
        found = Evaluation()
        trace = ""
        if supervised():
            unfinished = self._result(Status.OUT_OF_MEMORY, "", "", None, found).model_dump(mode="python")
            on_death(partial(record_out_of_memory, self.folder, unfinished))
        try:
            self.do_nothing = self.evaluator.do_nothing()
            trained = self._resumed() or self._train()
            status, message = trained.outcome.status, trained.outcome.message
            if status is Status.OK:
                found = self._score()
                found.scores |= trained.held_out[0]
                found.left_out |= trained.held_out[1]
                if found.nonfinite:
                    status = Status.DIVERGED
                    message = f"{found.nonfinite[0].detail} of view {found.nonfinite[0].view} aren't finite"
        except InputError:
            raise
        except (Exception, KeyboardInterrupt) as error:
            if (stop := interruption(error)) is not None:
                message = f"after {self._steps(trained)} steps; rerun the same command to resume"
                self._finish(Status.INTERRUPTED, message, "", trained, Evaluation())
                raise stop from None
            status, message = classify(error)
            trace = traceback.format_exc()
            found = Evaluation()
        result = self._finish(status, message, trace, trained, found)
        (self.folder / TRAINED_FILE).unlink(missing_ok=True)
        if status is not Status.OK:
            say(self.console, f"{self.spec.method} on {self.spec.dataset}: {status}: {message}")
        if trace:
            say(self.console, f"traceback in {self.folder / RESULT_FILE}")
        show_result(self.console, self.plan, result)
        say(self.console, f"result {self.folder / RESULT_FILE}")
        show_log(self.console, self.plan)
        return status

    def _compiled(self) -> int:
        """Kernels compiled since the run began; a process may have had other work before."""
        return kernels_compiled() - self.already_compiled

    def _train(self) -> _Trained:
        with self.stages["load data"].running():
            training_set = self.dataset.training_set(self.plan.settings.inputs, held_out=self.spec.held_out)
        # An earlier result's files go before they are written anew: if this run dies, none is left half.
        for name in (RESULT_FILE, ADDED_FILE):
            (self.folder / name).unlink(missing_ok=True)
        for name in (MODEL_FOLDER, PREDICTIONS_FOLDER, LOG_FOLDER, SNAPSHOT_FOLDER):
            shutil.rmtree(self.folder / name, ignore_errors=True)
        if not self.entry.card.elsewhere:
            self._warm_up(training_set)
        provenance.reset_peak_memory()
        clock, evaluating = self.stages[TRAIN], self.stages["evaluate during training"]
        logging = nullcontext() if self.plan.settings.log is None else TensorBoardLog(self.folder / LOG_FOLDER)
        with logging as log:
            show, add = (None, None) if log is None else (log.show, log.add)
            evaluate = partial(self.evaluator.quick, show)
            watched = self.plan.settings.watch and not self.entry.card.elsewhere
            snapshots = Snapshots(self.folder, self.method, self.spec, self.dataset.folder) if watched else None
            kept = self.checkpoints = self._checkpoints()
            observer = TrainingObserver(self.budget, clock, evaluating, evaluate, self.progress, add, snapshots, kept)
            self.observer = observer
            if kept is not None and (observed := kept.resume()) is not None:
                observer.resume_from(observed)
                self.started = kept.started
                say(self.console, f"resuming from the checkpoint after step {observer.steps}")
            try:
                with kept.listening() if kept else nullcontext(), clock.running(), feeding(self.spec.device):
                    outcome = self.method.fit(training_set, self.budget, observer)
            finally:
                self.progress.close()
                if kept is not None and kept.problem:
                    say(self.console, kept.problem)
            # The end alone is seen of a training elsewhere, so its first step says nothing about the budget.
            failure = None if self.entry.card.elsewhere else observer.failure()
            if failure is not None and outcome.status is Status.OK:
                outcome = replace(outcome, status=failure[0], message=failure[1])
            if outcome.status is Status.OK:
                observer.finish(outcome.steps)
        held_out: tuple[dict[str, float], dict[str, str]] = {}, {}
        if outcome.status is Status.OK:
            if self.spec.held_out > 0:
                with self.stages["score held-out pixels"].running():
                    inputs = self.plan.settings.inputs
                    held_out = held_out_scores(self.method, self.dataset, inputs, self.spec.held_out)
            with self.stages["save model"].running():
                (self.folder / MODEL_FOLDER).mkdir(parents=True, exist_ok=True)
                self.method.save(self.folder / MODEL_FOLDER)
                # Scored is what was kept, whether or not the run is interrupted here and goes on later.
                self.method.load(self.folder / MODEL_FOLDER)
        peak_mb = max(provenance.peak_memory_mb(), outcome.peak_mb)
        trained = _Trained(outcome, observer.curve, peak_mb, self._compiled(), self.stages.as_data(), held_out)
        if outcome.status is Status.OK:
            write_json(
                self.folder / TRAINED_FILE,
                {
                    "key": self.spec.key,
                    "started": self.started,
                    "steps": outcome.steps,
                    "message": outcome.message,
                    "method_stages": outcome.stages,
                    "left_out": outcome.left_out,
                    "decisions": [asdict(decision) for decision in outcome.decisions],
                    "curve": [point.model_dump() for point in trained.curve],
                    "peak_mb": trained.peak_mb,
                    "compiled": trained.compiled,
                    "stages": trained.stages,
                    "held_out": trained.held_out,
                    "resumed": self._resumed_after(),
                },
            )
            if kept is not None:
                kept.remove()
        return trained

    def _checkpoints(self) -> Checkpoints | None:
        """Of the method that trains; None for one that can't resume. A finished run has none: --rerun then trains from
        the start, and resumes after an interruption of its own."""
        if not isinstance(self.method, Resumes):
            return None
        return Checkpoints(self.folder, self.spec.key, self.method, self.started)

    def _warm_up(self, training_set: TrainingSet) -> None:
        with self.progress.uncounted("JIT compilation and warm-up"), self.stages[WARM_UP].running():
            # Kernels compile at their first call, for a minute or for none, as their cache has it. A first
            # step that isn't counted keeps that out of the training time, and of a budget in seconds.
            self.method.fit(miniature(training_set), Budget(steps=1), OneStep())
            compile_all((), self.spec.device)  # ends what a method that doesn't ask for it has left in the background
        self._use(self.entry.create(dict(self.spec.options), self.spec.seed, self.spec.device))

    def _use(self, method: Method) -> None:
        self.method = method
        self.evaluator = Evaluator(
            method, self.dataset, self.protocol, columns=self.plan.by_data.columns, left_out=self.plan.by_data.left_out
        )

    def _resumed(self) -> _Trained | None:
        """The finished training of an earlier call that was interrupted while it scored; else None."""
        file = self.folder / TRAINED_FILE
        if not file.is_file():
            return None
        data = read_json(file)
        if data["key"] != self.spec.key:  # another key with the same first eight digits
            return None
        say(self.console, "using the finished training; scores are still to be computed")
        with self.stages["load model"].running():
            self.method.load(self.folder / MODEL_FOLDER)
        self.started, self.resumed = data["started"], data.get("resumed", [])
        decisions = tuple(Decision(**decision) for decision in data.get("decisions", ()))
        outcome = FitOutcome(
            Status.OK, data["steps"], data["message"], (), data["method_stages"], data["left_out"], decisions
        )
        curve = [CurvePoint.model_validate(point) for point in data["curve"]]
        if self.plan.settings.log is not None and not (self.folder / LOG_FOLDER).is_dir():
            write_log(self.folder / LOG_FOLDER, curve)
        # Its pictures, of which some may be half, are made anew.
        shutil.rmtree(self.folder / PREDICTIONS_FOLDER, ignore_errors=True)
        scores, left_out = data.get("held_out", ({}, {}))
        return _Trained(outcome, curve, data["peak_mb"], data["compiled"], data["stages"], (scores, left_out))

    def _score(self) -> Evaluation:
        self.progress.accelerator_free()
        try:
            with self.stages["score"].running():
                found = self.evaluator.final(self.folder, self.progress.update)
        finally:
            self.progress.close()
        self._measure_speed(found)
        self.description = {name: float(value) for name, value in self.method.describe().items()}
        if "gaussians" in self.description:
            found.scores["gaussians"] = self.description["gaussians"]
        else:
            found.left_out["gaussians"] = "the method has no Gaussians"
        return found

    def _measure_speed(self, found: Evaluation) -> None:
        if self.entry.card.elsewhere:
            found.left_out["render_fps"] = "the method renders in another program"
            return
        with self.stages["measure speed"].running():
            frames = self.evaluator.frames_per_second()
        if frames is None:
            found.left_out["render_fps"] = "the dataset has no test views"
        else:
            found.scores["render_fps"] = frames

    def _model(self) -> dict[str, str]:
        root = self.folder / MODEL_FOLDER
        return {
            file.relative_to(self.folder).as_posix(): sha256_file(file)
            for file in sorted(root.rglob("*"))
            if file.is_file()
        }

    def _resumed_after(self) -> list[int]:
        """The steps after which a later process went on with the training."""
        return self.resumed if self.checkpoints is None else self.checkpoints.resumed

    def _steps(self, trained: _Trained | None) -> int:
        if trained is not None:
            return trained.outcome.steps
        return self.observer.steps if self.observer else 0

    def _finish(self, status: Status, message: str, trace: str, trained: _Trained | None, found: Evaluation) -> Result:
        result = self._result(status, message, trace, trained, found)
        write_result(self.folder, result)
        if result.finished and self.checkpoints is not None:
            self.checkpoints.remove()
        shutil.rmtree(self.folder / SNAPSHOT_FOLDER, ignore_errors=True)
        on_death(None)
        return result

    def _result(self, status: Status, message: str, trace: str, trained: _Trained | None, found: Evaluation) -> Result:
        observer, outcome = self.observer, trained.outcome if trained else None
        stages = {**(trained.stages if trained else {}), **self.stages.as_data()}
        training = stages.get(TRAIN, {"wall": 0.0, "cpu": 0.0})
        plan = revised(self.plan.by_data.as_data(), outcome.decisions if outcome else ())
        scores, left_out = dict(found.scores), {**self.plan.by_data.left_out, **found.left_out}
        apertures = found.apertures
        for decision in outcome.decisions if outcome else ():
            if decision.stage == self.entry.card.stage_decided_by("lens") and not decision.runs:
                columns = (*self.protocol.refocus_columns, *self.protocol.lens)
                left_out |= {
                    column: f"lens disabled: {decision.reason}"
                    for column in columns
                    if column in self.plan.by_data.columns and column not in scores
                }
            elif decision.stage == LENS_MEASURED and not decision.runs and apertures:
                apertures = []
                left_out |= dict.fromkeys(EXIF_COLUMNS, decision.reason)
                scores = {column: score for column, score in scores.items() if column not in EXIF_COLUMNS}
        scores |= {
            "train_s": training["wall"],
            "steps": self._steps(trained),
            "train_cpu_s": training["cpu"],
            "cold_start_s": sum(stages[name]["wall"] for name in (IMPORT, WARM_UP) if name in stages),
        }
        scores["peak_mb"] = max(provenance.peak_memory_mb(), trained.peak_mb if trained else 0.0)
        curve = trained.curve if trained else observer.curve if observer else []
        if not self.entry.card.capabilities.trains:
            left_out |= dict.fromkeys(_SPENT, "the pictures were made elsewhere, at an unknown cost")
            scores, curve = {column: score for column, score in scores.items() if column not in _SPENT}, []
        events = [*(observer.nonfinite if observer else ()), *(outcome.nonfinite if outcome else ()), *found.nonfinite]
        return Result(
            schema_version=SCHEMA_VERSION,
            key=self.spec.key,
            spec=self.spec,
            protocol={
                **self.protocol.as_data(),
                "metrics": {entry.id: entry.note for entry in METRICS.values() if entry.needs != "weights"},
            },
            plan=plan,
            status=status,
            message=message,
            traceback=trace,
            scene=self.dataset.scene,
            data=str(self.plan.data),
            data_from_here=os.path.relpath(self.plan.data.resolve(), self.folder.resolve()),
            role=self.dataset.role,
            role_by=self.dataset.role_by,
            photographer=self.dataset.photographer,
            choices=self.plan.choices,
            command=self.plan.settings.command(),
            started=self.started,
            ended=timestamp(),
            scores=scores,
            left_out=left_out,
            left_out_stages={
                **{stage["name"]: stage["reason"] for stage in plan["stages"] if not stage["runs"]},
                **(outcome.left_out if outcome else {}),
            },
            do_nothing=self.do_nothing,
            views=found.views,
            lens=found.lens,
            fits=found.fits,
            apertures=apertures,
            foci=found.foci,
            curve=curve,
            stages={name: StageTime.model_validate(time) for name, time in stages.items()},
            method_stages=outcome.stages if outcome else {},
            description=self.description,
            resumed=self._resumed_after(),
            kernels_compiled=trained.compiled if trained else self._compiled(),
            model=self._model(),
            nonfinite=[Event(**asdict(event)) for event in events],
            predictions=found.predictions,
            no_ranking=found.no_ranking,
            git=Git.model_validate(commit) if (commit := provenance.git_state()) else None,
            machine=provenance.machine(self.spec.device),
            packages=provenance.package_versions(),
        )


def kernels_compiled() -> int:
    """Kernels that this process has compiled so far; none where their machine code lay on disk."""
    cache = sys.modules.get("dofbench.runtime.kernel_cache")
    return cache.compiled() if cache else 0
