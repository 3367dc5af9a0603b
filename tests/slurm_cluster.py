"""A real Slurm on this machine alone: a controller and one node with some slots, on loopback, as the user who calls.

By itself, to try commands on it: python tests/slurm_cluster.py FOLDER, which ends with Ctrl-C.
"""

from __future__ import annotations

import getpass
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PROGRAMS = ("slurmctld", "slurmd", "sbatch", "squeue", "srun", "scontrol")
_PATIENCE = 60.0  # s until the node is there
_CONFIG = """\
ClusterName=trial
SlurmctldHost={node}(127.0.0.1)
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/none
CredType=cred/none
SlurmctldPort={port}
SlurmdPort={node_port}
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SlurmdParameters=config_overrides
SchedulerParameters=sched_interval=2,batch_sched_delay=1
AccountingStorageType=accounting_storage/none
JobAcctGatherType=jobacct_gather/none
JobCompType=jobcomp/none
MpiDefault=none
ReturnToService=2
JobRequeue=1
KillWait=5
MinJobAge=10
SlurmdTimeout=20
NodeName={node} NodeAddr=127.0.0.1 CPUs={slots} RealMemory=60000 State=UNKNOWN
PartitionName=main Nodes={node} Default=YES MaxTime=INFINITE State=UP
"""


def absent() -> str:
    """Why there can be no cluster here; "" where there can."""
    missing = [name for name in PROGRAMS if shutil.which(name) is None]
    return f"no {missing[0]}: apt-get install slurmctld slurmd slurm-client" if missing else ""


class Cluster:
    """Starts and stops the daemons; `environment` is what clients need to find them."""

    def __init__(self, folder: Path, slots: int = 3):
        self.folder, self._node = folder, socket.gethostname().partition(".")[0]
        for name in ("state", "spool"):
            (folder / name).mkdir(parents=True, exist_ok=True)
        self._config = folder / "slurm.conf"
        self._config.write_text(
            _CONFIG.format(
                node=self._node, user=getpass.getuser(), folder=folder, slots=slots, port=_free(), node_port=_free()
            )
        )
        self.environment = {"SLURM_CONF": str(self._config)}
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, name: str, *words: str) -> None:
        """Start a daemon in the foreground, below this process."""
        with (self.folder / f"{name}.log").open("ab") as log:
            self._running[name] = subprocess.Popen(
                [name, "-D", *words], stdout=log, stderr=log, env={**os.environ, **self.environment}
            )

    def start_node(self) -> None:
        """Start the node's daemon."""
        self.start("slurmd", "-N", self._node)

    def kill(self, name: str, number: signal.Signals = signal.SIGKILL) -> None:
        """End a daemon; its jobs go on."""
        process = self._running.pop(name)
        process.send_signal(number)
        process.wait()

    def command(self, *words: str) -> str:
        """What one of Slurm's commands says."""
        done = subprocess.run(
            words, capture_output=True, text=True, env={**os.environ, **self.environment}, check=False
        )
        return done.stdout + done.stderr

    def jobs(self) -> dict[str, str]:
        """Number of each job that isn't over -> its state."""
        return dict(line.split() for line in self.command("squeue", "-h", "-r", "-o", "%i %T").splitlines() if line)

    def wait_for_node(self) -> None:
        """Until the node takes jobs. Raises RuntimeError with the daemons' last words."""
        limit = time.monotonic() + _PATIENCE
        while "idle" not in self.command("sinfo", "-h", "-o", "%t"):
            if time.monotonic() > limit:
                logs = (self.folder / f"{name}.log" for name in ("slurmctld", "slurmd"))
                raise RuntimeError("\n".join(log.read_text()[-2000:] for log in logs if log.is_file()))
            time.sleep(0.5)

    def stop(self) -> None:
        """End the jobs and the daemons."""
        self.command("scancel", "--user", getpass.getuser())
        limit = time.monotonic() + 15
        while self.jobs() and time.monotonic() < limit:
            time.sleep(0.5)
        for name in list(self._running):
            self.kill(name, signal.SIGTERM if name == "slurmctld" else signal.SIGKILL)


@contextmanager
def cluster(folder: Path, slots: int = 3) -> Iterator[Cluster]:
    """A cluster with its node, during the block."""
    found = Cluster(folder, slots)
    try:
        found.start("slurmctld")
        found.start_node()
        found.wait_for_node()
        yield found
    finally:
        found.stop()


def _free() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


if __name__ == "__main__":
    with cluster(Path(sys.argv[1]).resolve()) as here:
        print(f"export SLURM_CONF={here.environment['SLURM_CONF']}", flush=True)
        signal.pause()
