# SPDX-License-Identifier: GPL-3.0-or-later
"""Work in a process of its own: the same bytes, news, errors, and what happens when one of the two processes dies."""

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
import types
from functools import partial
from pathlib import Path

import addon_utils
import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import errors
from bl_ext.user_default.dynamic_morph_targets.core.motion import baked
from bl_ext.user_default.dynamic_morph_targets.run import remembered
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.run.work import child, task
from bl_ext.user_default.dynamic_morph_targets.run.work.child import Child, Here
from bl_ext.user_default.dynamic_morph_targets.run.work.computation import Draft, Errand
from installed import MODULE
from pressed import Pressed

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

KILLS = int(os.environ.get("DYNAMORPH_KILLS", "4"))  # random moments at which the process is killed
posix = pytest.mark.skipif(os.name == "nt", reason="Windows has no signals")


def folders():
    return {*Path(tempfile.gettempdir()).glob("dynamorph-*")}


@pytest.fixture(autouse=True)
def nothing_left():
    before = folders()
    yield
    child.dismiss()
    assert folders() <= before


def ask(worker, name, *args, meanwhile=lambda: None):
    answer = worker.call(name, *args)
    try:
        while True:
            next(answer)
            meanwhile()
            time.sleep(0.002)
    except StopIteration as end:
        return end.value


@pytest.fixture
def errand(addon):
    heard = []
    made = Child(Errand, heard=heard.append, name="Arm")
    made.heard = heard
    yield made
    made.end()
    assert made.ended


def test_arrays_cross_in_slices_and_as_they_are(errand, monkeypatch):
    monkeypatch.setattr(child, "SLICE", 2**20)
    given, turns = np.random.default_rng(1).random((300, 1000, 2)), []
    found = ask(errand, "run", partial(np.multiply, given, 2.0), False, meanwhile=lambda: turns.append(1))
    assert np.array_equal(found, 2.0 * given) and found.flags.writeable and len(turns) > 8


@pytest.mark.parametrize(
    "work, kind, words",
    [
        (partial(os.listdir, "/there/is/no/such"), FileNotFoundError, "/there/is/no/such"),
        (partial(int, "none"), ValueError, "invalid literal"),
        (partial(np.zeros, 2**50), MemoryError, "allocate"),
        (partial(errors.SceneError, "'{name}' is {it}", name="A{b}c", it="odd"), None, "'A{b}c' is odd"),
        (partial(memoryview, b"1"), RuntimeError, "memory"),  # what cannot be sent
    ],
)
def test_what_is_raised_there_is_raised_here(errand, work, kind, words):
    if kind is None:
        assert str(ask(errand, "run", work, False)) == words
        return
    with pytest.raises(kind, match=words) as raised:
        ask(errand, "run", work, False)
    if kind is not RuntimeError:
        assert "in the process that computes:\nTraceback" in raised.value.__notes__[0]
    assert ask(errand, "run", partial(abs, -1), False) == 1  # it goes on


def telling(report):
    """Runs in this process only: the other one has not this module."""
    for k in range(3):
        report(k)
    report(Draft(0, "model", "character"))
    return "told"


def test_news_are_heard_here_too(addon):
    heard = []
    here = Here(Errand, heard=heard.append)
    assert ask(here, "run", telling, True) == "told" and heard[:3] == [0, 1, 2] and heard[3].model == "model"


@pytest.fixture
def small(soft_arm):
    soft_arm.dynamorph.model.cage_nodes, soft_arm.dynamorph.model.modes = 200, 60
    return soft_arm


def baked_by(obj, kind, folder, meanwhile=lambda _work: None):
    """A bake of `obj` that is computed by such a worker."""
    with pytest.MonkeyPatch.context() as patch:
        if kind is Child:
            patch.setattr(task, "worker_for", Child)
        job = Job(obj, "BAKE", rebuild=True, folder=folder)
        work = batch.Batch([job], "BAKE")
        try:
            for _ in work.steps():
                meanwhile(work)
        finally:
            work.stop()
    return job


def told(job):
    outcome = job.outcome
    caches = [file.read_bytes() for _, file in outcome.written if file]
    keys = [baked.digest(each) for each, _ in outcome.written]
    return outcome.packed, baked.digest(outcome.bake), outcome.content_id, keys, caches, job.warnings


@pytest.mark.parametrize("format", ["MODES", "PC2"])
def test_both_ways_make_the_same_bytes(small, tmp_path, format):
    small.dynamorph.output.format = format
    found = [told(baked_by(small, kind, tmp_path / kind.__name__)) for kind in (Here, Child)]
    assert found[0] == found[1] and bool(found[0][4]) == (format == "PC2")


@pytest.mark.fault("C10")
@posix
@pytest.mark.parametrize("seed", range(KILLS))
def test_another_process_goes_on_where_one_is_killed(small, tmp_path, seed):
    """Nothing is lost, and nothing is left."""
    small.dynamorph.output.format = "PC2"
    expected = told(baked_by(small, Here, tmp_path / "here"))
    moment = random.Random(seed).uniform(0.0, 1.5)
    killed = []

    def kill(work):
        if not killed and work.worker and time.monotonic() > began + moment:
            os.kill(work.worker.pid, signal.SIGKILL)
            killed.append(work.message)

    began = time.monotonic()
    assert told(baked_by(small, Child, tmp_path / "killed", kill)) == expected
    assert not [*(tmp_path / "killed").rglob("*.part*")]


@pytest.mark.fault("C10")
@posix
def test_what_dies_twice_is_not_started_again(small, tmp_path, caplog):
    def kill(work):
        if work.worker and not work.worker.ended and work.fraction > 0.0:
            os.kill(work.worker.pid, signal.SIGKILL)

    with pytest.raises(
        errors.ProcessError, match="'Arm': the system ended the process that computes twice.*memory is short"
    ):
        baked_by(small, Child, tmp_path, kill)
    assert not small.dynamorph.bake.exists and not small.dynamorph.model.content_id
    assert len(caplog.records) == 2 and not [*tmp_path.rglob("*.part*")]


@pytest.mark.fault("C10")
def test_what_crashes_twice_says_where(addon, caplog):
    errand = Child(Errand, heard=lambda _news: None, name="Arm")
    with pytest.raises(errors.ProcessError, match="'Arm': the process that computes crashed twice. Nothing was"):
        ask(errand, "run", os.abort, False)
    errand.end()
    assert "Fatal Python error: Aborted" in caplog.text


PARENT = """
import sys, time
sys.path[:0] = {paths!r}
from dynamic_morph_targets.run.work.child import Child
from dynamic_morph_targets.run.work.computation import Errand
child = Child(Errand, heard=print)
answer = child.call("run", time.sleep, False)
answer = child.call("run", __import__("functools").partial(time.sleep, 1000.0), False)
for _ in answer:
    print(child.pid, child.folder, flush=True)
    time.sleep(1000.0)
"""


@pytest.mark.fault("C10")
@posix
def test_it_ends_when_blender_dies(addon):
    import dynamorph

    paths = [str(Path(child.__file__).resolve().parents[2]), str(Path(dynamorph.__file__).parents[1])]
    code = PARENT.format(paths=paths)
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    pid, folder = parent.stdout.readline().split()
    time.sleep(1.0)  # it works
    parent.kill()
    parent.wait()
    parent.stdout.close()
    ends = time.monotonic() + 5.0
    while Path(f"/proc/{pid}").exists() and time.monotonic() < ends:
        time.sleep(0.01)
    assert not Path(f"/proc/{pid}").exists() and not Path(folder).exists()


def meanwhile(obj, act):
    """A bake whose button is pressed in a window, with act() once while another process computes; its result."""
    done = []

    def look(work):
        if work.fraction > 0.25 and not done:
            done.append(work.worker)
            act()

    pressed = Pressed(obj, before_tick=look)
    child.dismiss()  # or what is done may still remove its files
    assert done[0].ended and not done[0].folder.exists()
    return pressed


@pytest.mark.fault("G01")
def test_undo_while_another_process_computes(small):
    for x in (1.0, 2.0):
        bpy.ops.ed.undo_push(message=f"before {x}")
        small["moved"] = x
    bpy.ops.ed.undo_push(message="moved")
    pressed = meanwhile(small, bpy.ops.ed.undo)
    assert pressed.result == {"FINISHED"}, pressed.reports
    assert bpy.data.objects["Arm"].dynamorph.bake.exists


@pytest.mark.fault("G02")
def test_another_file_while_another_process_computes(small):
    load = partial(bpy.ops.wm.read_homefile, use_factory_startup=True, use_empty=True)
    assert meanwhile(small, load).result is None and not bpy.data.objects


@pytest.mark.fault("G03")
def test_deleted_while_another_process_computes(small):
    pressed = meanwhile(small, lambda: bpy.data.objects.remove(bpy.data.objects["Arm"]))
    assert pressed.result == {"CANCELLED"} and "was deleted" in pressed.reports[0][1]


@pytest.mark.fault("G05")
def test_switched_off_while_another_process_computes(small):
    def switch_off():
        addon_utils.disable(MODULE)
        addon_utils.enable(MODULE)

    assert meanwhile(small, switch_off).result is None
    assert not bpy.data.objects["Arm"].dynamorph.bake.exists


def test_esc_leaves_nothing(small, tmp_path):
    """No process, no folder, no part of a point cache."""
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    small.dynamorph.output.format = "PC2"

    def events():
        while remembered.work.running.fraction < 0.3:
            yield "TIMER"
        yield "ESC"

    pressed = Pressed(small, events())
    assert pressed.result == {"CANCELLED"} and pressed.reports == [("WARNING", "Canceled: nothing was changed")]
    assert pressed.operator.batch.worker.ended and not [*tmp_path.rglob("*.part*")]
    assert not small.dynamorph.model.content_id


def test_the_next_process_waits_for_work(addon):
    child.prepare()
    (spare,) = remembered.work.spare
    child.prepare()
    assert remembered.work.spare == [spare] and spare.waits
    errand = Child(Errand, heard=lambda _news: None)
    assert errand.pid == spare.pid and remembered.work.spare == []
    assert ask(errand, "run", partial(abs, -2), False) == 2
    errand.end()
    child.prepare()
    (spare,) = remembered.work.spare
    child.dismiss()
    assert remembered.work.spare == [] and spare.ended


def test_nobody_waits_for_a_process_that_has_done_its_work(addon):
    errand = Child(Errand, heard=lambda _news: None)
    assert ask(errand, "run", partial(abs, -2), False) == 2
    process = types.SimpleNamespace(ended=False, end=lambda _patience: pytest.fail("the next one waits for it"))
    remembered.work.leaving.append(process)
    child.prepare()
    child.take().end()
    assert remembered.work.leaving == [process]
    remembered.work.leaving.clear()
    errand.leave()
    child.dismiss()
    assert errand.ended and not errand.folder.exists() and remembered.work.leaving == []


def test_a_program_that_does_not_start_is_named(addon, monkeypatch):
    child.dismiss()
    monkeypatch.setattr(sys, "executable", "/there/is/no/python")
    with pytest.raises(errors.ProcessError, match="cannot be started with '/there/is/no/python'"):
        Child(Errand, heard=lambda _news: None)
