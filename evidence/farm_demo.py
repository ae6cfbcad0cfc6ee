# SPDX-License-Identifier: GPL-3.0-or-later
"""Bakes three shots of two characters in two variants on a small render farm, and breaks it: `make farm-demo`.

The farm is Slurm with two nodes on this machine, each a slurmd with processes and a core of its own. The job is
examples/farm/dynamorph.openjd.yaml, submitted by examples/farm/slurm_submit.py. It runs on one node, on two, and on two
where one fails: a bake on it is killed, and then the node itself. The bakes must come out the same, to the last bit.

A machine that cannot run a farm (not root, not Debian) says why, and counts as success; a failure on the farm does
not. Figures: build/farm/farm.json, and, if the machine has no other work, the table in docs/farm.md.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import statistics
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from project import ROOT

from measured import measured_at, write_between

WORK = ROOT / "build/farm"
OPENJD = ROOT / "build/openjd/bin"
TEMPLATE = ROOT / "examples/farm/dynamorph.openjd.yaml"
PAGE = ROOT / "docs/farm.md"
BEGIN, END = "<!-- measured -->", "<!-- end of measured -->"  # in the page
PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "scontrol", "squeue", "unshare", "setpriv", "taskset")
SHOTS, CHARACTERS = ["walk", "run", "wave"], ["Arm", "Leg"]  # of examples/farm/make_shots.py
WEDGES = ["", "Neutral.stiffness=4e4"]
NO_TARGET = "Nobody.stiffness=1e4"  # a wedge that is bad input
# Between these lines of its log a bake has done one to two thirds of its frames, when the model is there already.
MID_BAKE, LATE = "openjd_progress: 80", "openjd_progress: 90"
LONGEST = 900  # seconds that a run may take
QUIET = 0.85  # bakes of all runs are about as fast as each other, unless the machine has other work


class CannotRun(Exception):
    """Why there is no farm."""


class Failed(Exception):
    """What went wrong on it."""


# The farm ------------------------------------------------------------------------------------------------------------

# A lost node is noticed within seconds, and its tasks start again at once (cred_expire): a real farm is more patient.
CONFIGURATION = """
ClusterName=dynamorph
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={port}
SlurmUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket,cred_expire=5
MpiDefault=none
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SchedulerParameters=batch_sched_delay=0,sched_interval=1,bf_interval=1
SlurmctldPidFile={folder}/slurmctld.pid
StateSaveLocation={folder}/state
SlurmdPidFile={folder}/%n.pid
SlurmdSpoolDir={folder}/%n
SlurmdParameters=config_overrides
SlurmdTimeout=10
ReturnToService=2
PartitionName=farm Nodes=ALL Default=YES MaxTime=INFINITE
"""
NODE = "NodeName={name} NodeHostname={host} NodeAddr=127.0.0.1 Port={port} CPUs=1 State=UNKNOWN\n"


@dataclass
class Bake:
    """A bake that runs: its process, its place in the array, and how often it was begun before."""

    pid: int
    task: int
    restarts: int


class Farm:
    """Slurm on this machine, while the context lasts. Whatever ends this process ends the whole farm."""

    def __init__(self, folder: Path, nodes: int):
        self.folder = folder
        self.configuration = folder / "slurm.conf"
        self.nodes = [f"node{i + 1}" for i in range(nodes)]
        self.processes: dict[str, subprocess.Popen] = {}  # by the name of the node or daemon
        self.environment = os.environ | {
            "SLURM_CONF": str(self.configuration),
            "TMPDIR": str(WORK / "tmp"),  # what is killed leaves things there
            "BLENDER_USER_RESOURCES": str(WORK / "user"),
        }

    def __enter__(self) -> Farm:
        try:
            self._start()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_):
        for process in self.processes.values():
            process.kill()
        for process in self.processes.values():
            process.wait()

    def _start(self):
        self.folder.mkdir(parents=True)
        host, ports = socket.gethostname().partition(".")[0], free_ports(1 + len(self.nodes))
        text = CONFIGURATION.format(host=host, port=ports[0], folder=self.folder)
        for name, port in zip(self.nodes, ports[1:], strict=True):
            text += NODE.format(name=name, host=host, port=port)
        self.configuration.write_text(text)
        key = self.folder / "munge.key"
        key.touch(mode=0o600)
        key.write_bytes(os.urandom(128))
        self._daemon(
            "munged", "munged", "--foreground", "--force", "--key-file", key, "--socket", self.folder / "munge.socket",
            "--pid-file", self.folder / "munge.pid", "--seed-file", self.folder / "munge.seed",
            "--log-file", self.folder / "munge.log",
        )  # fmt: skip
        self._daemon("slurmctld", "slurmctld", "-D")
        cores = sorted(os.sched_getaffinity(0))
        for i, name in enumerate(self.nodes):
            # Process 1 of a namespace: when it is killed, everything that the node runs is killed at once.
            alone = ["unshare", "--pid", "--fork", "--kill-child", "--mount-proc"]
            run = ["bash", "-c", 'slurmd -D -N "$0" & wait $!', name]  # a shell, which collects orphans that end
            self._daemon(name, *alone, "taskset", "-c", str(cores[i % len(cores)]), *run)
        idle = "idle\n" * len(self.nodes)
        self._wait("all nodes are idle", lambda: self.ask("sinfo", "-hN", "-o", "%t") == idle, seconds=60)

    def _daemon(self, name: str, *command: str | Path):
        with (self.folder / f"{name}.out").open("w") as log:
            self.processes[name] = subprocess.Popen(
                ["setpriv", "--pdeathsig", "KILL", *command], env=self.environment,
                stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, start_new_session=True,
            )  # fmt: skip

    def ask(self, *command: str) -> str | None:
        """What one of Slurm's programs prints; None when it fails."""
        run = subprocess.run(command, env=self.environment, capture_output=True, text=True, check=False)
        return run.stdout if run.returncode == 0 else None

    def _wait(self, what: str, happened, seconds: float = LONGEST):
        """Wait until happened() returns something, and return that. Raises Failed."""
        end = time.monotonic() + seconds
        while not (found := happened()):
            for name, process in self.processes.items():
                if process.poll() not in (None, -signal.SIGKILL):
                    raise Failed(f"{name} ended with {process.returncode}\n{tail(self.folder / f'{name}.out')}")
            if time.monotonic() > end:
                raise Failed(f"waited in vain until {what}: see {self.folder}\n{self.ask('squeue', '-r')}")
            time.sleep(0.2)
        return found

    def submit(self, parameters: dict, folder: Path) -> list[str]:
        """Submit the template; returns the names of its steps. folder: for their tasks and logs."""
        command = [OPENJD / "python", ROOT / "examples/farm/slurm_submit.py", TEMPLATE, "--folder", folder]
        for name, value in parameters.items():
            command += ["-p", f"{name}={value if isinstance(value, str) else json.dumps(value)}"]
        run = subprocess.run(command, env=self.environment, capture_output=True, text=True, check=False)
        if run.returncode:
            raise Failed(f"the job was not submitted\n{run.stderr}")
        return [line.split()[0] for line in run.stdout.splitlines()]

    def finish(self):
        """Wait until all jobs are over."""
        self._wait("the jobs are done", lambda: self.ask("squeue", "-hr") == "")

    def bakes(self, node: str) -> list[Bake]:
        """The bakes that run on a node."""
        found = []
        for process in Path("/proc").glob("[0-9]*"):
            try:
                words = (process / "cmdline").read_text().split("\0")
                variables = (process / "environ").read_text().split("\0")
            except OSError:  # it has ended, or is not ours
                continue
            of = dict(variable.split("=", 1) for variable in variables if "=" in variable)
            mine = of.get("SLURM_CONF") == str(self.configuration) and of.get("SLURMD_NODENAME") == node
            if mine and words[1:4] == ["-m", "dynamic_morph_targets", "bake"]:
                task = int(of["SLURM_ARRAY_TASK_ID"])
                found.append(Bake(int(process.name), task, int(of.get("SLURM_RESTART_COUNT", 0))))
        return found

    def mid_bake(self, node: str, folder: Path) -> Bake:
        """Wait for a bake on this node that runs for the first time and is half done."""

        def found():
            for bake in self.bakes(node):
                log = (folder / f"Bake/{bake.task}.{bake.restarts}.log").read_text()
                if not bake.restarts and MID_BAKE in log and LATE not in log:
                    return bake
            return None

        return self._wait(f"a bake on {node} is in its middle", found)

    def kill(self, bake: Bake, node: str):
        """End a bake on this node with kill -9."""
        os.kill(bake.pid, signal.SIGKILL)
        self._wait("a killed bake has ended", lambda: bake not in self.bakes(node), seconds=10)

    def power_off(self, node: str):
        """End a node and all that it runs with kill -9."""
        self.processes[node].kill()
        self.processes[node].wait()
        self._wait(f"nothing runs on {node}", lambda: not self.bakes(node), seconds=10)


def free_ports(count: int) -> list[int]:
    """Free ports of this machine."""
    sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [each.getsockname()[1] for each in sockets]
    for each in sockets:
        each.close()
    return ports


# The runs ------------------------------------------------------------------------------------------------------------


def run_job(name: str, nodes: int, faults=False) -> dict:
    """Bake everything on so many nodes, with faults among them; returns the measurements. Raises Failed."""
    folder = folder_of(name)
    output, caches, tasks = folder / "output", folder / "cache", folder / "tasks"
    output.mkdir(parents=True)
    parameters = {
        "Name": name, "Folder": str(WORK / "shots"), "Output": str(output), "CacheDir": str(caches),
        "Python": sys.executable, "Shots": SHOTS, "Characters": CHARACTERS, "Wedges": WEDGES,
    }  # fmt: skip
    with Farm(folder / "slurm", nodes) as farm:
        began = time.monotonic()
        steps = farm.submit(parameters, tasks)
        hit = inject_faults(farm, tasks) if faults else {}
        farm.finish()
        seconds = time.monotonic() - began
        bad_input_tries = try_bad_input(farm, parameters, folder / "bad_input") if faults else None
    if not (output / "index.json").exists():
        raise Failed(f"run '{name}' was not finished: see the logs in {tasks}")
    collected = json.loads((output / "index.json").read_text())
    if collected["wrong"]:
        raise Failed(f"run '{name}': {'; '.join(collected['wrong'])}")
    bakes = {each: report["characters"][0]["bake"] for each, report in collected["reports"].items()}
    found = {
        "name": name,
        "nodes": nodes,
        "seconds": round(seconds, 1),
        "tasks": {step: len(list((tasks / step).glob("*.0.log"))) for step in steps},
        "models": models_built_once(caches, tasks),
        "frames": max(bake["frames"][1] for bake in bakes.values()),
        "hashes": {each: bake["hash"] for each, bake in bakes.items()},
        "steps_per_second": round(statistics.median(bake["steps_per_second"] for bake in bakes.values())),
        "faults": {fault: what_came_of(bake, bakes, tasks) for fault, bake in hit.items()},
        "blender": next(iter(collected["reports"].values()))["versions"]["blender"],
    }
    return found | ({"bad_input_tries": bad_input_tries} if faults else {})


def folder_of(run: str) -> Path:
    return WORK / run.replace(" ", "_")  # Slurm's configuration allows no spaces


def inject_faults(farm: Farm, tasks: Path) -> dict[str, Bake]:
    """Kill a bake, then its node in the middle of another, so that both must resume elsewhere; returns the two."""
    killed = farm.mid_bake("node2", tasks)
    farm.kill(killed, "node2")
    lost = farm.mid_bake("node2", tasks)
    farm.power_off("node2")
    return {"bake killed": killed, "node killed": lost}


def what_came_of(bake: Bake, bakes: dict[str, dict], tasks: Path) -> dict:
    """What a bake that was killed went through. nodes: where it was tried, in order, as examples/farm/slurm_task.sh
    recorded."""
    name = bake_name(tasks, bake)
    logs = sorted((tasks / "Bake").glob(f"{bake.task}.*.log"))  # of less than ten tries
    nodes = [log.read_text().partition("\n")[0].removeprefix("on ") for log in logs]
    return {"bake": name, "nodes": nodes, "resumed": bakes[name]["resumed"]}


def bake_name(tasks: Path, bake: Bake) -> str:
    """The path of its report, as the template names it."""
    (values,) = json.loads((tasks / f"Bake/{bake.task}.json").read_text())
    return " ".join(filter(None, values.values()))


def models_built_once(caches: Path, tasks: Path) -> int:
    """How many models there are that no task wrote after the step that builds them."""
    built = max(path.stat().st_mtime for path in tasks.glob("Build/*.log"))
    return sum(path.stat().st_mtime <= built for path in caches.glob("*.dynamorph"))


def try_bad_input(farm: Farm, parameters: dict, folder: Path) -> int:
    """Submit a bake that cannot succeed; returns how often it was tried, and found to be so. Raises Failed."""
    (folder / "output").mkdir(parents=True)
    wrong = {"Output": str(folder / "output"), "Shots": SHOTS[:1], "Characters": CHARACTERS[:1], "Wedges": [NO_TARGET]}
    farm.submit(parameters | wrong, folder / "tasks")
    farm.finish()
    page = folder / "output/index.json"
    if not page.exists() or NO_TARGET not in "".join(json.loads(page.read_text())["wrong"]):
        raise Failed(f"no page reports the bake that failed: see {folder}")
    return sum("exited with code: 2 " in log.read_text() for log in folder.glob("tasks/Bake/*.log"))


# Outcome ------------------------------------------------------------------------------------------------------------


def judge(runs: list[dict]) -> dict:
    """All that was measured, and what follows from it."""
    first = runs[0]
    for run in runs:
        run["speed_up"] = round(first["seconds"] / run["seconds"], 2)
        run["hashes_equal"] = run["hashes"] == first["hashes"]
        for fault in run["faults"].values():
            same = run["hashes"][fault["bake"]] == first["hashes"][fault["bake"]]
            fault["survived"] = same and 0 < fault["resumed"] < run["frames"]
    speeds = [run["steps_per_second"] for run in runs]
    return {
        "quiet": min(speeds) > QUIET * max(speeds),
        "commit": measured_at(PAGE.name),
        "versions": {
            "Slurm": run_here("slurmd", "-V").split()[-1],
            "openjd-cli": run_here(OPENJD / "openjd", "--version").split()[-1],
            "Blender": first["blender"],
        },
        "runs": runs,
    }


def shortcomings(runs: list[dict]) -> list[str]:
    """The sentences about what is not as it should be."""
    found = []
    for run in runs:
        if not run["hashes_equal"]:
            found.append(f"{run['name']}: other hashes")
        if run["models"] != len(CHARACTERS):
            found.append(f"{run['name']}: {run['models']} models were built once, of {len(CHARACTERS)}")
        found += [
            f"{run['name']}: {name}: started over" for name, each in run["faults"].items() if not each["survived"]
        ]
        if run.get("bad_input_tries", 1) != 1:
            found.append(f"{run['name']}: bad input was tried {run['bad_input_tries']} times")
    return found


def table(runs: list[dict]) -> list[list[str]]:
    """Rows of cells, the first with titles."""
    rows = [
        ["run", "nodes", "tasks", "wall time", "speed-up", "steps/s of a bake", "faults", "survived", "hashes equal"]
    ]
    for run in runs:
        faults = run["faults"]
        texts = [
            f"{name}: begun on {each['nodes'][0]}, resumed on {each['nodes'][-1]} after {each['resumed']} of "
            f"{run['frames']} frames"
            for name, each in faults.items()
        ]
        rows.append([
            run["name"], str(run["nodes"]), str(sum(run["tasks"].values())), f"{run['seconds']:.0f} s",
            f"{run['speed_up']:.2f}", str(run["steps_per_second"]), "; ".join(texts) or "none",
            f"{sum(each['survived'] for each in faults.values())} of {len(faults)}" if faults else "",
            "yes" if run["hashes_equal"] else "no",
        ])  # fmt: skip
    return rows


def print_table(rows: list[list[str]]):
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


def write_page(rows: list[list[str]], found: dict):
    """Write the table into docs/farm.md. Raises ValueError without its marks."""
    lines = [f"| {' | '.join(row)} |" for row in (rows[0], ["---"] * len(rows[0]), *rows[1:])]
    tasks = ", ".join(f"{count} {step}" for step, count in found["runs"][0]["tasks"].items())
    programs = ", ".join(f"{name} {version}" for name, version in found["versions"].items())
    lines += ["", f"Tasks of a run: {tasks}. With {programs}.", f"{found['commit']}."]
    write_between(PAGE, BEGIN, END, "\n".join(lines))


def tail(path: Path, lines=20) -> str:
    return "\n".join(path.read_text(errors="replace").splitlines()[-lines:])


def set_up():
    """A clean folder with the shots in it. Raises CannotRun, Failed."""
    missing = [program for program in PROGRAMS if not shutil.which(program)]
    missing += [str(OPENJD / "openjd")] * (not (OPENJD / "openjd").exists())
    if missing:
        raise CannotRun(f"missing: {', '.join(missing)}; tools/setup.sh farm installs them, as root on Debian")
    if os.geteuid() != 0:
        raise CannotRun("Slurm's daemons and their nodes need root")
    if subprocess.run(
        ["unshare", "--pid", "--fork", "--mount-proc", "true"], capture_output=True, check=False
    ).returncode:
        raise CannotRun("this process may not create namespaces (unshare)")
    shutil.rmtree(WORK, ignore_errors=True)
    for folder in ("tmp", "user"):
        (WORK / folder).mkdir(parents=True)
    run_here(sys.executable, ROOT / "examples/farm/make_shots.py", WORK / "shots")


def run_here(*command: str | Path) -> str:
    """What a program prints. Raises Failed."""
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    if run.returncode:
        raise Failed(f"{' '.join(map(str, command))}\n{run.stderr}")
    return run.stdout


def main() -> int:
    try:
        set_up()
        runs = []
        for name, nodes, faults in (("one node", 1, False), ("two nodes", 2, False), ("two nodes hit", 2, True)):
            runs.append(run_job(name, nodes, faults))
            print(f"farm-demo: {name}: {runs[-1]['seconds']:.0f} s", flush=True)
        found = judge(runs)
        (WORK / "farm.json").write_text(json.dumps(found, indent=1) + "\n")
        rows = table(runs)
        print_table(rows)
        if wrong := shortcomings(runs):
            raise Failed("; ".join(wrong))
        if found["quiet"]:
            write_page(rows, found)
        else:
            print(f"farm-demo: the machine had other work, so the times say little: {PAGE.name} is left as it was")
    except CannotRun as reason:
        print(f"farm-demo: SKIPPED, {reason}")
        return 0
    except Failed as problem:
        print(f"farm-demo: FAILED, {problem}")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
