# SPDX-License-Identifier: GPL-3.0-or-later
"""What the add-on draws in a 3D view, called as Blender calls it: in the background it never does."""

import bpy
import pytest
from bl_ext.user_default.dynamic_morph_targets.ui.overlays import hands, viewport
from pressed import in_window


class Viewport:
    """The 3D view of Blender's window, which exists in the background too, and what is registered to draw there.

    callbacks: (function, arguments, moment). region: that of the view; others: those that may lie over it.
    """

    def __init__(self):
        self.callbacks = []
        window = bpy.context.window_manager.windows[0]
        area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
        self.region = next(region for region in area.regions if region.type == "WINDOW")
        self.others = [region for region in area.regions if region.type != "WINDOW"]
        self._place = {"window": window, "area": area, "region": self.region}

    def __enter__(self):
        """Register the overlays as in a window."""
        self._patch = pytest.MonkeyPatch()
        self._patch.setattr(bpy.types.SpaceView3D, "draw_handler_add", self._add)
        self._patch.setattr(bpy.types.SpaceView3D, "draw_handler_remove", self._remove)
        self._each("unregister")
        with pytest.MonkeyPatch.context() as patch:
            in_window(patch)
            self._each("register")
        return self

    def __exit__(self, *_error):
        self._each("unregister")
        self._patch.undo()
        assert not self.callbacks
        self._each("register")

    def _each(self, name):
        for module in (viewport, hands):
            getattr(module, name)()

    def draw(self, moment):
        """moment: POST_VIEW or POST_PIXEL."""
        with bpy.context.temp_override(**self._place):
            for callback, arguments, when in self.callbacks:
                if when == moment:
                    callback(*arguments)

    def _add(self, callback, arguments, region_type, moment):
        assert region_type == "WINDOW"
        self.callbacks.append((callback, arguments, moment))
        return self.callbacks[-1]

    def _remove(self, handle, _region_type):
        self.callbacks.remove(handle)
