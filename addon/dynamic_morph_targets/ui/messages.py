# SPDX-License-Identifier: GPL-3.0-or-later
"""What the artist should know about a mesh now: problems, what is out of date, warnings, each with its icon."""

from __future__ import annotations

from collections.abc import Iterator, Set

import bpy

from ..core import engine
from ..core.errors import RecordError
from ..core.message import Message, joined
from ..core.model.model import CAGE, HOLD, MODES
from ..core.result import judge
from ..run import live, remembered
from ..run.bake import bake_time
from ..scene import cuts
from ..scene.check import body_checks, checks
from ..scene.check.problem import Problem
from ..scene.motion import colliders, run_settings
from ..scene.skinning import Skinning
from ..scene.store import staleness
from ..write.display import comparison

MOST_REASONS = 3  # of those for which something is out of date
REBUILT = {
    CAGE: "Build Model rebuilds everything",
    HOLD: "Build Model keeps the cage and rebuilds its hold and the modes",
    MODES: "Build Model keeps the cage and its hold, and rebuilds the modes",
}
CHARACTER = 15  # deforming bones, from which a body may be expected to have a head


def messages(obj: bpy.types.Object) -> Iterator[tuple[Problem, str]]:
    """Each with its icon, the worst first, and none twice."""
    said = set()
    for problem, icon in _all_messages(obj):
        if problem.text not in said:
            said.add(problem.text)
            yield problem, icon


def _all_messages(obj: bpy.types.Object) -> Iterator[tuple[Problem, str]]:
    settings, skinning = obj.dynamorph, Skinning.of(obj)
    if engine.engine_problem():
        yield Problem(engine.engine_problem()), "ERROR"
    problems = list(checks.problems(skinning))
    for problem in problems:
        yield problem, "ERROR"
    if not settings.targets and settings.follows:
        text: str = Message("'{name}' moves with '{body}'", name=obj.name, body=settings.follows.name)
        yield Problem(text), "LINKED"
        return
    for problem in body_checks.known(skinning):
        yield problem, "ERROR"
    if settings.targets:
        for text in texts(obj, {problem.text for problem in problems}):
            yield Problem(text), "ERROR"
        for problem in colliders.problems(obj):
            yield problem, "ERROR"
        for problem in (
            *checks.next_steps(obj), *_quality(obj), *_head(skinning), *colliders.notes(obj), *cuts.known(obj),
        ):  # fmt: skip
            yield problem, "INFO"
    for problem in checks.notes(skinning):
        yield problem, "INFO"
    if not settings.targets:
        return
    if live.is_on(obj) and not bpy.context.scene.render.use_lock_interface:
        if live.stood_still(obj):
            text = "Live was frozen in the last render: turn on Lock Interface (Render menu) or bake, and render again"
            yield Problem(text, "LOCK_INTERFACE"), "ERROR"
        else:
            yield Problem("To render Live, turn on Lock Interface", "LOCK_INTERFACE"), "INFO"


def _quality(obj: bpy.types.Object) -> Iterator[Problem]:
    """That what collides is baked in another quality than Live has, or without dents."""
    settings = obj.dynamorph
    quality = settings.model.quality
    if quality == "FULL" or settings.model.method == "STATIC" or not settings.collision.use:
        return
    if quality == "REDUCED":
        yield Problem(
            "'{name}' collides in Reduced Quality, so its dents are coarse: set Quality to Automatic for accurate "
            "dents, which takes longer",
            "FULL_QUALITY",
            name=obj.name,
        )
    elif run_settings.bake_solver(obj) == "FULL" and live.is_on(obj):
        yield Problem(
            "Live uses Reduced Quality, with coarse dents. The bake will use Full Quality, with accurate dents, and "
            "take {time}",
            "",
            time=bake_time.expected(obj),
        )
    elif run_settings.bake_solver(obj) == "FULL" and not settings.bake.exists:
        text = "Colliding bodies are baked in Full Quality, which takes {time}"
        yield Problem(text, "", time=bake_time.expected(obj))


def _head(skinning: Skinning) -> Iterator[Problem]:
    """That no head was found, which then is as soft as the rest."""
    obj = skinning.obj
    model, bones = obj.dynamorph.model, skinning.bones(skinning.rig) if skinning.rig else []
    if model.hold_head and not model.head and not obj.dynamorph.firmness_group and len(bones) >= CHARACTER:
        yield Problem(
            "No head was found on '{name}': select its bones in Pose Mode and press Hold Selected Bones, or turn Hold "
            "Head off if there is none",
            "NO_HEAD",
            name=obj.name,
        )


def rebuilt(obj: bpy.types.Object) -> str:
    """Which parts of the model of `obj` the next build makes again, where that is out of date; otherwise ''."""
    return REBUILT.get(staleness.part_to_build(obj), "") if staleness.model_age(obj) else ""


def verdict(obj: bpy.types.Object) -> judge.Verdict | None:
    """That on the bake; None without one that can be read."""
    try:
        return judge.parsed(obj.dynamorph.bake.verdict)
    except RecordError:
        return None


def texts(obj: bpy.types.Object, said: Set[str]) -> Iterator[str]:
    """What is out of date, what stopped Live, and the warnings of the last build and bake.

    said: the problems. What could not be compared because of one is not also out of date because of it.
    """
    model, bake = obj.dynamorph.model, obj.dynamorph.bake
    if checks.outgrown(obj):
        yield checks.outgrown(obj)
    if live.is_on(obj) and live.problem(obj):
        yield live.problem(obj)
    if live.is_on(obj):
        yield from live.played_texts(obj)
    if comparison.is_plain(obj):
        yield "Plain skinning is shown: the soft skin stays hidden until you press Show Soft Skin or save"
    ages = dict.fromkeys((*staleness.model_age(obj), *staleness.outdated(obj)))
    reasons = [reason for reason in ages if reason not in said]
    if reasons and not remembered.work.running:  # while a job runs they are outdated themselves
        more = len(reasons) - MOST_REASONS
        text = "Out of date: {reasons}, and {count} more" if more > 0 else "Out of date: {reasons}"
        outdated = Message(text, reasons=joined(", ", reasons[:MOST_REASONS]), count=more)
        yield joined(". ", [text for text in (outdated, rebuilt(obj)) if text])
    found = verdict(obj)
    in_result = (found.text, *found.contact_texts) if found else ()
    for warning in filter(None, (*model.warnings.split("\n"), *bake.warnings.split("\n"))):
        if not warning.startswith(in_result):
            yield warning
