"""`dofbench methods`: which methods there are, and what can be chosen of one."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from called import called
from fake_method import write_method

from dofbench.cli import app, list_methods
from dofbench.core.content import content_folder

SHIPPED = {file.parent.name for file in content_folder("methods").glob("*/method.toml")}

# What a method's class may say of its options; appended to the fake's code.
LISTED = """

from dataclasses import dataclass


@dataclass(frozen=True)
class Option:
    name: str
    group: str
    type: str
    default: object
    meaning: str
    unit: str
    source: str


def available_options(cls):
    return (
        Option("steps", "schedule", "whole number", 8, "How long it trains.", "steps", "own"),
        Option("noise", "schedule", "number", 0.1, "What is added. " + 20 * "Many words. ", "", "Nobody, Eq. 1"),
        Option("trouble", "faults", "none, lost, crash", "", "How it goes wrong.", "", "own"),
        Option("lens", "faults", "true or false", True, "Whether it has one.", "", "own"),
    )


Fake.available_options = classmethod(available_options)
"""


@pytest.fixture
def fakes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of two fake methods: "fake", which lists its options, and "silent", which doesn't."""
    root = write_method(tmp_path / "methods")
    write_method(root, "silent", refocus=False)
    code = root / "fake" / "trainer.py"
    code.write_text(code.read_text() + LISTED)
    monkeypatch.setenv("DOFBENCH_METHODS", str(root))
    return root


@pytest.fixture
def said(capsys: pytest.CaptureFixture[str]):
    """`said("methods", ...)` calls the command line; returns the exit status, what was printed, and the complaint."""

    def call(*words: str) -> tuple[int, list[str], str]:
        status = app.main(words)
        printed = capsys.readouterr()
        return status, printed.out.splitlines(), printed.err

    return call


def cells(heading: str, line: str) -> dict[str, str]:
    """The cells of an aligned line by the headings above it: each begins where its heading does."""
    found = list(re.finditer(r"\S+(?: \S+)*", heading))
    ends = [*(one.start() for one in found[1:]), len(line)]
    return {one[0]: line[one.start() : end].strip() for one, end in zip(found, ends, strict=True)}


def test_every_method_is_a_line(fakes: Path, said) -> None:
    status, lines, _ = said("methods")
    rows = {row["method"]: row for row in (cells(lines[0], line) for line in lines[1 : len(SHIPPED) + 3])}
    assert status == 0 and set(rows) == SHIPPED | {"fake", "silent"}
    assert rows["fake"] == {
        "method": "fake",
        "name": "Fake",
        "devices": "cpu",
        "presets": "quick*, slow",
        "claims from": "Nobody 2020, Table 1",
    }
    assert rows["mipsplatting"]["claims from"] == "-"  # the card has none
    assert "dofbench methods METHOD" in lines[-1]


def test_one_method_with_all_that_can_be_chosen(fakes: Path, said) -> None:
    status, lines, _ = said("methods", "fake")
    assert status == 0 and lines[:3] == ["fake: Fake", "A fake", "Nobody, 2020"]
    facts = {" ".join(line.split()) for line in lines}
    assert {f"folder {fakes / 'fake'}", "devices cpu", "learns the lens of every view yes"} <= facts
    quick = lines.index("  quick: the default, budget 8it")
    assert lines[quick + 1 : quick + 3] == ["  slow", "      steps=12 noise=0.2"]
    assert "lens_per_view lens_per=scene" in facts  # what the plan may set

    heading = next(line for line in lines if line.split()[:2] == ["option", "default"])
    options = {line.split()[0]: cells(heading, line) for line in lines if re.match(r"    [a-z]+ +\S+ +\S+ +\S", line)}
    assert options["steps"] == {"option": "steps", "default": "8", "unit": "steps", "type": "whole number"}
    assert options["trouble"] == {"option": "trouble", "default": '""', "unit": "-", "type": "none, lost, crash"}
    assert options["lens"]["default"] == "true" and options["noise"]["default"] == "0.1"
    text = " ".join(" ".join(lines).split())
    assert "How long it trains. Source: own." in text and "Many words. Source: Nobody, Eq. 1." in text
    assert lines.index("  schedule") < lines.index("  faults")  # by what they steer
    assert max(map(len, lines)) < 120  # long meanings are wrapped

    claims = next(index for index, line in enumerate(lines) if line.startswith("  measured on"))
    assert cells(lines[claims], lines[claims + 1]) == {
        "measured on": "their own data",
        "psnr": "28.7",
        "delta_a": "0.126",
    }
    assert lines[claims + 2] == "  Source: Nobody 2020, Table 1"


def test_a_method_that_lists_no_options_has_the_rest(fakes: Path, said) -> None:
    status, lines, _ = said("methods", "silent")
    assert status == 0 and any("has no available_options" in line for line in lines)
    assert "  slow" in lines and "  Source: Nobody 2020, Table 1" in lines


def test_a_shipped_method_says_where_its_claims_stand(said) -> None:
    status, lines, _ = said("methods", "dofgaussian")
    text = " ".join(" ".join(lines).split())
    assert status == 0 and "Source: Shen et al., CVPR 2025, Tables 2, 6 and 7" in text
    assert "  quick: the default on the built-in dataset, as short, but" in lines and "      steps=1500" in lines


def test_the_kernels_of_a_shipped_method_with_their_backends(said) -> None:
    _, lines, _ = said("methods", "mipsplatting")
    first = next(index for index, line in enumerate(lines) if line.split()[:2] == ["kernel", "backend"])
    rows = [cells(lines[first], line) for line in lines[first + 1 : lines.index("", first) - 2]]
    assert {row["kernel"] for row in rows} == {"adam", "colours", "rasterize", "ssim", "stereo", "surface"}
    expected = {"kernel": "ssim", "backend": "cpu", "devices": "cpu", "types": "float32", "bits repeat": "yes"}
    assert expected in rows
    expected = {"backend": "reference", "devices": "cpu, cuda", "types": "float64, float32", "bits repeat": "no"}
    assert {"kernel": "ssim", **expected} in rows
    for device in ("cpu", "cuda"):
        assert f"  On {device} all give the same bits in every run, whatever the number of threads." in lines


def test_a_kernel_whose_bits_change_is_named(said, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a call would get the reference, as it would without a compiled backend."""
    monkeypatch.setattr(list_methods, "chosen", lambda op, device: "reference" if op == "ssim" else "cpu")
    _, lines, _ = said("methods", "mipsplatting")
    assert "  On cpu all but ssim give the same bits in every run, whatever the number of threads." in lines


def test_a_method_without_kernels_has_no_such_lines(fakes: Path, said) -> None:
    _, lines, _ = said("methods", "silent")
    assert not any("Kernels" in line or "bits" in line for line in lines)


def test_an_unknown_method_is_one_line(fakes: Path, said) -> None:
    status, lines, complaint = said("methods", "nobodys")
    assert (status, lines) == (2, [])
    known = ", ".join(sorted(SHIPPED | {"fake", "silent"}))
    assert complaint == f"dofbench: method: found 'nobodys', expected one of {known}\n"


def test_a_card_that_cannot_be_read_hides_no_other(fakes: Path, said) -> None:
    (fakes / "silent" / "method.toml").write_text("name =")
    status, lines, _ = said("methods")
    assert status == 1 and any(line.startswith("fake ") for line in lines)
    assert sum(line.startswith("no method: ") and "silent/method.toml" in line for line in lines) == 1
    status, lines, complaint = said("methods", "silent")
    assert (status, lines) == (2, []) and re.fullmatch(r"dofbench: .*silent/method.toml: found no TOML .*\n", complaint)


@pytest.mark.parametrize(
    ("code", "problem"), [("import nothing_of_that_name\n", "nothing_of_that_name"), ("", "which isn't there")]
)
def test_a_class_that_cannot_be_loaded_leaves_the_rest(fakes: Path, said, code: str, problem: str) -> None:
    (fakes / "fake" / "trainer.py").write_text(code)
    status, lines, _ = said("methods", "fake")
    assert status == 1 and "  slow" in lines
    assert any("can't be listed" in line and problem in line for line in lines)


def test_the_program_lists_them_without_loading_any() -> None:
    script = (
        "import sys; from dofbench.cli import app; status = app.main(['methods'])\n"
        "print('loaded', [name for name in ('torch', 'numba', 'cv2', 'pycolmap') if name in sys.modules])\n"
        "sys.exit(status)"
    )
    done = called([sys.executable, "-c", script])
    assert done.returncode == 0, done.stderr
    assert "dofgaussian" in done.stdout and done.stdout.splitlines()[-1] == "loaded []"
