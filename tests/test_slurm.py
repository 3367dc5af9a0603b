"""Runs as jobs of a real Slurm on this machine: what is finished stays, nothing is made twice, whatever is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from called import PATIENCE, called, dofbench, fake_method_and_data
from slurm_cluster import Cluster, absent, cluster
from small_disk import small_disk

from dofbench.core.content import content_folder
from dofbench.datasets.synthesis.verify import check_dataset
from dofbench.evaluation.results.result import read_result

pytestmark = [pytest.mark.slow, pytest.mark.skipif(bool(absent()), reason=absent())]

# What the fake does is written down. Where a file names a moment, its process is killed there, once.
WATCHED = """

import os
import signal
import time
from pathlib import Path

LOG = Path(os.environ["FAKE_LOG"])


class Watched(Fake):
    def fit(self, training_set, budget, observer):
        if budget.steps == 1:
            return super().fit(training_set, budget, observer)
        with open(LOG / "log.txt", "a") as stream:
            stream.write(f"begun {self.seed} {os.getpid()}\\n")
        try:
            (LOG / f"die-{self.seed}").unlink()
            os.kill(os.getpid(), signal.SIGKILL)
        except FileNotFoundError:
            pass
        time.sleep(float(os.environ.get("FAKE_TAKES", "0")))
        outcome = super().fit(training_set, budget, observer)
        with open(LOG / "log.txt", "a") as stream:
            stream.write(f"trained {self.seed}\\n")
        return outcome
"""


@pytest.fixture(scope="module")
def slurm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with cluster(tmp_path_factory.mktemp("slurm")) as found:
        yield found


@pytest.fixture
def command(slurm: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[str]]:
    """`command(6)`: `dofbench run --on slurm` of a method that costs nothing, with six seeds."""
    fake_method_and_data(tmp_path, monkeypatch, 48, WATCHED, "Watched")
    (tmp_path / "log").mkdir()
    (tmp_path / "log" / "log.txt").touch()
    monkeypatch.setenv("FAKE_LOG", str(tmp_path / "log"))
    for name, value in slurm.environment.items():
        monkeypatch.setenv(name, value)

    def words(seeds: int) -> list[str]:
        where = ("--data", tmp_path / "data", "--out", tmp_path / "results")
        on = ("--on", "slurm", "--slurm", "cpus_per_task=1,mem=500MB")
        return dofbench("run", "--method", "fake", "--seeds", seeds, *where, *on)

    return words


def counts(folder: Path, word: str) -> Counter[str]:
    lines = [line.split() for line in (folder / "log" / "log.txt").read_text().splitlines()]
    return Counter(line[1] for line in lines if line[0] == word)


def statuses(folder: Path) -> list[str]:
    return [str(read_result(file).status) for file in sorted((folder / "results").rglob("result.json"))]


def until(what: Callable[[], object]) -> None:
    limit = time.monotonic() + PATIENCE
    while not what():
        assert time.monotonic() < limit, "not there in time"
        time.sleep(0.1)


def started(words: list[str]) -> subprocess.Popen[str]:
    return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def in_the_middle(words: list[str], folder: Path) -> subprocess.Popen[str]:
    """The command of two runs, once both are at work."""
    client = started(words)
    until(lambda: len(counts(folder, "begun")) == 2)
    return client


def abandon(words: list[str], folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kill the command of two runs while both are at work; they take 15 s more."""
    monkeypatch.setenv("FAKE_TAKES", "15")
    client = in_the_middle(words, folder)
    client.kill()
    client.wait()


def test_runs_are_made_by_jobs_each_once(command, slurm: Cluster, tmp_path: Path) -> None:
    done = called(command(4))
    assert done.returncode == 0, done.stdout + done.stderr
    assert statuses(tmp_path) == ["ok"] * 4 and set(counts(tmp_path, "trained").values()) == {1}
    assert "4 of 4 runs ok" in done.stdout
    until(lambda: not slurm.jobs())  # the last one has answered, and may be ending
    assert not list((tmp_path / "results" / ".slurm" / "records").iterdir())
    again = called(command(5))
    assert again.returncode == 0 and "4 of them cached" in again.stdout and counts(tmp_path, "trained")["4"] == 1


def test_a_killed_worker_is_made_again(command, tmp_path: Path) -> None:
    (tmp_path / "log" / "die-1").touch()
    done = called(command(2))
    assert done.returncode == 0, done.stdout + done.stderr
    assert counts(tmp_path, "begun") == {"0": 1, "1": 2} and statuses(tmp_path) == ["ok"] * 2


def test_a_killed_client_leaves_its_jobs_and_the_next_one_finds_them(
    command, slurm: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    abandon(command(2), tmp_path, monkeypatch)
    done = called(command(2))
    assert done.returncode == 0, done.stdout + done.stderr
    assert counts(tmp_path, "begun") == {"0": 1, "1": 1} and statuses(tmp_path) == ["ok"] * 2


def test_what_ended_while_no_client_was_there_leaves_nothing(
    command, slurm: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    abandon(command(2), tmp_path, monkeypatch)
    until(lambda: not slurm.jobs())
    answers = list((tmp_path / "results" / ".slurm" / "jobs").glob("*.pkl"))
    for answer in answers:  # as if a while had passed
        os.utime(answer, (0, 0))
    monkeypatch.setenv("FAKE_TAKES", "0")
    done = called(command(3))
    assert done.returncode == 0 and "2 of them cached" in done.stdout, done.stdout + done.stderr
    assert answers and not [file for file in (tmp_path / "results" / ".slurm").rglob("*") if not file.is_dir()]


def test_two_clients_at_once_make_each_run_once(command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAKE_TAKES", "3")
    both = [started(command(4)) for _ in range(2)]
    said = [client.communicate(timeout=PATIENCE)[0] for client in both]
    assert [client.returncode for client in both] == [0, 0], said
    assert counts(tmp_path, "trained") == dict.fromkeys("0123", 1) and all("4 of 4 runs ok" in one for one in said)


def test_a_node_that_vanishes_and_comes_back(
    command, slurm: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """slurmd is killed, and all that runs on the node with it."""
    monkeypatch.setenv("FAKE_TAKES", "20")
    client = in_the_middle(command(2), tmp_path)
    slurm.kill("slurmd")
    for line in (tmp_path / "log" / "log.txt").read_text().splitlines():
        os.kill(int(line.split()[2]), signal.SIGKILL)
    subprocess.run(["pkill", "-KILL", "slurmstepd"], check=False)
    time.sleep(5)
    slurm.start_node()
    said, _ = client.communicate(timeout=PATIENCE)
    assert client.returncode == 0, said
    assert statuses(tmp_path) == ["ok"] * 2 and counts(tmp_path, "trained") == {"0": 1, "1": 1}


def test_before_a_time_limit_a_training_is_kept_and_goes_on(command, slurm: Cluster, tmp_path: Path) -> None:
    """SIGUSR2, as Slurm sends it before a limit or a preemption, in the middle of a real training."""
    words = command(1)
    words[words.index("fake")] = "3dgs"
    client = started([*words[:-4], "--budget", "1500it", "--watch", *words[-4:]])
    until(lambda: any((tmp_path / "results").glob("*/*/snapshots/0*")))
    (number,) = slurm.jobs()
    slurm.command("scancel", "--signal=USR2", number)
    said, _ = client.communicate(timeout=PATIENCE)
    assert client.returncode == 0, said
    (file,) = (tmp_path / "results").rglob("result.json")
    result = read_result(file)
    assert result.status == "ok" and result.scores["steps"] == 1500 and len(result.resumed) == 1


def test_on_a_full_disk_what_is_finished_stays(command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One run is finished, then the disk of the results is full when two more write theirs; with room again only these
    are made."""
    with small_disk(tmp_path / "results", 30_000) as mounted:
        assert called(command(1)).returncode == 0
        monkeypatch.setenv("FAKE_TAKES", "4")
        client = started(command(3))
        until(lambda: len(counts(tmp_path, "begun")) == 3)
        with suppress(OSError), (tmp_path / "results" / "filler").open("wb", buffering=0) as filler:
            while True:
                filler.write(bytes(4096))
        said, _ = client.communicate(timeout=PATIENCE)
        assert client.returncode == 1 and "No space left" in said and "Traceback" not in said, said
        assert statuses(tmp_path) == ["ok"]
        mounted("size=90m")
        done = called(command(3))
        assert done.returncode == 0, done.stdout + done.stderr
        assert statuses(tmp_path) == ["ok"] * 3 and counts(tmp_path, "begun")["0"] == 1


def test_what_always_dies_is_named_with_its_log(command, tmp_path: Path) -> None:
    method = tmp_path / "methods" / "fake" / "trainer.py"
    method.write_text(method.read_text().replace('(LOG / f"die-{self.seed}").unlink()', 'print("no luck", flush=True)'))
    done = called(command(1))
    assert done.returncode == 1
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("failed: ")]
    assert "died 3 times" in line and "log" in line and counts(tmp_path, "begun") == {"0": 3}


def test_datasets_are_made_by_jobs(command, tmp_path: Path) -> None:
    """Two lenses of one scene: the second job waits for the first, whose depth it copies."""
    foliage = content_folder("datasets") / "thinlens" / "foliage"
    lenses = ("--assign", "fixed", "--focus", "0.2,0.8", "--aperture", "1.0", "--width", 32)
    out = tmp_path / "made"
    done = called(dofbench("make-dataset", foliage, *lenses, "--out", out, *command(1)[-4:]))
    assert done.returncode == 0, done.stdout + done.stderr
    made = [file.parent for file in sorted(out.glob("*/dataset.json"))]
    assert len(made) == 2 and all(check_dataset(folder) == [] for folder in made)


def test_the_runs_of_an_ablation_are_jobs(command, slurm: Cluster, tmp_path: Path) -> None:
    tables = tmp_path / "tables.toml"
    tables.write_text(
        'method = "fake"\n\n[[tables]]\nid = "noise"\ntitle = "What noise costs"\ncolumns = ["psnr"]\n'
        'switches = ["noisy"]\nreference = "some"\nsource = "none"\n\n'
        '[[tables.rows]]\nlabel = "some"\nswitches = { noisy = "a little" }\n\n'
        '[[tables.rows]]\nlabel = "more"\nswitches = { noisy = "much" }\nset = { noise = 0.8 }\n'
    )
    where = ("--data", tmp_path / "data", "--results", tmp_path / "results", "--out", tmp_path / "ablation")
    words = dofbench("ablate", "--tables", tables, "--seeds", 1, *where, *command(1)[-4:])
    done = called(words)
    assert done.returncode == 0, done.stdout + done.stderr
    assert statuses(tmp_path) == ["ok"] * 2 and (tmp_path / "ablation" / "noise.md").is_file()


@pytest.mark.parametrize(
    ("parameters", "named"), [("cpus=3", "cpus"), ("nonsense", "name=value"), ("partition=no_such", "sbatch")]
)
def test_a_wrong_parameter_is_one_line(command, parameters: str, named: str) -> None:
    done = called([*command(2)[:-1], parameters])
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("dofbench: ")]
    assert done.returncode == 2 and named in line and "Traceback" not in done.stderr, done.stderr
