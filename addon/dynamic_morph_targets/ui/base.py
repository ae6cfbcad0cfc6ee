# SPDX-License-Identifier: GPL-3.0-or-later
"""What all buttons have in common: when they are grayed out, and how errors are reported."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.app.translations import pgettext_rpt as rpt_

from ..core import engine, errors, logger, message
from ..core.message import Message, translated
from ..run import remembered
from ..scene import events, skin
from ..write.reconcile import reconcile


def report_errors(operator: bpy.types.Operator, action: Callable[..., set[str] | None], *args: Any) -> set[str]:
    """Call `action`. An error becomes a report, a bug is also logged, and the operator is canceled."""
    try:
        return action(*args) or {"FINISHED"}
    except errors.Cancelled:
        operator.report({"WARNING"}, "Canceled: nothing was changed")
    except engine.expected_errors() as error:
        operator.report({"ERROR"}, translated(errors.sentence(error), rpt_))
    except Exception as bug:
        logger.log_bug(bug)
        operator.report({"ERROR"}, translated(logger.bug_sentence(bug), rpt_))
    return {"CANCELLED"}


def reported(error: RuntimeError) -> str:
    """What another operator has reported as its error, without the word that Blender puts before it."""
    return str(error).removeprefix(f"{rpt_('Error')}: ").strip()


class SoftSkinOperator:
    """Mixin: works on the mesh of the context, which must carry a soft skin, while no job runs."""

    report: Callable  # of bpy.types.Operator
    poll_message_set: Callable
    apply: Callable  # (self, obj): the work

    bl_options = {"REGISTER", "UNDO"}

    needs_soft_skin = True
    on_override = False  # whether a library override keeps what the button changes
    on_linked_mesh = False  # whether a local object with a linked mesh does

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        disabled_reason = cls.disabled_reason(context)
        if disabled_reason:
            cls.poll_message_set(translated(disabled_reason, iface_))
        return not disabled_reason

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        """Why the button is grayed out, or ''."""
        obj = skin.mesh_in(context)
        if obj is None:
            return "Select the character's mesh object"
        if obj.library:
            return Message(
                "'{name}' is linked: make a library override to change its materials, or make it local", name=obj.name
            )
        if obj.override_library and not cls.on_override:
            return Message(
                "'{name}' is a library override, which would lose this when saved: make it local", name=obj.name
            )
        if obj.data.library and not (obj.override_library or cls.on_linked_mesh):
            return Message(
                "The mesh of '{name}' is linked, so shape keys and weights would be lost when saved: make it local "
                "(Object > Relations > Make Local > Selected Objects and Data)",
                name=obj.name,
            )
        if cls.needs_soft_skin and not obj.dynamorph.targets:
            return "Press Add Soft Skin first"
        return at_work()

    def execute(self, context: bpy.types.Context) -> set[str]:
        result = report_errors(self, self._apply_reconciled, skin.mesh_in(context))
        events.redraw(events.PANELS)  # Blender draws the one again in which the button is
        return result

    def _apply_reconciled(self, obj: bpy.types.Object) -> set[str] | None:
        return self.apply(reconciled(obj))

    def warn(self, texts: Iterable[str]) -> None:
        """Report sentences that do not prevent what the button does."""
        for text in texts:
            self.report({"WARNING"}, translated(text, rpt_))


def reconciled(obj: bpy.types.Object | None) -> bpy.types.Object | None:
    """The object, once its references follow what a script may have renamed just now."""
    if obj and obj.dynamorph.targets:
        reconcile(obj)
    return obj


def at_work() -> str:
    """Which job must end first, or ''."""
    if not remembered.work.running:
        return ""
    return Message("Wait until '{name}' is done, or cancel it", name=remembered.work.running.name)


def listed(names: Sequence[str]) -> str:
    """`message.listed` in the interface's language."""
    return translated(message.listed(names), rpt_)


class ElementOperator(SoftSkinOperator):
    """Mixin: works on the element that is selected in a list. active: its property of the settings."""

    active: str
    nothing_selected: str

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        reason = super().disabled_reason(context)
        if not reason and getattr(skin.mesh_in(context).dynamorph, cls.active) is None:
            return cls.nothing_selected
        return reason


class TargetOperator(ElementOperator):
    """Mixin: works on the target that is selected in the list."""

    active, nothing_selected = "active_target", "Select a target in the list"
    neutral_too = False

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        reason = super().disabled_reason(context)
        if not reason and skin.mesh_in(context).dynamorph.active_target_index == 0 and not cls.neutral_too:
            return "Select a target other than the neutral one"
        return reason
