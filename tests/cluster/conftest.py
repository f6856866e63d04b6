"""A Slurm of this machine alone, and the sweep by one process that all engines are compared with."""

from __future__ import annotations

import getpass
import os
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from engines import SWEEP, Place, free_ports, place, until


@pytest.fixture(scope="session")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Place:
    """The sweep by one process."""
    place_of_one = place(tmp_path_factory.mktemp("alone"))
    place_of_one(sys.executable, "-m", "pipeline", "-m", *SWEEP)
    return place_of_one


@pytest.fixture(scope="session")
def slurm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The slurm.conf of a controller and a node of four cores, whatever this machine has."""
    programs = ["munged", "slurmctld", "slurmd"]
    if missing := [name for name in programs if not shutil.which(name, path=os.environ["PATH"] + ":/usr/sbin")]:
        pytest.skip(f"{', '.join(missing)} not found: apt-get install slurm-wlm munge")
    folder, user, host = Path(tmp_path_factory.mktemp("slurm")), getpass.getuser(), socket.gethostname().split(".")[0]
    for path in (folder, *folder.parents[:2]):
        path.chmod(0o755)  # munged refuses a socket that others cannot reach
    (folder / "key").write_bytes(os.urandom(1024))
    (folder / "key").chmod(0o600)
    for name in ("state", "spool"):
        (folder / name).mkdir()
    controller, node = free_ports(2)
    # Slurm starts a requeued job when the credentials of the last one have expired, and looks for such every minute.
    (folder / "slurm.conf").write_text(f"""
ClusterName=test
SlurmctldHost={host}(127.0.0.1)
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/munge
AuthInfo=socket={folder}/socket,cred_expire=5
CredType=cred/munge
SlurmctldPort={controller}
SlurmdPort={node}
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SchedulerParameters=sched_interval=2
SlurmdParameters=config_overrides
ReturnToService=2
KillWait=5
NodeName={host} NodeAddr=127.0.0.1 CPUs=4 RealMemory=8000
PartitionName=all Nodes={host} Default=YES State=UP
""")
    environment = {**os.environ, "SLURM_CONF": str(folder / "slurm.conf"), "PATH": os.environ["PATH"] + ":/usr/sbin"}
    munge = ["--key-file", "--socket", "--pid-file", "--log-file", "--seed-file"]
    names = ["key", "socket", "munged.pid", "munged.log", "munged.seed"]
    arguments = [f"{option}={folder / name}" for option, name in zip(munge, names)]
    commands = (["munged", "--force", "--foreground", *arguments], ["slurmctld", "-D"], ["slurmd", "-D"])
    with open(folder / "servers.log", "ab") as log:
        servers = [subprocess.Popen(command, env=environment, stdout=log, stderr=log) for command in commands]

    def idle() -> bool:
        found = subprocess.run(["sinfo", "-h", "-o", "%T"], env=environment, capture_output=True, text=True)
        return found.stdout.strip() == "idle"

    try:
        until(idle, (folder / "servers.log").read_text)
        yield folder / "slurm.conf"
    finally:
        subprocess.run(["scancel", f"--user={user}"], env=environment)
        for server in reversed(servers):
            server.terminate()
            server.wait(30)
