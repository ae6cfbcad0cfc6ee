# SPDX-License-Identifier: GPL-3.0-or-later
"""Options that concern all commands, the cache folder, and pages that list every option and every key of a report."""

import json
import re
import sys
from pathlib import Path

import bpy
import pytest
from bl_ext.user_default.dynamic_morph_targets.cli import commands, main, signals
from bl_ext.user_default.dynamic_morph_targets.cli.help import EXAMPLES
from bl_ext.user_default.dynamic_morph_targets.core.motion import simulate
from bl_ext.user_default.dynamic_morph_targets.io import cache_dir
from bl_ext.user_default.dynamic_morph_targets.run.bake import bake_input
from builders import make_arm, make_soft

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
DOCS = Path(__file__).parents[3] / "docs"


@pytest.fixture
def shot(soft_arm, tmp_path):
    """A saved file with a coarse arm."""
    soft_arm.dynamorph.model.cage_nodes, soft_arm.dynamorph.model.modes = 200, 8
    path = tmp_path / "shot.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


@pytest.fixture
def run(capfd):
    """Runs a command line; returns exit code, output, errors."""

    def run(*arguments):
        capfd.readouterr()
        code = main.main([str(each) for each in arguments], opens_file=True)
        return code, *capfd.readouterr()

    return run


def text_of(page):
    return (DOCS / page).read_text(encoding="utf-8")


# The cache folder ---------------------------------------------------------------------------------------------------


@pytest.fixture
def fitted(shot):
    """The file with modes that are fitted to the shot."""
    model = bpy.data.objects["Arm"].dynamorph.model
    model.basis, model.fit_to_shot = "MODES", True
    bpy.ops.wm.save_mainfile()
    return shot


def test_a_model_that_cannot_be_shared_is_not_built_for_the_cache_folder_alone(fitted, run, tmp_path):
    folder, report = tmp_path / "models", tmp_path / "report.json"
    code, out, errors = run("build", fitted, "--all", "--cache-dir", folder, "--report", report)
    assert code == 0 and "Arm: warning: The modes are fitted to this shot" in errors and "built because" not in out
    assert not folder.exists()
    found = json.loads(report.read_text())
    assert found["written"] == [] and "fitted to this shot" in found["characters"][0]["warnings"][0]
    code, out, _ = run("build", fitted, "--all", "--cache-dir", folder, "--no-fit-to-shot", "--report", report)
    (built,) = folder.iterdir()
    assert code == 0 and f"Arm: model written to {built}" in out
    assert json.loads(report.read_text())["written"] == [str(built)]


def test_a_bake_that_cannot_resume_says_so(fitted, run, tmp_path):
    folder, report, output = tmp_path / "models", tmp_path / "report.json", tmp_path / "out.blend"
    bake = "bake", fitted, "--all", "--cache-dir", folder, "-o", output, "--report", report
    code, _, errors = run(*bake)
    assert code == 0 and errors.count("The modes are fitted to this shot") == 1 and not folder.exists()
    assert "fitted to this shot" in json.loads(report.read_text())["characters"][0]["warnings"][0]
    bpy.ops.wm.open_mainfile(filepath=str(output))
    assert bpy.data.objects["Arm"].dynamorph.bake.warnings == ""  # it is of that run alone
    code, _, errors = run("bake", output, "--all", "--cache-dir", folder, "--in-place")  # its model is up to date
    assert code == 0 and "fitted to this shot" not in errors
    assert "fitted to this shot" not in run(*bake, "--no-fit-to-shot")[2]


def test_a_model_that_is_up_to_date_goes_into_the_cache_folder(shot, run, tmp_path):
    folder, output, report = tmp_path / "models", tmp_path / "built.blend", tmp_path / "report.json"
    assert run("build", shot, "--all", "-o", output)[0] == 0
    assert run("build", output, "--all", "--cache-dir", folder, "--report", report)[0] == 0
    found = json.loads(report.read_text())
    (written,) = folder.iterdir()
    assert found["written"] == [str(written)] and found["characters"][0]["model_from"] == "file"
    code, out, _ = run("bake", shot, "--all", "--cache-dir", folder, "-o", output, "--report", report)
    assert code == 0 and "Arm: the model is from the cache folder" in out and "built because" not in out
    assert json.loads(report.read_text())["characters"][0]["model_from"] == "cache"


def test_what_a_bake_that_was_stopped_says_to_do(shot, run, tmp_path, monkeypatch):
    folder, output = tmp_path / "models", tmp_path / "out.blend"
    bake = "bake", shot, "--all", "-o", output

    def stop(*_, **_options):
        raise signals.Preempted

    with monkeypatch.context() as patch:
        patch.setattr(simulate.Shot, "bake", stop)
        code, _, errors = run(*bake)
        assert code == 75 and errors.endswith("nothing was saved: run it again. With --cache-dir it resumes\n")
        for option in ("--loop", "--cache-dir"):
            value = (tmp_path / "empty",) if option == "--cache-dir" else ()
            with monkeypatch.context() as inner:
                inner.setattr(cache_dir.CacheDir, "keep", lambda *_: None)
                code, _, errors = run(*bake, option, *value)
            assert code == 75 and errors.endswith("nothing was saved: run it again\n")
        monkeypatch.setattr(bake_input, "SHORT_CHUNK_FRAMES", 5)
        code, _, errors = run(*bake, "--cache-dir", folder)
        assert code == 75 and errors.endswith("nothing was saved: run it again, and it resumes\n")
    assert run(*bake, "--cache-dir", folder)[0] == 0


def test_what_is_keyed_is_reported_and_no_option_replaces_it(shot, run, tmp_path):
    keyed, report, output = tmp_path / "keyed.blend", tmp_path / "report.json", tmp_path / "out.blend"
    bpy.ops.wm.open_mainfile(filepath=str(shot))
    arm = bpy.data.objects["Arm"]
    for value, frame in ((2e4, 1), (4e4, 20)):
        arm.dynamorph.targets[0].stiffness = value
        arm.dynamorph.targets[0].keyframe_insert("stiffness", frame=frame)
    arm.dynamorph.simulation.keyframe_insert("amount", frame=1)
    bpy.ops.wm.save_as_mainfile(filepath=str(keyed))
    bake = "bake", keyed, "--all", "-o", output, "--report", report
    code, out, _ = run(*bake)
    assert code == 0 and "targets[0].stiffness" in out
    found = json.loads(report.read_text())["characters"][0]["bake"]["keyed"]
    assert found == ["targets[0].stiffness", "simulation.amount"]
    for options in (("--set", "Neutral.stiffness=1e4"), ("--amount", "0.5")):
        code, _, errors = run(*bake, *options)
        assert code == 2 and f"{options[0]}" in errors and "'Arm' has keys or a driver on that" in errors


# Options of all commands ----------------------------------------------------------------------------------------------


def test_another_scene_of_the_file(shot, run, tmp_path):
    first = bpy.context.scene.name
    other = bpy.data.scenes.new("Other")
    bpy.context.window.scene = other
    leg = make_soft(make_arm(other, "Leg"))
    leg.dynamorph.model.cage_nodes, leg.dynamorph.model.modes, other.frame_end = 200, 8, 7
    bpy.context.window.scene = bpy.data.scenes[first]
    bpy.ops.wm.save_mainfile()
    output, report = tmp_path / "out.blend", tmp_path / "report.json"
    code, _, errors = run("bake", shot, "--scene", "Other", "--all", "-o", output, "--report", report)
    assert code == 0, errors
    (found,) = json.loads(report.read_text())["characters"]
    assert found["name"] == "Leg" and found["bake"]["frames"] == [1, 7]
    bpy.ops.wm.open_mainfile(filepath=str(output))
    assert bpy.context.scene.name == first != "Other"
    assert bpy.data.objects["Leg"].dynamorph.bake.keys and not bpy.data.objects["Arm"].dynamorph.bake.keys
    assert "Leg: can be built" in run("check", shot, "--scene", "Other")[1]
    code, _, errors = run("check", shot, "--scene", "Other", "--object", "Arm")
    assert code == 2 and "scene 'Other' has no object named 'Arm': its soft skins are Leg" in errors
    code, _, errors = run("check", shot, "--scene", "other")
    assert code == 2 and "--scene: the file has no scene named 'other': it has" in errors
    assert "Did you mean 'Other'?" in errors


def test_quiet_leaves_warnings_and_errors_alone(fitted, run, tmp_path):
    bake = "bake", fitted, "--all", "--cache-dir", tmp_path / "models", "-o", tmp_path / "out.blend"
    code, out, errors = run(*bake, "--quiet")
    assert code == 0 and out == "" and errors.startswith("Arm: warning: ")
    code, out, errors = run(*bake, "--quiet", "--object", "Nope")
    assert code == 2 and out == ""
    code, out, errors = run(*bake, "--quiet", "--frames", 9, 2)
    assert code == 2 and out == "" and "dynamorph: error: 'Arm': the last frame 2" in errors
    assert "Arm" in run("info", fitted)[1]  # it is not quiet any more
    if sys.platform == "linux":
        assert run(*bake, "--quiet", "-o", tmp_path / "caf\udce9.blend")[0] == 0  # a name that is not UTF-8


def test_versions(run):
    code, out, _ = run("--version")
    assert code == 0 and re.fullmatch(rf"Dynamorph \S+, engine .+, Blender {bpy.app.version_string}\n", out)


@pytest.mark.parametrize("command", ["", *EXAMPLES])
def test_help_ends_with_an_example_that_is_understood_and_exit_codes(run, command):
    code, out, _ = run(*command.split(), "--help")
    assert code == 0 and re.search(r"^  75 +.*try again", out, re.MULTILINE)
    example = re.search(r"^example:\n  python -m dynamic_morph_targets (.+)$", out, re.MULTILINE)[1].split()
    assert main.parser(opens_file=True).parse_args(example).run
    if command in ("", "bake"):
        assert "shot.blend --object Body -o baked.blend" in " ".join(example)


def test_help_has_the_interface_s_names_and_defaults(run):
    out = " ".join(run("bake", "--help")[1].split())
    for text in ("Between Targets. ", "forces: Stiffer Wins, even: Halfway Shape", "default: scene", "default: text"):
        assert text in out


# Pages --------------------------------------------------------------------------------------------------------------


def test_the_page_has_every_option(run):
    said = "".join(run(command, "--help")[1] for command in EXAMPLES)
    lines = re.findall(r"^  (-.*?)(?:  |$)", said, re.MULTILINE)
    known = {option for line in lines for option in re.findall(r"(?<![\w-])--?[a-z][a-z-]*", line)}
    named = set(re.findall(r"(?<![\w-])--?[a-z][a-z-]*", text_of("command_line.md")))
    short_forms = {f"--no-{option[2:]}" for option in known if f"--no-{option[2:]}" in known}
    assert known - named - short_forms == set()
    assert {option for option in named if re.match("--[a-z]", option)} - known == {"--version"}


def test_the_page_has_every_setting_with_its_name_in_the_panels_and_its_values():
    groups = bpy.types.Object.bl_rna.properties["dynamorph"].fixed_type.properties
    page = text_of("command_line.md")
    for part, names in commands.SETTINGS.items():
        _, rows = page.split(f"\n## {part.capitalize()} settings\n")
        rows = rows.split("\n## ")[0]
        expected = []
        for name in names:
            setting, option = groups[part].fixed_type.properties[name], f"--{name.replace('_', '-')}"
            shown = f"`{option}`, `--no-{option[2:]}`" if setting.type == "BOOLEAN" else f"`{option}`"
            values = [(f"`{option} {item.identifier.lower()}`", item.name) for item in items_of(setting)]
            expected += [f"| {cell} | {title} |" for cell, title in ((shown, setting.name), *values)]
        assert re.findall(r"^(\| `--.*? \| .*? \|)", rows, re.MULTILINE) == expected


def items_of(setting):
    return setting.enum_items if setting.type == "ENUM" else ()


def keys_in(value):
    """All keys of nested JSON data, but those of stages."""
    if isinstance(value, list):
        return {key for each in value for key in keys_in(each)}
    if not isinstance(value, dict):
        return set()
    inner = [keys_in(each) for name, each in value.items() if name != "seconds"]
    return set(value).union(*inner)


def test_the_page_has_every_key_of_a_report(shot, run, tmp_path, monkeypatch, capfd):
    first, output, report = tmp_path / "a.blend", tmp_path / "b.blend", tmp_path / "report.json"
    found = set()
    for command, *arguments in (
        ("check", shot),
        ("build", shot, "-o", output),
        ("bake", shot, "--compare-full", "-o", first),
        ("bake", first, "--keep-outside", "--frames", 5, 15, "-o", output),
        ("bake", shot, "--loop", "-o", output),
        ("bake", shot, "--solver", "full", "-o", output),
    ):
        code, _, errors = run(command, *arguments, "--all", "--report", report)
        assert code == 0, errors
        found |= keys_in(json.loads(report.read_text()))
    page = text_of("report.md")
    first_column = set(re.findall(r"`(\w+)`", " ".join(re.findall(r"^\| (`.*?`) \|", page, re.MULTILINE))))
    assert found - set(re.findall(r"`(\w+)`", page)) == set() and first_column - found == set()
    monkeypatch.chdir(tmp_path)
    (example,) = re.findall(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    exec(example, {})
    assert re.search(r"^Arm\n(.|\n)*  largest displacement: 0\.\d+ m$", capfd.readouterr().out, re.MULTILINE)
