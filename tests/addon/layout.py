# SPDX-License-Identifier: GPL-3.0-or-later
"""What a panel draws, as texts: Blender has no layouts without a window."""

import copy
import types

import bpy
from bl_ext.user_default.dynamic_morph_targets.ui.panels import sections


def region(width) -> dict:
    """The context of a region of this width, in pixels."""
    system = types.SimpleNamespace(ui_scale=1.0)
    return {"region": types.SimpleNamespace(width=width), "preferences": types.SimpleNamespace(system=system)}


SIDEBAR = region(280)


def registered(name, kind):
    """The class with which Blender draws a panel, a menu or a list. Blender does not draw what is not registered."""
    found = getattr(bpy.types, name, None)
    assert found and issubclass(found, kind), f"{name} is not registered"
    return found


class Layout:
    """Stands in for bpy.types.UILayout: remembers what is drawn and refuses unknown properties and operators."""

    def __init__(self, drawn, place=SIDEBAR, controls=None):
        self.drawn = drawn
        self.labels = []  # (text, icon)
        self.controls = [] if controls is None else controls  # what can be clicked or set, a list as one
        self.context = types.SimpleNamespace(**place)

    def prop(self, data, name, **_options):
        assert name in data.bl_rna.properties, name
        self.controls.append(f"{data.bl_rna.identifier}.{name}")
        self.drawn.append(data.name if name == "name" else name)

    def prop_search(self, data, name, _owner, _collection, **_options):
        self.prop(data, name)

    def operator(self, name, text="", **_options):
        module, function = name.split(".")
        assert getattr(bpy.ops, module).__getattr__(function).get_rna_type()
        self.controls.append(name)
        self.drawn += [name, text] if text else [name]
        if _options.get("depress"):
            self.drawn.append(f"pressed: {text}")
        return types.SimpleNamespace()  # takes the operator's settings

    def operator_menu_enum(self, name, _property, **_options):
        self.operator(name)

    def label(self, text="", icon="NONE", **_options):
        self.labels.append((text, icon))
        self.drawn.append(text)

    def progress(self, factor, text):
        self.drawn.append(text)

    def template_list(self, kind, _id, data, name, active_data, active_name, **_options):
        assert name in data.bl_rna.properties and active_name in active_data.bl_rna.properties
        self.controls.append(kind)
        row = copy.copy(self)
        row.controls = []
        for index, item in enumerate(getattr(data, name)):
            draw = registered(kind, bpy.types.UIList).draw_item
            draw(None, self.context, row, data, item, 0, active_data, active_name, index)

    def menu(self, name, **_options):
        assert registered(name, bpy.types.Menu)
        self.controls.append(name)
        self.drawn.append(name)

    def popover(self, panel, **_options):
        assert registered(panel, bpy.types.Panel)
        self.controls.append(panel)
        self.drawn.append(panel)

    def row(self, **_options):
        return self

    column = split = box = grid_flow = row

    def context_pointer_set(self, _name, _data):
        pass

    def separator(self, **_options):
        pass


def drawn(obj, panel="DYNAMORPH_PT_sidebar", place=SIDEBAR, unfolded=True):
    """The texts of a panel and those inside it. place: see `region`. unfolded: also those that are closed at first."""
    return layout_of(obj, panel, place, unfolded).drawn


def controls(obj, panel="DYNAMORPH_PT_sidebar", unfolded=True):
    """What can be clicked or set there."""
    return layout_of(obj, panel, SIDEBAR, unfolded).controls


def layout_of(obj, panel, place=SIDEBAR, unfolded=True):
    layout = Layout([], place)
    panel_class = registered(panel, bpy.types.Panel)
    context = types.SimpleNamespace(
        object=obj,
        view_layer=bpy.context.view_layer,
        scene=bpy.context.scene,
        window_manager=bpy.context.window_manager,
        **place,
    )
    assert is_there(panel_class, context)
    draw_tree(panel_class, context, layout, unfolded)
    return layout


def is_there(panel_class, context):
    """Whether Blender draws the panel."""
    return not hasattr(panel_class, "poll") or panel_class.poll(context)


def draw_tree(panel_class, context, layout, unfolded):
    drawing = types.SimpleNamespace(layout=layout, section=getattr(panel_class, "section", None))
    for header in ("draw_header", "draw_header_preset"):
        if hasattr(panel_class, header):
            getattr(panel_class, header)(drawing, context)
    options = getattr(panel_class, "bl_options", set())
    if "DEFAULT_CLOSED" in options and getattr(panel_class, "section", None) and not unfolded:
        return
    panel_class.draw(drawing, context)
    for child in inside(panel_class):
        if is_there(child, context):
            draw_tree(child, context, layout, unfolded)


def inside(panel_class):
    """The panels whose parent is this one, in their order."""
    name = panel_class.__name__
    children = [kind.__name__ for kind in sections.CLASSES if getattr(kind, "bl_parent_id", "") == name]
    return [registered(child, bpy.types.Panel) for child in children]
