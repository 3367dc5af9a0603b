"""A whole report as plain data: what every writer is given."""

from __future__ import annotations

from dataclasses import dataclass

from dofbench.reporting.gallery import BoardPictures
from dofbench.reporting.plots import Plot
from dofbench.reporting.records import Records
from dofbench.reporting.view import Document, Items, Paragraph, Picture, Section, Table


@dataclass(frozen=True)
class CurveView:
    """One score against training time. plot: what is drawn. picture: the drawing, None where there is none.
    front_words: who holds the Pareto front, in a sentence, "" where there is no front. reach: times to reach levels,
    None where no score moved. front: the front as a table."""

    title: str
    plot: Plot
    picture: Picture | None
    front_words: str
    reach: Table | None
    front: Table | None


@dataclass(frozen=True)
class BoardView:
    """One dataset under one protocol. about: scene, the dataset's version and its lenses. differences: its rows
    compared with each other. asked: its rows by what the test views ask for, of a held-out focus. strip: truth,
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
    """Everything that a report says.

    headline: the whole in one line. best: the best row of each board, by how much, and how sure that is. facts: what
    was run, on what, how long it took, what failed: (term, lines). boards, means: every score, by dataset and as means
    over scenes. layouts: tables as the paper lays them out. tested: how differences are tested. claims: what authors
    say of their methods. columns: what every score says. added: which scores were computed after their runs.
    runs, stages: how each run was made, and where its time went. machines: the machines that `runs` numbers.
    unreadable: results that can't be read. curve_rules: how times, levels and fronts are meant. gallery: pictures of
    the test views; None where none are wanted. ablations: tables of `dofbench ablate`. records: the CSV files.
    """

    headline: str
    best: Table
    facts: tuple[tuple[str, tuple[str, ...]], ...]
    boards: tuple[BoardView, ...]
    means: tuple[Section, ...]
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
