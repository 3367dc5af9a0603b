"""Notes on scores of photographs: ranking, coverage, and apertures from two starts."""

from __future__ import annotations

from pathlib import Path

import pytest

from dofbench.core.errors import Status
from dofbench.evaluation.comparing.photograph_notes import ONE_START, photograph_notes, undetermined
from dofbench.evaluation.results.collecting import Entry
from dofbench.evaluation.results.protocol import EXIF_COLUMNS
from dofbench.evaluation.results.result import Result, Spec, ViewAperture, ViewScores
from dofbench.reporting.boards import gather

A, B = ("a",), ("b",)
NAMES = {A: ("lens", "cpu"), B: ("lens", "cpu other")}


def run(
    test: dict[str, float],
    train: str = "pqr",
    *,
    start: float | None = None,
    measured: float | None = None,
    product: float = 10.0,
    protocol: str = "photographs-v2",
    scores: dict[str, float] | None = None,
    no_ranking: str = "",
    dataset: str = "seal",
) -> Entry:
    """A run scored on photographs. product: aperture x f-number that it learned, within 2 %."""
    chosen = {"lens_init_aperture": start, "lens_measured_at": measured}
    options = {name: value for name, value in chosen.items() if value is not None}
    spec = Spec(
        **{"method": "lens", "preset": "cpu", "overrides": options, "options": options, "budget": "9it", "seed": 0},
        **{"dataset": dataset, "dataset_checksum": dataset, "protocol": protocol, "device": "cpu", "code": "1+c"},
    )
    column = "across_psnr" if protocol.startswith("across") else "photo_psnr"
    shares = [(number, share) for number in (2.0, 4.0) for share in (0.98, 0.99, 1.0, 1.01, 1.02)]
    lenses = {"train": dict.fromkeys(train), "test": dict.fromkeys(test), "assign": "unknown"}
    result = Result.model_construct(
        scores={column: 20.0, **dict.fromkeys(EXIF_COLUMNS, 3.0), **(scores or {})},
        left_out={},
        views=[ViewScores(name=name, scores={column: value}) for name, value in test.items()],
        plan={"stages": [], "lenses": lenses},
        apertures=[ViewAperture(name="v", aperture=product * share / number, f_number=number)
                   for number, share in shares],
        **{"no_ranking": no_ranking, "role": None, "photographer": "unknown"},
        **{"do_nothing": {}, "left_out_stages": {}, "curve": []},
    )  # fmt: skip
    return Entry(Path(), spec, "seal", Status.OK, "", result)


def evidence(energy: float, reason: str) -> Entry:
    return run({"u": 20.0}, scores={"lens_energy": energy, "lens_seen": 30.0}, no_ranking=reason)


def test_a_dataset_cannot_rank_if_no_run_shows_that_it_can() -> None:
    weak, weaker = evidence(2.0, "blur explains 2 %"), evidence(1.0, "blur explains 1 %")
    (line, *_) = photograph_notes({A: [weaker], B: [weak]}, [], NAMES)
    assert line == "This dataset can't rank lenses: blur explains 2 %."
    for groups in ({A: [weak], B: [evidence(9.0, "")]}, {A: [run({"u": 20.0})]}):
        assert not any("rank" in line for line in photograph_notes(groups, [], NAMES))


@pytest.mark.parametrize("protocol", ["photographs-v2", "across-apertures-v2"])
def test_coverage_is_stated_over_the_photographs_that_both_are_scored_on(protocol: str) -> None:
    plain = run({"s": 20.0, "t": 10.0, "u": 22.0}, protocol=protocol)
    more = run({"s": 23.0, "u": 24.0}, "pqrt", dataset="seal half")
    (line, *_) = photograph_notes({A: [plain]}, [plain, more], NAMES)
    assert line == (
        "Coverage, lens cpu: 23.50 dB on 2 of the test photographs when trained on the other 1 as well, "
        "21.00 dB without."
    )


@pytest.mark.parametrize(
    "other",
    [run({"s": 23.0}, "pqr"), run({"s": 23.0}, "qrtu"), run({"s": 1.0, "t": 1.0, "u": 1.0}),
     run({"s": 23.0}, "pqrtu", start=2.0)],
    ids=["fewer test views only", "another training view", "the same split", "other options"],
)  # fmt: skip
def test_other_datasets_of_the_scene_say_nothing_on_coverage(other: Entry) -> None:
    plain = run({"s": 20.0, "t": 10.0, "u": 22.0})
    assert not any("Coverage" in line for line in photograph_notes({A: [plain]}, [plain, other], NAMES))


def of_starts(
    first: float, second: float, apart: float = 4.0, measured: float | None = None
) -> dict[tuple[str, ...], list[Entry]]:
    return {
        variant: [run({}, start=start, product=product, measured=measured)]
        for variant, start, product in ((A, 0.25, first), (B, 0.25 * apart, second))
    }


def test_two_starts_that_agree_are_stated_with_their_intervals() -> None:
    groups = of_starts(10.0, 10.1)
    assert undetermined(groups) == {}
    lines = photograph_notes(groups, [], NAMES)
    assert len(lines) == 2 and all("two starts agree: aperture × f-number 9." in line for line in lines)
    assert "aperture spread 95 % from" in lines[0] and lines[0].startswith("Apertures against EXIF, lens cpu:")


def test_two_starts_that_differ_leave_no_score() -> None:
    groups = of_starts(10.0, 15.0, measured=1.0)
    assert undetermined(groups).keys() == {A, B}
    (board,) = gather([entry for runs in groups.values() for entry in runs])
    for line in board.lines.values():
        for column in EXIF_COLUMNS:
            assert line.cells[column].value is None and line.cells[column].reason.startswith("undetermined: aperture")
    assert all(line.cells["photo_psnr"].value == 20.0 for line in board.lines.values())


@pytest.mark.parametrize(
    "groups",
    [
        {A: [run({})]},
        of_starts(10.0, 15.0, apart=3.9),
        {A: [run({}, start=1.0)], B: [run({}, "other")]},
        of_starts(10.0, 10.0, measured=0.2),  # the measurement has replaced both starts
    ],
)
def test_without_two_starts_a_factor_of_four_apart_there_is_one(groups: dict) -> None:
    assert undetermined(groups) == {}
    assert all(line.endswith(f"{ONE_START}.") for line in photograph_notes(groups, [], NAMES))


def test_a_run_from_the_usual_start_shares_the_verdict_of_the_pair() -> None:
    groups = {**of_starts(10.0, 15.0), ("c",): [run({})]}
    assert undetermined(groups).keys() == groups.keys()
