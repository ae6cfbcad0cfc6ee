# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes of our own, in which a rig is evaluated without the artist's meshes and without moving the artist's frame."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import bpy

from .. import events, keyed
from ..skinning import Skinning

NAME = ".Dynamorph Sampling"  # Blender hides what begins with a dot in its lists
SHOWN = "shown"  # custom property: Object.session_uid of what was in other scenes, too
UNUSED = 1.0  # seconds after which a scene that is kept is removed
# What places an object that only its parents move; the bone comes after the type, which clears it.
PARENT = ("parent", "parent_type", "parent_bone", "matrix_parent_inverse")
PLACE = ("location", "rotation_euler", "rotation_quaternion", "rotation_axis_angle", "scale", "delta_location",
         "delta_rotation_euler", "delta_rotation_quaternion", "delta_scale")  # fmt: skip


class SamplingScene:
    """A scene with a rig, so that a frame costs what the rig costs; and an object that moves like the mesh object.

    It has the mesh object's parent and place. Where more than parents moves that one, it copies its transform instead:
    then the dependency graph evaluates its constraints and drivers, and not the mesh, but all curves of its shape keys.
    It is empty, or a probe's mesh that is skinned like the body.

    It is made when it is opened and kept until `close`, because making it costs as much as several frames and makes
    Blender rebuild the artist's dependency graph. `remove_kept` removes it too, wherever it would be seen; so does a
    timer when nobody opens it any more. It is made again where it is missing.
    """

    def __init__(self) -> None:
        self._uid = 0  # Scene.session_uid
        self._content: tuple = ()  # what is in it, as `_content_of`

    @contextmanager
    def opened(
        self,
        obj: bpy.types.Object,
        rig: bpy.types.Object,
        probe: Any = None,
        others: Iterable = (),
        watched: Sequence[keyed.Keyed] = (),
    ) -> Iterator[tuple[bpy.types.Scene, bpy.types.Object]]:
        """The scene and the follower, while no handlers run. probe: a `probe.Probe` of `obj`; others: more objects to
        evaluate; watched: settings of `obj` that the follower reads (`keyed.values`). Raises SceneError.
        """
        events.check_not_rendering()
        others = list(others)
        content = *_content_of(obj, rig, probe, others), [each.path for each in watched]
        scene = next((each for each in bpy.data.scenes if each.session_uid == self._uid), None)
        try:
            if scene is None or content != self._content:
                self.close()
                scene = bpy.data.scenes.new(NAME)
                self._uid, self._content = scene.session_uid, content
                _fill(scene, obj, rig, probe, others)
                keyed.watch(_own_objects(scene)[0], obj, watched)
            _keep_as(scene.render, bpy.context.scene.render)
            (follower,) = _own_objects(scene)
            with events.without_handlers():
                yield scene, follower
        except BaseException:
            self.close()
            raise
        events.soon(remove_unused, UNUSED)

    def close(self) -> None:
        """Remove it, if it is there; while Blender renders, a while later."""
        if events.render_runs():
            events.soon(remove_unused, UNUSED)
            return
        _remove(scene for scene in bpy.data.scenes if scene.session_uid == self._uid)
        self._uid = 0


@contextmanager
def rig_scene(
    obj: bpy.types.Object, rig: bpy.types.Object, probe: Any = None
) -> Iterator[tuple[bpy.types.Scene, bpy.types.Object]]:
    """A `SamplingScene` for once. Raises SceneError."""
    once = SamplingScene()
    with once.opened(obj, rig, probe) as made:
        yield made
    once.close()


def remove_unused() -> float | None:
    """By a timer: remove what nobody has opened for a while."""
    if events.render_runs() or events.is_scrubbing():
        return UNUSED  # seconds from now
    remove_kept()
    return None


def remove_kept() -> None:
    """Remove all sampling scenes: before a file is saved, and where undo or a file have brought some back. One that is
    there while Blender renders stays, also in a file that is saved then, and goes when that is opened.
    """
    if events.render_runs():
        return
    # While add-ons are enabled Blender shows them no data.
    _remove(scene for scene in getattr(bpy.data, "scenes", ()) if scene.name.startswith(NAME))


def remove_scene(scene: bpy.types.Scene, *objects: bpy.types.Object) -> None:
    """Remove a scene that no window shows, with objects of its own and their meshes.

    Not by `bpy.data.scenes.remove`: Blender 5.2 crashes in it while the artist scrubs through the frames, when it
    asks which scene the window plays.
    """
    meshes = [each.data for each in objects if each.data]
    bpy.data.batch_remove((scene, *objects, *meshes))


def _content_of(obj: bpy.types.Object, rig: bpy.types.Object, probe: Any, others: Iterable[bpy.types.Object]) -> tuple:
    """To be compared."""
    objects = [each.session_uid for each in (obj, rig, *others)]
    place = _place_of(obj)
    if place and place["parent"]:
        place["parent"] = place["parent"].session_uid
    return objects, probe and (id(probe), Skinning.of(obj).settings()), place


def _place_of(obj: bpy.types.Object) -> dict | None:
    """Values of `PARENT`, `rotation_mode` and `PLACE`; None where more than parents moves the object."""
    animation = obj.animation_data
    if animation and (animation.action or animation.drivers or animation.nla_tracks):
        return None
    if obj.constraints or obj.parent_type not in {"OBJECT", "ARMATURE", "BONE"}:
        return None
    parent = {name: getattr(obj, name) for name in PARENT} | {"rotation_mode": obj.rotation_mode}
    parent["matrix_parent_inverse"] = parent["matrix_parent_inverse"].copy()
    return parent | {name: tuple(getattr(obj, name)) for name in PLACE}


def _fill(
    scene: bpy.types.Scene, obj: bpy.types.Object, rig: bpy.types.Object, probe: Any, others: Iterable[bpy.types.Object]
) -> None:
    """Put everything into a new sampling scene."""
    scene[SHOWN] = [each.session_uid for each in (rig, *others) if each.users]
    follower = bpy.data.objects.new(NAME, probe and probe.mesh())
    if place := _place_of(obj):
        for name, value in place.items():
            setattr(follower, name, value)
    else:
        follower.constraints.new("COPY_TRANSFORMS").target = obj
    if probe:
        probe.dress(follower, obj)
    if any(each.field and each.field.type != "NONE" and each.animation_data for each in others):
        with bpy.context.temp_override(scene=scene):  # an empty one; without, Blender prints an error for each of them
            bpy.ops.rigidbody.world_add()
    for each in dict.fromkeys((rig, follower, *others)):  # the rig may be one of the others
        scene.collection.objects.link(each)


def _own_objects(scene: bpy.types.Scene) -> list:
    """What is in a sampling scene alone: the follower."""
    return [each for each in scene.collection.objects if each.name.startswith(NAME)]


def _keep_as(render: bpy.types.RenderSettings, user: bpy.types.RenderSettings) -> None:
    """Time, and how finely objects are subdivided, are those of the artist's scene. Writes only what differs, because
    writing tags the scene for evaluation.
    """
    for field in ("fps", "fps_base", "frame_map_old", "frame_map_new", "use_simplify", "simplify_subdivision"):
        if getattr(render, field) != getattr(user, field):
            setattr(render, field, getattr(user, field))


def _remove(scenes: Iterable) -> None:
    """Remove sampling scenes; and what the artist has deleted meanwhile, which they kept alive."""
    for scene in list(scenes):
        shown = {*scene.get(SHOWN, ())}
        others = [each for each in scene.collection.objects if each.session_uid in shown]
        remove_scene(scene, *_own_objects(scene))
        bpy.data.batch_remove([each for each in others if not each.users])
