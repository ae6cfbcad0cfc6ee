# SPDX-License-Identifier: GPL-3.0-or-later
"""A button pressed in a window, without a window: Blender's own operator, and the events that a test gives it."""

import time
import types

import bpy
import pytest
from bl_ext.user_default.dynamic_morph_targets.run import remembered
from builders import activate

APP = bpy.app
PAUSE = 0.002  # seconds from one tick to the next


class Instead:
    """Stands in for something of Blender: has these attributes in the place of its own."""

    def __init__(self, original, **attributes):
        self.__dict__.update(attributes)
        self.original = original

    def __getattr__(self, name):
        return getattr(self.original, name)


def in_window(patch):
    """bpy.app says that Blender runs in a window."""
    patch.setattr(bpy, "app", Instead(APP, background=False))


def press(obj, name, calls, **settings):
    """Press the button of the operator class `name`, by Blender, and let `calls` be what it does.

    In the background Blender calls an operator's `execute` even where it should be invoked, so that leads to
    calls(operator, context). settings: the operator's properties.
    """
    activate(obj)

    def execute(operator, context):
        first.undo()
        return calls(operator, context)

    with pytest.MonkeyPatch.context() as patch, pytest.MonkeyPatch.context() as first:
        in_window(patch)
        first.setattr(getattr(bpy.types, name), "execute", execute)
        return getattr(bpy.ops.dynamorph, name.partition("_OT_")[2])(**settings)


def invoked(obj, name, **window_manager):
    """The result of a button that asks something first; window_manager: what does in the place of its methods."""

    def calls(operator, context):
        manager = Instead(context.window_manager, **window_manager)
        return operator.invoke(Instead(context, window_manager=manager), None)

    return press(obj, name, calls)


class Pressed:
    """A job's button pressed in a window: `events`, then timer ticks until it ends.

    In the background Blender gives an operator no events. So its own `invoke` and `modal` are called here, with the
    context there is. What Blender does itself stays as it is: when another file is loaded it calls `cancel`, and
    `result` is None.

    settings: the operator's properties. reports: (kind, text). turns: how many events it was given.
    """

    def __init__(self, obj, events=(), operator="DYNAMORPH_OT_bake", before_tick=None, **settings):
        self.reports, self.turns, self.operator = [], 0, None
        with pytest.MonkeyPatch.context() as patch:
            kind = getattr(bpy.types, operator)
            # Blender shows the reports of a modal operator only after an event, so they are read as they are made.
            patch.setattr(kind, "__getattribute__", self._attribute(kind.__getattribute__), raising=False)
            self.result = press(obj, operator, self._invoke, **settings)
            in_window(patch)
            self._play(iter(events), before_tick)
        assert remembered.work.running is None

    def _attribute(self, original):
        def attribute(operator, name):
            return self._report if name == "report" else original(operator, name)

        return attribute

    def _report(self, kind, text):
        self.reports.append((*kind, text))

    def _invoke(self, operator, context):
        self.operator = operator
        return operator.invoke(context, None)

    def _play(self, events, before_tick):
        while self.result in ({"RUNNING_MODAL"}, {"PASS_THROUGH"}):
            assert remembered.work.running is self.operator.batch
            if before_tick:
                before_tick(remembered.work.running)
            if remembered.work.running is None:
                self.result = None
                return
            event = types.SimpleNamespace(type=next(events, "TIMER"), value="PRESS")
            self.result = self.operator.modal(bpy.context, event)
            self.turns += 1
            if event.type == "TIMER":
                time.sleep(PAUSE)
