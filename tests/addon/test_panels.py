# SPDX-License-Identifier: GPL-3.0-or-later
"""The panels draw without error and only what exists; how it looks is for the window to show."""

import types

import bpy
import pytest
from builders import activate, hand_made_bake, part, rig_of


def region(width) -> dict:
    """What a context says of a region of this width, in pixels, and of their size."""
    system = types.SimpleNamespace(ui_scale=1.0)
    return {"region": types.SimpleNamespace(width=width), "preferences": types.SimpleNamespace(system=system)}


SIDEBAR = region(280)


class Layout:
    """Stands in for bpy.types.UILayout: remembers what is drawn and refuses unknown properties and operators."""

    def __init__(self, drawn, place=SIDEBAR, unfolded=True):
        self.drawn, self.unfolded = drawn, unfolded
        self.context = types.SimpleNamespace(**place)

    def prop(self, data, name, **_options):
        assert name in data.bl_rna.properties, name
        self.drawn.append(data.name if name == "name" else name)

    def prop_search(self, data, name, _owner, _collection, **_options):
        self.prop(data, name)

    def operator(self, name, text="", **_options):
        module, function = name.split(".")
        assert getattr(bpy.ops, module).__getattr__(function).get_rna_type()
        self.drawn += [name, text] if text else [name]
        return types.SimpleNamespace()  # takes the operator's settings

    def operator_menu_enum(self, name, _property, **_options):
        self.operator(name)

    def label(self, text="", **_options):
        self.drawn.append(text)

    def progress(self, factor, text):
        self.drawn.append(text)

    def template_list(self, kind, _id, data, name, active_data, active_name, **_options):
        assert name in data.bl_rna.properties and active_name in active_data.bl_rna.properties
        for index, item in enumerate(getattr(data, name)):
            getattr(part("panels"), kind).draw_item(
                None, self.context, self, data, item, 0, active_data, active_name, index
            )

    def panel(self, _name, default_closed=False):
        return self, self if self.unfolded or not default_closed else None

    def menu(self, name, **_options):
        assert getattr(bpy.types, name)
        self.drawn.append(name)

    def popover(self, panel, **_options):
        assert getattr(bpy.types, panel)
        self.drawn.append(panel)

    def row(self, **_options):
        return self

    column = split = box = grid_flow = row

    def separator(self, **_options):
        pass


def drawn(obj, panel="DYNAMORPH_PT_sidebar", place=SIDEBAR, unfolded=True):
    """unfolded: also the sections that are closed at first."""
    out = []
    panel_class = getattr(part("panels"), panel)
    context = types.SimpleNamespace(
        object=obj,
        view_layer=bpy.context.view_layer,
        scene=bpy.context.scene,
        window_manager=bpy.context.window_manager,
        **place,
    )
    assert panel_class.poll(context)
    panel_class.draw(types.SimpleNamespace(layout=Layout(out, place, unfolded)), context)
    return out


@pytest.mark.parametrize("panel", ["DYNAMORPH_PT_sidebar", "DYNAMORPH_PT_object_data"])
def test_through_the_workflow(arm, stand_in, panel):
    assert "dynamorph.add_soft_skin" in drawn(arm, panel) and "dynamorph.bake" not in drawn(arm, panel)
    bpy.ops.dynamorph.add_soft_skin()
    bpy.context.scene.frame_set(20)
    bpy.ops.dynamorph.add_target(key="flexed")
    assert {"Neutral", "flexed", "lower", "stiffness", "dynamorph.build", "dynamorph.bake"} <= set(drawn(arm, panel))
    assert "dynamorph.free_bake" not in drawn(arm, panel)
    bpy.ops.dynamorph.bake()
    texts = drawn(arm, panel)
    assert "dynamorph.free_bake" in texts and arm.dynamorph.model.summary[:40] in " ".join(texts)
    arm.dynamorph.model.modes = 5
    assert "Out of date: Modes changed" in drawn(arm, panel)


def test_progress_replaces_the_button(soft_arm, stand_in):
    jobs = part("jobs")
    jobs.running = jobs.Job(soft_arm, goal="BAKE")
    jobs.running.message = "Frame 7"
    try:
        texts = drawn(soft_arm)
        assert "0%  Frame 7" in texts and "dynamorph.cancel" in texts
        assert "dynamorph.bake" not in texts and "dynamorph.build" in texts
        assert not bpy.ops.dynamorph.build.poll()
    finally:
        jobs.running = None


def status() -> list[str]:
    out = []
    part("panels").draw_status(types.SimpleNamespace(layout=Layout(out)), None)
    return out


def test_the_status_bar_says_what_runs(soft_arm, stand_in, monkeypatch):
    """It asks when it draws: nothing is left behind in a workspace or window that the artist has gone from."""
    assert status() == []
    job = part("jobs").Job(soft_arm, goal="BAKE")
    job.fraction, job.message = 0.4, "Frame 7"
    monkeypatch.setattr(part("jobs"), "running", job)
    assert status() == ["40%  Frame 7    Esc: cancel"]
    monkeypatch.setattr(part("jobs"), "running", None)
    monkeypatch.setattr(part("live_operators"), "preview", types.SimpleNamespace(label="Shake Test"))
    assert status() == ["Shake Test    Esc: stop"]


def test_a_narrow_list_has_room_for_names_only(soft_arm):
    assert "20 kPa" not in drawn(soft_arm) and "20 kPa" in drawn(soft_arm, place=region(400))


def test_many_bones_are_folded_away(soft_arm):
    target = soft_arm.dynamorph.targets[1]
    assert "lower" in drawn(soft_arm, unfolded=False)
    target.set_bones([f"bone {i}" for i in range(12)])
    folded = drawn(soft_arm, unfolded=False)
    assert "12 Bones" in folded and "bone 3" not in folded
    assert "bone 3" in drawn(soft_arm)


def test_a_missing_engine_is_shown(soft_arm, monkeypatch):
    monkeypatch.setattr(part("jobs"), "engine_problem", lambda: "The engine cannot be loaded (no wheel). Install it")
    assert "The engine cannot be loaded (no wheel)." in " ".join(drawn(soft_arm))


def test_only_for_meshes(soft_arm):
    panel = part("panels").DYNAMORPH_PT_sidebar
    assert not panel.poll(types.SimpleNamespace(object=None))
    assert not panel.poll(types.SimpleNamespace(object=bpy.data.objects.new("Empty", None)))


@pytest.mark.parametrize("mode", ["OBJECT", "POSE"])
def test_on_the_rig_for_its_skin(soft_arm, mode):
    rig = rig_of(soft_arm)
    activate(rig)
    bpy.ops.object.mode_set(mode=mode)
    assert {"Arm", "Neutral", "flexed"} <= set(drawn(rig))
    soft_arm.dynamorph.targets.clear()
    assert not bpy.ops.dynamorph.capture_pose.poll()


def test_a_target_without_its_key_is_marked(soft_arm):
    part("sinks").write_modal_keys(soft_arm, hand_made_bake(soft_arm))
    soft_arm.shape_key_clear()
    assert "flexed" in drawn(soft_arm)
    part("sinks").free(soft_arm)
    assert "dynamorph.free_bake" not in drawn(soft_arm)
