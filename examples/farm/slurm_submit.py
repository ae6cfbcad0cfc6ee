# SPDX-License-Identifier: GPL-3.0-or-later
"""Submit an Open Job Description to Slurm: each step is an array job, each of its tasks an element. In a Python with
openjd-cli:

    python slurm_submit.py dynamorph.openjd.yaml -p 'Shots=["walk","run"]' -p Folder=/show/shots -- --partition=farm

Arguments after -- go to sbatch. Prints a line for each step: its name and Slurm's id of its job. A step waits until all
tasks before it have succeeded; only the last step runs even if they failed, and can report that. Tasks and logs go into
a folder which, like everything that parameters name, must exist on every node. docs/farm.md
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

import yaml
from openjd.model import (
    DecodeValidationError,
    Job,
    StepParameterSpaceIterator,
    create_job,
    decode_job_template,
    preprocess_job_parameters,
)

EXTENSIONS = ["EXPR"]  # of the specification, which `openjd run` also knows
TASK = Path(__file__).with_name("slurm_task.sh")


def read_job(path: Path, parameters: dict[str, str]) -> Job:
    """The job that a template makes of these parameters. Raises DecodeValidationError, ValueError."""
    template = yaml.safe_load(path.read_text(encoding="utf-8"))
    template = decode_job_template(template=template, supported_extensions=EXTENSIONS)
    values = preprocess_job_parameters(
        job_template=template, job_parameter_values=parameters,
        job_template_dir=path.parent, current_working_dir=Path.cwd(),
    )  # fmt: skip
    return create_job(job_template=template, job_parameter_values=values)


def write_tasks(step, folder: Path) -> int:
    """What `openjd run --tasks` reads, a file for each task: 0.json and so on; returns how many there are."""
    folder.mkdir(parents=True)
    tasks = StepParameterSpaceIterator(space=step.parameterSpace) if step.parameterSpace else [{}]
    for index, task in enumerate(tasks):
        values = {name: value.value for name, value in task.items()}
        (folder / f"{index}.json").write_text(json.dumps([values]))
    return len(tasks)


def submit(step, run: list[str | Path], folder: Path, depend: list[str], options: list[str]) -> str:
    """Submit a step whose tasks `run` runs; returns Slurm's id. depend: sbatch's options that say what it waits for."""
    count = write_tasks(step, folder)
    command = [
        "sbatch", "--parsable", f"--job-name={step.name}", f"--array=0-{count - 1}", "--requeue",
        f"--output={folder}/%a.slurm", "--open-mode=append", *depend, *options,
        TASK, folder, *run, "--step", step.name,
    ]  # fmt: skip
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout.strip().partition(";")[0]


def wait_for(ids: list[str], is_last: bool) -> list[str]:
    """sbatch's options for a step that waits for these jobs."""
    if not ids:
        return []
    if is_last:
        return [f"--dependency=afterany:{':'.join(ids)}"]
    return [f"--dependency=afterok:{':'.join(ids)}", "--kill-on-invalid-dep=yes"]


def cancel(ids: dict[str, str]) -> str:
    """Cancel the jobs of these steps; returns a sentence about the outcome."""
    if not ids:
        return ""
    done = subprocess.run(["scancel", *ids.values()], check=False)
    names = ", ".join(f"{name} {job}" for name, job in ids.items())
    return f"canceled: {names}\n" if done.returncode == 0 else f"not canceled, do so by scancel: {names}\n"


def name_and_value(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals:
        raise argparse.ArgumentTypeError(f"'{text}' is not NAME=VALUE")
    return name, value


def main() -> int:
    words = sys.argv[1:]
    end = words.index("--") if "--" in words else len(words)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("template", type=Path)
    parser.add_argument("-p", type=name_and_value, action="append", default=[], metavar="NAME=VALUE", dest="parameters")
    parser.add_argument(
        "--folder", type=Path, default=Path("slurm"), help="new, for tasks and logs; default: %(default)s"
    )
    args = parser.parse_args(words[:end])
    parameters, folder = dict(args.parameters), args.folder.resolve()
    if folder.exists():
        parser.error(f"'{args.folder}' is there already: remove it, or name another --folder")
    try:
        job = read_job(args.template, parameters)
    except (OSError, ValueError, DecodeValidationError) as error:
        parser.error(f"{args.template}: {error}")
    folder.mkdir(parents=True)
    (folder / "parameters.json").write_text(json.dumps(parameters))
    openjd = Path(sys.executable).with_name("openjd")
    run = [openjd, "run", args.template.resolve(), "-p", f"file://{folder}/parameters.json"]
    ids: dict[str, str] = {}
    for step in job.steps:  # a step follows those that it depends on
        after = [ids[dependency.dependsOn] for dependency in step.dependencies or ()]
        depend = wait_for(after, is_last=step is job.steps[-1])
        try:
            ids[step.name] = submit(step, run, folder / step.name, depend, options=words[end + 1 :])
        except (OSError, subprocess.CalledProcessError) as error:  # sbatch has said why, if it was there
            parser.exit(1, f"{step.name} was not submitted: {error}\n{cancel(ids)}")
        print(step.name, ids[step.name], flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
