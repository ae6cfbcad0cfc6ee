# SPDX-License-Identifier: GPL-3.0-or-later
"""What is in examples/farm/: the job template, how Slurm runs one of its tasks, the job type for Flamenco.

`make -C evidence farm-demo` runs the first two on a real Slurm. Here, stand-ins for the schedulers record how they are
called."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest
from bl_ext.user_default.dynamic_morph_targets.cli import commands, main
from bl_ext.user_default.dynamic_morph_targets.write.export import exports

ROOT = Path(__file__).parents[3]
FARM = ROOT / "examples/farm"
OPENJD = ROOT / "build/openjd/bin"

FLAMENCO = """
const vm = require("vm"), fs = require("fs");
const tasks = [];
const author = {
    Task: (name, type) => ({
        name, type, commands: [], after: [],
        addCommand(command) { this.commands.push(command); },
        addDependency(task) { this.after.push(task.name); },
    }),
    Command: (name, parameters) => ({ name, parameters }),
};
const context = vm.createContext({ author, formatTimestampLocal: (date) => date });
vm.runInContext(fs.readFileSync(process.argv[1], "utf8"), context);
const settings = JSON.parse(process.argv[2]);
for (const setting of vm.runInContext("JOB_TYPE", context).settings)
    if (settings[setting.key] === undefined) settings[setting.key] = setting.default;
context.compileJob({ settings, created: "now", addTask: (task) => tasks.push(task) });
console.log(JSON.stringify(tasks));
"""


def program(folder, name, script):
    """A shell script that replaces a program."""
    path = folder / name
    path.write_text(f"#!/bin/bash\n{script}\n")
    path.chmod(0o755)
    return path


def understood(arguments, opens_file):
    """The command line knows these arguments, or argparse exits."""
    return main.parser(opens_file).parse_args(arguments)


# Slurm ----------------------------------------------------------------------------------------------------------------


@pytest.fixture
def try_task(tmp_path):
    """Runs slurm_task.sh with a task that ends with a code; returns its own code and how scontrol was called."""
    (tmp_path / "Bake").mkdir()
    program(tmp_path, "openjd", 'echo "Process pid 1 exited with code: $1 (unsigned)"; echo "$@"; exit $(($1 != 0))')
    program(tmp_path, "scontrol", f'echo "$@" >>"{tmp_path}/asked"')

    def run(code, restarts=""):
        (tmp_path / "asked").write_text("")
        variables = {"PATH": f"{tmp_path}:{os.environ['PATH']}", "SLURM_ARRAY_TASK_ID": "3", "SLURM_JOB_ID": "17"}
        variables["SLURMD_NODENAME"] = "node7"
        variables |= {"SLURM_RESTART_COUNT": restarts} if restarts else {}
        done = subprocess.run(
            [FARM / "slurm_task.sh", tmp_path / "Bake", "openjd", str(code)], env=variables, check=False
        )
        return done.returncode, (tmp_path / "asked").read_text()

    return run


def test_a_task_that_is_done_is_done(try_task, tmp_path):
    assert try_task(0) == (0, "")
    log = (tmp_path / "Bake/3.0.log").read_text()
    assert log.startswith("on node7\n") and f"--tasks file://{tmp_path}/Bake/3.json" in log


@pytest.mark.fault("B02")
@pytest.mark.parametrize("code", [2, 3])
def test_a_task_that_would_fail_again_fails(try_task, code):
    assert try_task(code) == (code, "")


@pytest.mark.fault("B03")
@pytest.mark.parametrize("code", [1, 75, 130, -9])
def test_other_tasks_are_tried_again(try_task, code, tmp_path):
    assert try_task(code) == (75, "requeue 17\n")
    assert try_task(code, restarts="1") == (75, "requeue 17\n")
    assert {path.name for path in (tmp_path / "Bake").iterdir()} == {"3.0.log", "3.1.log"}


def test_but_not_for_ever(try_task):
    assert try_task(75, restarts="4") == (75, "")


# Open Job Description -------------------------------------------------------------------------------------------------

COUNTS = 'echo "$@" >>"$0.asked"; wc -l <"$0.asked"'  # stands in for sbatch: records its arguments and counts the calls

needs_openjd = pytest.mark.skipif(not OPENJD.exists(), reason="openjd-cli is not installed: tools/setup.sh openjd")


def submit(folder, *options):
    """Submit six bakes to the sbatch in a folder."""
    shots, wedges = 'Shots=["walk","run"]', 'Wedges=["","Neutral.stiffness=3e4","Neutral.poisson=0.3"]'
    return subprocess.run(
        [OPENJD / "python", FARM / "slurm_submit.py", FARM / "dynamorph.openjd.yaml", "--folder", folder / "slurm",
         "-p", shots, "-p", wedges, "-p", f"Folder={folder}", *options],
        env=os.environ | {"PATH": f"{folder}:{os.environ['PATH']}"}, capture_output=True, text=True, check=False,
    )  # fmt: skip


@needs_openjd
def test_the_template_keeps_to_the_specification():
    checked = subprocess.run(
        [OPENJD / "openjd", "check", FARM / "dynamorph.openjd.yaml"], capture_output=True, check=False
    )
    assert checked.returncode == 0, checked.stderr.decode()


@needs_openjd
def test_each_step_is_an_array_that_waits_for_the_one_before(tmp_path):
    program(tmp_path, "sbatch", COUNTS)
    submitted = submit(tmp_path, "--", "--partition=farm")
    assert submitted.returncode == 0, submitted.stderr
    assert submitted.stdout.split() == ["Check", "1", "Build", "2", "Bake", "3", "Collect", "4"]
    asked = (tmp_path / "sbatch.asked").read_text().splitlines()
    assert [line.split("--array=")[1].split()[0] for line in asked] == ["0-1", "0-0", "0-5", "0-0"]
    assert "--dependency" not in asked[0]
    assert all(f"--output={tmp_path}/slurm/" in line and "--partition=farm" in line for line in asked)
    assert all(f"--dependency=afterok:{i} --kill-on-invalid-dep=yes " in asked[i] for i in (1, 2))
    assert "--dependency=afterany:3 " in asked[3] and "--kill" not in asked[3]  # its page reports failures
    tasks = [json.loads((tmp_path / f"slurm/Bake/{i}.json").read_text()) for i in range(6)]
    assert [[task["Shot"], task["Wedge"][:9]] for (task,) in tasks[:4]] == [
        ["walk", ""], ["walk", "Neutral.s"], ["walk", "Neutral.p"], ["run", ""],
    ]  # fmt: skip


@needs_openjd
def test_what_was_submitted_is_canceled_when_a_later_step_is_refused(tmp_path):
    program(tmp_path, "sbatch", f'[[ "$*" != *--array=0-5* ]] || exit 1; {COUNTS}')
    program(tmp_path, "scancel", 'echo "$@" >"$0.asked"')
    submitted = submit(tmp_path)
    assert submitted.returncode == 1
    assert "Bake was not submitted" in submitted.stderr and "canceled: Check 1, Build 2" in submitted.stderr
    assert (tmp_path / "scancel.asked").read_text() == "1 2\n"


@pytest.fixture
def run_template(tmp_path):
    """Runs all steps with a Python that only records its calls; returns the parsed command lines."""
    python = program(tmp_path, "python", f'printf "%s\\n" "$@" "" >>"{tmp_path}/called"')

    def run(**parameters):
        folders = {"Folder": str(tmp_path), "Output": str(tmp_path / "out"), "CacheDir": str(tmp_path)}
        (tmp_path / "called").unlink(missing_ok=True)
        subprocess.run(
            [OPENJD / "openjd", "run", FARM / "dynamorph.openjd.yaml", "--step", "Collect", "--run-dependencies",
             "-p", json.dumps({"Python": str(python), "Shots": ["walk"]} | folders | parameters)],
            stdout=subprocess.DEVNULL, check=True,
        )  # fmt: skip
        calls = [call.split("\n") for call in (tmp_path / "called").read_text().rstrip("\n").split("\n\n")]
        assert all(call[:2] == ["-m", "dynamic_morph_targets"] for call in calls)
        return [(call[2], understood(call[2:], opens_file=True)) for call in calls]

    return run


@needs_openjd
def test_the_template_says_what_the_command_line_knows(addon, run_template, tmp_path):
    calls = run_template(Characters=["Arm", "Left Leg"], Wedges=["", "Neutral.stiffness=3e4"])
    assert [command for command, _ in calls] == ["check"] * 2 + ["build"] * 2 + ["bake"] * 4 + ["collect"]
    found = [args for _, args in calls]
    assert all(args.object == [name] for args, name in zip(found[:4], ["Arm", "Left Leg"] * 2, strict=True))
    assert [args.changes for args in found[4:8]] == [[], ["Neutral.stiffness=3e4"]] * 2
    assert found[7].output == tmp_path / "out/walk Left Leg Neutral.stiffness=3e4.blend"
    reports = [args.report for args in found[:8]]
    assert len(set(reports)) == 8
    # The reports of bakes, and no others, are where the last step looks for them.
    assert found[8].expect == 4 and [report.parent == found[8].folder for report in reports] == [False] * 4 + [True] * 4


@needs_openjd
def test_no_name_is_all_characters_in_one_task(addon, run_template, tmp_path):
    calls = run_template(Characters=[""])
    assert [command for command, _ in calls] == ["check", "build", "bake", "collect"]
    assert all(args.all and args.object is None for _, args in calls[:3])
    assert calls[2][1].output == tmp_path / "out/walk.blend" and calls[3][1].expect == 1


@needs_openjd
def test_the_template_knows_every_format(addon, run_template, tmp_path):
    template = (FARM / "dynamorph.openjd.yaml").read_text()
    known = next(line for line in template.splitlines() if "allowedValues" in line)
    files = {format.lower(): of.suffix for format, of in exports.FORMATS.items()}
    files["pc2"] = ".pc2"
    formats = {kind.lower() for kind in commands.bake_formats()} | set(files)
    assert set(known.split("[")[1].split("]")[0].split(", ")) == formats | {'""'}
    for kind in formats:
        _, bake = run_template(Characters=["Arm"], Format=kind, Options=["--keys", "8"])[2]
        assert (bake.format, bake.keys) == (kind, 8)
        assert bake.output_file == (tmp_path / f"out/walk {{object}}{files[kind]}" if kind in files else None)


# Flamenco -------------------------------------------------------------------------------------------------------------


@pytest.fixture
def compiled():
    """Compiles the job type with settings, and with its defaults for the others; returns the tasks by name."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("needs node, to run the job type")

    def run(**settings):
        settings = {"blendfile": "/shots/walk.flamenco.blend", "output": "/out", "cache_dir": "/cache"} | settings
        done = subprocess.run(
            [node, "-e", FLAMENCO, FARM / "flamenco_dynamorph.js", json.dumps(settings)],
            capture_output=True, text=True, check=True,
        )  # fmt: skip
        return {task["name"]: task for task in json.loads(done.stdout)}

    return run


def flamenco_asks(task):
    """The parsed command line of a task."""
    arguments = task["commands"][0]["parameters"]["args"]
    return understood(arguments[arguments.index("dynamorph") + 1 :], opens_file=False)


def test_flamenco_bakes_each_character_and_wedge(compiled):
    tasks = compiled(characters="Arm, Leg", wedges="Neutral.stiffness=1e4, Neutral.stiffness=3e4")
    bakes = [name for name in tasks if name.startswith("bake ")]
    assert len(bakes) == 4 and "bake walk Leg Neutral.stiffness=3e4" in bakes
    assert all(tasks[name]["after"] == [f"build {name.split()[2]}"] for name in bakes)
    assert tasks["build Arm"]["after"] == ["check Arm"]
    assert tasks["collect"]["after"] == bakes
    assert {task["type"] for task in tasks.values()} == {"blender"}


def test_flamenco_names_no_file_elsewhere(addon, compiled):
    """By the name of an object, as a stranger's .blend may have it."""
    tasks = compiled(characters="a/../../../etc/x")
    (bake,) = (task for name, task in tasks.items() if name.startswith("bake "))
    asked = flamenco_asks(bake)
    assert asked.object == ["a/../../../etc/x"]
    assert asked.report.name == asked.output.stem + ".json" == "walk a_.._.._.._etc_x.json"


def test_flamenco_says_what_the_command_line_knows(addon, compiled):
    tasks = compiled(characters="Arm")
    assert list(tasks) == ["check Arm", "build Arm", "bake walk Arm", "collect"]
    for task in tasks.values():
        (command,) = task["commands"]
        assert command["name"] == "exec" and command["parameters"]["exe"] == "{blender}"
        arguments = command["parameters"]["args"]
        blender = arguments[: arguments.index("-c")]
        assert blender == ["-b"] + ["/shots/walk.flamenco.blend"] * (task["name"] != "collect")
        args = flamenco_asks(task)
        assert getattr(args, "changes", []) == []
        assert getattr(args, "object", ["Arm"]) == ["Arm"]


def test_flamenco_collects_the_reports_of_the_job_alone(addon, compiled):
    tasks = compiled(characters="Arm, Leg", wedges="Neutral.stiffness=1e4, Neutral.stiffness=3e4")
    collect = flamenco_asks(tasks["collect"])
    reports = {flamenco_asks(task).report for name, task in tasks.items() if name.startswith("bake ")}
    assert collect.expect == len(reports) == 4
    assert {report.parent for report in reports} == {collect.folder} == {Path("/out/walk now")}


def test_flamenco_bakes_to_files(addon, compiled):
    bake = flamenco_asks(compiled(format="alembic", options="--frames 1  20")["bake walk"])
    assert bake.all and bake.frames == [1, 20]
    assert (bake.format, bake.output_file) == ("alembic", Path("/out/walk {object}.abc"))
    bake = flamenco_asks(compiled(characters="Arm", format="modes")["bake walk Arm"])
    assert (bake.format, bake.output_file) == ("modes", None)
