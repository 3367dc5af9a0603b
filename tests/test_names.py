"""Names that files bring stay inside the folder that they are joined to."""

import os
from pathlib import PurePosixPath

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, ValidationError

from dofbench.core.errors import InputError
from dofbench.core.names import LONGEST, InsideName, InsidePath, inside, problem_with


class Record(BaseModel):
    path: InsidePath = "a"
    name: InsideName = "a"


@pytest.mark.parametrize(
    "name",
    [
        "", "..", "../victim", "a/../../victim", "/etc/passwd", "C:\\victim", "\\\\server\\share", "a\\..\\..\\victim",
        "a\0b", "a\nb", "a" * (LONGEST + 1), "é" * 101, "S\udce4ule",
    ],
)  # fmt: skip
def test_what_leads_outside_or_is_no_name_is_refused(name):
    with pytest.raises(InputError, match=r"dataset\.json"):
        inside(name, "dataset.json")
    with pytest.raises(ValidationError):
        Record(path=name)


@pytest.mark.parametrize(
    "name", ["view", "images/a b (1).png", "a..b", "...", ".hidden", "Säule_001.png", "a" * LONGEST]
)
def test_a_usual_name_is_kept_as_it_is(name):
    assert inside(name, "dataset.json") == name == Record(path=name).path


@pytest.mark.parametrize("name", [None, 3, ["a"]])
def test_what_is_no_text_is_refused(name):
    with pytest.raises(InputError):
        inside(name, "dataset.json")


def test_the_name_of_one_file_has_no_folder():
    with pytest.raises(ValidationError):
        Record(name="images/a.png")


@given(st.text(st.sampled_from("./\\a:\0\n"), max_size=12))
def test_no_accepted_name_leads_out_of_a_folder(name):
    if problem_with(name) == "":
        joined = os.path.normpath(PurePosixPath("/root/folder") / name)
        assert joined.startswith("/root/folder/") or joined == "/root/folder"
