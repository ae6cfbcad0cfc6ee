# SPDX-License-Identifier: GPL-3.0-or-later
"""What a panel draws, as texts: Blender has no layouts without a window."""

import types

import bpy


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
        if _options.get("depress"):
            self.drawn.append(f"pressed: {text}")
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
            draw = registered(kind, bpy.types.UIList).draw_item
            draw(None, self.context, self, data, item, 0, active_data, active_name, index)

    def panel(self, _name, default_closed=False):
        return self, self if self.unfolded or not default_closed else None

    def menu(self, name, **_options):
        assert registered(name, bpy.types.Menu)
        self.drawn.append(name)

    def popover(self, panel, **_options):
        assert registered(panel, bpy.types.Panel)
        self.drawn.append(panel)

    def row(self, **_options):
        return self

    column = split = box = grid_flow = row

    def context_pointer_set(self, _name, _data):
        pass

    def separator(self, **_options):
        pass


def drawn(obj, panel="DYNAMORPH_PT_sidebar", place=SIDEBAR, unfolded=True):
    """place: see `region`. unfolded: also the sections that are closed at first."""
    out = []
    panel_class = registered(panel, bpy.types.Panel)
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
