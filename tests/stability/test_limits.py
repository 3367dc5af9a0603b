"""The list of known limits: its cases exist and have reasons, and meeting the bound of a known limit isn't a
failure."""

from __future__ import annotations

import pytest

from dofbench.core.errors import InputError
from dofbench.evaluation.stability.case import Case, Found, Setting
from dofbench.evaluation.stability.catalogue import Limit, catalogue, limit_of, read_limits
from dofbench.evaluation.stability.measure import measured
from dofbench.evaluation.stability.stability_table import KNOWN, MET, MET_HERE, NOT_MET, judged
from dofbench.runtime.ops import backends, ops

HERE = Setting("cpu", "float32")
CASES = {case.id: case for case in catalogue()}
# These train, or differentiate what takes long.
SLOW = ("training", "gradients")


def case(found: Found) -> Case:
    return Case("lens", "made-up", "scatter", "something", "a reason", (HERE,), lambda setting: found)


@pytest.mark.parametrize(
    ("found", "listed", "verdict"),
    [
        (Found(0.5, 1.0), False, MET),
        (Found(2.0, 1.0), False, NOT_MET),
        (Found(2.0, 1.0), True, KNOWN),
        (Found(0.5, 1.0), True, MET_HERE),
        (Found(float("nan"), 1.0), False, NOT_MET),
        (Found(float("inf"), float("inf")), False, NOT_MET),
    ],
)
def test_a_verdict_follows_from_bound_and_list(found, listed, verdict):
    limits = (Limit("lens/made-up", ("cpu float32",), "so it is"),) if listed else ()
    row = judged(case(found), HERE, found, limits)
    assert row.verdict == verdict
    assert row.note == ("so it is" if listed else found.note)


def test_an_exception_is_no_verdict_but_an_infinite_error():
    def fails(setting):
        raise RuntimeError("no such thing")

    found = measured(Case("lens", "made-up", "scatter", "something", "a reason", (HERE,), fails), HERE)
    assert not found.met and "RuntimeError: no such thing" in found.note


def test_every_limit_names_a_case_and_places_where_it_is_run():
    for limit in read_limits():
        known = CASES[limit.case]
        places = {f"{setting.label} {setting.precision}" for setting in known.settings}
        if known.subject in ops() and "gpu" in backends(known.subject):  # which this machine may lack
            places.add("gpu-cuda float32")
        assert set(limit.where) <= places | {"all"}, limit.case


@pytest.mark.parametrize(
    "limit",
    [limit for limit in read_limits() if not limit.case.startswith(SLOW)],
    ids=lambda limit: f"{limit.case} {' '.join(limit.where)}",
)
def test_a_known_limit_is_measured_and_may_be_met(limit):
    """Rounding differs by machine, so the bound of a limit may be met; but an exception doesn't count as a known
    limit."""
    known = CASES[limit.case]
    places = [setting for setting in known.settings if limit_of(known, setting, (limit,))]
    assert places
    for setting in places:
        found = measured(known, setting)
        assert "Error: " not in found.note, found.note
        assert judged(known, setting, found, (limit,)).verdict == (MET_HERE if found.met else KNOWN)


ENTRY = "[[limit]]\ncase = 'a'\nwhere = ['all']\nreason = '{}'\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[[limit]]\ncase = 'a'\nwhere = ['all']", "no list of limits"),
        ("limit = 3", "no list of limits"),
        ("[[limit", "no list of limits"),
        (ENTRY.format("x") + ENTRY.format("y"), "twice"),
        (ENTRY.format(" "), "without a reason"),
    ],
)
def test_an_invalid_list_is_a_mistake_of_one_line(tmp_path, text, words):
    (tmp_path / "limits.toml").write_text(text)
    with pytest.raises(InputError, match=words):
        read_limits(tmp_path / "limits.toml")
