# SPDX-License-Identifier: GPL-3.0-or-later
"""Bakes in earnest: progress, Esc at every stage, Influence, what is out of date."""

from __future__ import annotations

import time

import bpy
import driver
import limb
import numpy as np
from driver import Task, measure, step, until
from editors import (
    addon,
    baked,
    close,
    job,
    job_done,
    keys,
    moved,
    physics,
    properties,
    rig,
    select_target,
    settings,
    shown_at,
    sidebar,
    skin,
    viewport,
)

SOON = 1.0  # seconds: what Esc may take on a busy machine; a fifth of that, on one that does nothing else


def wobble() -> float:
    return moved(limb.FLEXED + 1, limb.FLEXED + 4)


@step("Bake again")
def bake_again():
    bpy.context.scene.frame_set(limb.FLEXED + 1)
    begin = time.monotonic()
    yield from sidebar.press("dynamorph.bake")
    yield from job_done()
    measure("A bake of the arm, without a build", f"{time.monotonic() - begin:.1f} s")
    swings = wobble()
    assert baked() and swings > 1e-4, f"{baked()} swing by {1e3 * swings:.3f} mm"


@step("Influence")
def influence():
    """A value of 0.5 leaves half the motion."""
    whole, strip = shown_at(limb.FLEXED + 1), addon("write.bake.influence").influence_strip(skin())
    yield from sidebar.enter(strip.path_from_id("influence"), "0")
    still = shown_at(limb.FLEXED + 1)
    yield from sidebar.enter(strip.path_from_id("influence"), "0.5")
    assert strip.influence == 0.5
    half = shown_at(limb.FLEXED + 1)
    assert np.abs(half - 0.5 * (whole + still)).max() < 0.05 * np.abs(whole - still).max() > 1e-5
    strip.influence = 1.0


@step("Bake to fewer keys")
def fewer_keys():
    """A budget of keys shows the same motion."""
    whole = shown_at(limb.FLEXED + 1)
    yield from physics("bake")
    for name in ("output.format", "model.quality"):
        yield from properties.choose_other(name)
    yield from physics("advanced", "detail")
    yield from driver.drawn()
    yield from properties.enter("output.keys", "16")
    yield from sidebar.press("dynamorph.bake")
    yield from job_done()
    assert np.abs(shown_at(limb.FLEXED + 1) - whole).max() < 1e-3
    assert len(settings().bake.keys) == 16
    yield from properties.enter("output.keys", "0")
    yield from close("detail", "advanced")
    yield from bake_again()


@step("Bake with Options")
def bake_options():
    """Into the armature's Action, and then into one of its own again."""
    yield from physics("bake")
    settings().output.bake_to_action = True  # not by hand: the dialog begins with it
    yield from driver.drawn()  # the panel says so now, above the button
    yield from properties.pop_up("dynamorph.bake_options")
    yield from properties.key("RET")
    yield from job_done()
    assert settings().bake.action == rig().animation_data.action
    settings().output.bake_to_action = False
    yield from bake_again()


@step("Out of date", picture=sidebar)
def out_of_date():
    yield from select_target(1)
    yield from sidebar.fold("DYNAMORPH_PT_targets")
    yield from sidebar.unfold("DYNAMORPH_PT_material")
    yield from sidebar.enter("targets[1].stiffness", str(round(2.0 * settings().targets[1].stiffness)))
    assert addon("scene.store.staleness").outdated(skin()) == ['Stiffness of "flexed" changed']
    yield from sidebar.fold("DYNAMORPH_PT_material")
    yield from sidebar.fold("DYNAMORPH_PT_details")  # which would leave no room for the message


@step("Bake All")
def bake_all():
    before, model = wobble(), settings().model.content_id
    yield from properties.press("dynamorph.bake_all")
    yield from job_done()
    yield from close("bake")
    assert settings().model.content_id == model, "a new stiffness rebuilt the model"
    assert not addon("scene.store.staleness").outdated(skin())
    assert abs(wobble() - before) > 0.1 * before


@step("Bake, render, delete, and bake again")
def bake_and_render():
    render = bpy.context.scene.render
    render.engine, render.resolution_x, render.resolution_y = "BLENDER_WORKBENCH", 160, 120  # no graphics card
    bpy.context.preferences.view.render_display_type = "NONE"
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.matrix_world = viewport.area.spaces.active.region_3d.view_matrix.inverted()
    bpy.context.scene.collection.objects.link(camera)
    bpy.context.scene.camera = camera
    rendered = []
    bpy.app.handlers.render_complete.append(lambda *_: rendered.append(True))
    task = Task("bake, render, delete the bake, bake again", 4)
    yield from sidebar.press("dynamorph.bake")
    yield from job_done()
    yield from viewport.key("F12")
    yield from until(lambda: rendered, "the rendered frame", 60.0)
    bpy.app.handlers.render_complete.pop()
    yield from sidebar.press("dynamorph.delete_bake")
    yield from until(lambda: not baked(), "the bake to be deleted")
    yield from sidebar.press("dynamorph.bake")
    yield from job_done()
    task.done()
    assert baked()
    bpy.data.cameras.remove(camera.data)  # with its object


@step("Live over the bake")
def live_over_the_bake():
    bpy.context.scene.frame_set(limb.FLEXED + 1)
    before, shown = keys(), shown_at(limb.FLEXED + 1)
    yield from sidebar.press("dynamorph.live")
    yield from until(lambda: addon("run.live").is_on(skin()), "Live to be on")
    assert baked() and np.abs(shown_at(limb.FLEXED + 1) - shown).max() > 1e-5
    yield from sidebar.press("dynamorph.live")
    yield from until(lambda: not addon("run.live").is_on(skin()), "Live to be off")
    assert keys() == before and np.array_equal(shown_at(limb.FLEXED + 1), shown)


# Esc -----------------------------------------------------------------------------------------------------------------


def escapes(name: str, button: str, moments, limit=60.0):
    """Press a button, and Esc at the first moment; again for the others. A moment is a condition on the job."""
    yield from driver.drawn()
    before = keys(), baked(), settings().model.content_id
    blocked, latencies = [], []
    for moment in moments:
        position = yield from sidebar.find(button)
        begin = time.perf_counter()
        yield from driver.click(position)
        yield from until(job, "the job to begin", limit)
        blocked.append(time.perf_counter() - begin)
        yield from until(lambda moment=moment: job() is None or moment(job()), f"the moment for Esc: {name}", limit)
        assert job(), f"the job was done before Esc could be pressed: {name}"
        latencies.append((yield from escape()))
        assert (keys(), baked(), settings().model.content_id) == before
    measure(f"Esc while {name}", f"median {np.median(latencies):.2f} s, worst {max(latencies):.2f} s")
    measure(f"Window blocked when it begins, {name}", f"{max(blocked):.2f} s")


def escape():
    """Press Esc; returns the seconds until the job is gone."""
    driver.send("ESC", "PRESS", viewport.middle)
    begin = time.perf_counter()
    while job():
        assert time.perf_counter() - begin < SOON, "Esc takes too long"
        yield 0.002
    seconds = time.perf_counter() - begin
    driver.send("ESC", "RELEASE", viewport.middle)
    yield 0.1
    return seconds


def reading(job) -> bool:
    return job.message.startswith("Reading frame")


def simulates(job) -> bool:
    return job.message.startswith("Simulating")


def at(*fractions: float):
    return [lambda job, fraction=fraction: job.fraction > fraction for fraction in fractions]


@step("Esc while it reads the rig")
def cancel_reading():
    yield from physics("advanced", "solver")
    yield from properties.choose_other("simulation.initial_state")
    yield from properties.enter("simulation.substeps", "20")
    yield from close("solver", "advanced")
    assert settings().simulation.substeps == 20
    bpy.context.scene.frame_end = 2000
    moments = [lambda job, share=share: reading(job) and job.fraction > share for share in (0.0, 0.01, 0.02, 0.03)]
    yield from escapes("reading the rig", "dynamorph.bake", moments)


@step("Esc while it builds")
def cancel_building():
    settings().model.cage_nodes = 3000
    yield from escapes("building", "dynamorph.build", at(0.05, 0.3, 0.6))


@step("Esc while it simulates")
def cancel_simulating():
    settings().model.cage_nodes, settings().model.modes = 800, 50  # more would not fit into the .blend
    settings().model.basis = "MODES"  # the slower one: bone responses are done before Esc could be pressed
    bpy.context.scene.frame_end, settings().simulation.substeps = 150, 16
    yield from driver.drawn()
    yield from sidebar.press("dynamorph.build")
    yield from job_done()
    moments = [lambda job, share=share: simulates(job) and job.fraction > share for share in (0.0, 0.25, 0.3)]
    yield from escapes("simulating", "dynamorph.bake", moments)


@step("Esc while it simulates every node")
def cancel_full():
    bpy.context.scene.frame_end = limb.LAST
    settings().simulation.substeps = 0
    settings().model.solver, settings().model.modes = "FULL", 20
    yield from driver.drawn()
    yield from sidebar.press("dynamorph.build")
    yield from job_done()
    yield from escapes("simulating every node", "dynamorph.bake", [simulates] * 3)
    settings().model.solver = "REDUCED"
