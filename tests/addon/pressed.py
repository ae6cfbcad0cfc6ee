# SPDX-License-Identifier: GPL-3.0-or-later
"""A button pressed in a window, without a window: Blender's own operator, and the events that a test gives it."""

import time
import types

import bpy
import pytest
from builders import activate, part

APP = bpy.app


class InWindow:
    """Stands in for bpy.app, which says that Blender runs in the background."""

    background = False

    def __getattr__(self, name):
        return getattr(APP, name)


class Pressed:
    """A job's button pressed in a window: `events`, then timer ticks until it ends.

    In the background Blender calls an operator's `execute` even where it is to be invoked, and gives it no events. So
    `execute` leads to the operator's own `invoke` here, and its own `modal` is called with the context there is. What
    Blender does itself stays as it is: when another file is loaded it calls `cancel`, and `result` is None.

    settings: the operator's properties. reports: (kind, text). turns: how many events it was given.
    """

    def __init__(self, obj, events=(), operator="DYNAMORPH_OT_bake", before_tick=None, **settings):
        self.reports, self.turns, self.operator = [], 0, None
        activate(obj)
        with pytest.MonkeyPatch.context() as patch:
            kind = getattr(bpy.types, operator)
            # Blender shows what a modal operator reports after an event, and no sooner: it is read as it is said.
            patch.setattr(kind, "__getattribute__", self._attribute(kind.__getattribute__), raising=False)
            self.result = self._invoke(kind, settings)
            self._play(iter(events), before_tick)
        assert part("batch").running is None

    def _attribute(self, original):
        def attribute(operator, name):
            return self._report if name == "report" else original(operator, name)

        return attribute

    def _report(self, kind, text):
        self.reports.append((*kind, text))

    def _invoke(self, kind, settings):
        def execute(operator, context):
            first.undo()
            self.operator = operator
            return operator.invoke(context, None)

        with pytest.MonkeyPatch.context() as patch, pytest.MonkeyPatch.context() as first:
            patch.setattr(bpy, "app", InWindow())
            first.setattr(kind, "execute", execute)
            return getattr(bpy.ops.dynamorph, kind.__name__.partition("_OT_")[2])(**settings)

    def _play(self, events, before_tick):
        batch = part("batch")
        while self.result in ({"RUNNING_MODAL"}, {"PASS_THROUGH"}):
            assert batch.running is self.operator.batch
            if before_tick:
                before_tick(batch.running)
            if batch.running is None:
                self.result = None
                return
            event = types.SimpleNamespace(type=next(events, "TIMER"), value="PRESS")
            self.result = self.operator.modal(bpy.context, event)
            self.turns += 1
            time.sleep(0.005)  # the job's thread goes on
