"""A whole report as plain data, from which every writer works."""

from __future__ import annotations

from dataclasses import dataclass

from dofbench.reporting.gallery import BoardPictures
from dofbench.reporting.plots import Plot
from dofbench.reporting.records import Records
from dofbench.reporting.view import Document, Items, Paragraph, Picture, Section, Table


@dataclass(frozen=True)
class CurveView:
    """One score against training time. plot: the data. picture: the drawing, or None. front_words: a sentence on which
    series form the Pareto front, "" without a front. reach: times to reach levels, None if no score changed. front: the
    front as a table."""

    title: str
    plot: Plot
    picture: Picture | None
    front_words: str
    reach: Table | None
    front: Table | None


@dataclass(frozen=True)
class BoardView:
    """One dataset under one protocol. about: scene, the dataset's version and its lenses. differences: its rows
    compared with each other. asked: its rows by the test views' lenses, if their focus was held out. strip: truth,
    predictions and errors as one picture."""

    title: str
    about: Paragraph
    scores: Table
    differences: Section | None
    asked: Section | None
    curves: tuple[CurveView, ...]
    strip: Picture | None


@dataclass(frozen=True)
class ReportView:
    """The whole content of a report.

    headline: a summary in one line. best: the best over scenes and of each board, its lead, and how sure that is.
    facts: what was run, on which datasets, how long it took, what failed: (term, lines). boards, means, mean_curves:
    every score, by dataset and as means over scenes, with their curves. layouts: tables as the paper lays them out.
    tested: how differences are tested. claims: figures that authors published for their methods. columns: explanations
    of the scores. added: which scores were computed after their runs. runs, stages: how each run was made, and its time
    by stage. machines: the machines, by their number in `runs`. unreadable: results that can't be read. curve_rules:
    explanation of times, levels and fronts. gallery: pictures of the test views; None for a report without pictures.
    ablations: tables of `dofbench ablate`. records: the CSV files.
    """

    headline: str
    best: Table
    facts: tuple[tuple[str, tuple[str, ...]], ...]
    boards: tuple[BoardView, ...]
    means: tuple[Section, ...]
    mean_curves: tuple[CurveView, ...]
    layouts: tuple[Section, ...]
    tested: Section | None
    claims: Section | None
    columns: Section
    added: Section | None
    runs: Table
    stages: Table
    machines: Items
    unreadable: Items
    curve_rules: Paragraph
    gallery: tuple[BoardPictures, ...] | None
    ablations: tuple[Document, ...]
    records: tuple[Records, ...]
