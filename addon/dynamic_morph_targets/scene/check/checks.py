# SPDX-License-Identifier: GPL-3.0-or-later
"""What prevents a mesh from being simulated, and what looks unintended, as data. Reads only.

`problems`, `next_steps` and `notes` take a fraction of a millisecond, so a panel calls them whenever it draws.
`data_checks` read points, weights or poses, when a soft skin is added or built. `write/authoring/fixes` has the fixes.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite

import bpy

from ...core.message import Message
from .. import animation
from ..references import is_armature, rig_of
from ..remembered import opened
from ..skin import attached_meshes, cache_modifier, edited_elsewhere, soft_skins
from ..skinning import Skinning, armature_for
from . import animation_checks, modifier_order
from .problem import Problem, refuse

DEFORMING = {
    "CAST", "CLOTH", "CORRECTIVE_SMOOTH", "CURVE", "DISPLACE", "HOOK", "LAPLACIANDEFORM", "LAPLACIANSMOOTH", "LATTICE",
    "MESH_CACHE", "MESH_DEFORM", "MESH_SEQUENCE_CACHE", "SHRINKWRAP", "SIMPLE_DEFORM", "SMOOTH", "SOFT_BODY",
    "SURFACE_DEFORM", "VOLUME_DISPLACE", "WARP", "WAVE",
}  # fmt: skip


# At every draw -----------------------------------------------------------------------------------------------------


def problems(obj: bpy.types.Object) -> Iterator[Problem]:
    """What prevents a mesh, or its `Skinning`, from being simulated, in the order in which an artist would fix it."""
    skinning = Skinning.of(obj)
    yield from mesh(skinning.obj)
    missing = list(skinning_problems(skinning))
    yield from missing
    if not missing:
        yield from modifier_order.problems(skinning)
        for modifier in skinning.modifiers:
            yield from _modifier(skinning.obj, modifier)
        for armature in dict.fromkeys((skinning.rig, *(modifier.object for modifier in skinning.modifiers))):
            if armature == skinning.rig or skinning.bones(armature):  # another one has no part in this skin
                yield from armature_state(armature)
                yield from _bones(skinning, armature)
    yield from _keys(skinning.obj)
    yield from left_with_another(skinning)


def left_with_another(skinning: Skinning) -> Iterator[Problem]:
    """The attachments of a copy that stayed with the body it was copied from."""
    for other, owner in of_others(skinning):
        yield Problem(
            "'{name}' belongs to '{owner}': leave it there, or delete '{body}' and duplicate all of '{owner}'",
            "LEAVE_ATTACHMENTS",
            name=other.name,
            owner=owner.name,
            body=skinning.obj.name,
        )


def of_others(skinning: Skinning) -> Iterator[tuple[bpy.types.Object, bpy.types.Object]]:
    """Meshes that are listed as attachments of a soft skin, but belong to another body, with that: which they follow,
    or whose armature moves them, or from which the first was copied, by its name ("Arm.001").
    """
    meshes = attached_meshes(skinning.obj)
    bodies = [body for body in soft_skins(bpy.data.objects) if body.users_scene] if meshes else []
    for other in meshes:
        sharing = [body for body in bodies if other in attached_meshes(body)]
        if len(sharing) < 2:
            continue
        moving = [body for body in sharing if rig_of(body) == rig_of(other)] or sharing
        if skinning.obj in moving:
            moving = [body for body in moving if body.name.partition(".")[0] == skinning.obj.name.partition(".")[0]]
        first = min(moving, key=lambda body: body.session_uid)
        owner = other.dynamorph.follows if other.dynamorph.follows in sharing else first
        if owner != skinning.obj:
            yield other, owner


def next_steps(obj: bpy.types.Object) -> Iterator[Problem]:
    """What a soft skin lacks before it can be built. The neutral target alone is enough, except for Static."""
    if len(active_targets(obj)) >= 2 or obj.dynamorph.model.method != "STATIC":
        return
    if len(obj.dynamorph.targets) > 1:
        yield Problem(
            "'{name}': all targets are muted, so nothing moves with the Method Static: unmute one, or choose the "
            "Method Dynamic",
            name=obj.name,
        )
    else:
        yield Problem(
            "'{name}' has no targets, so nothing moves with the Method Static: add a target, or choose the Method "
            "Dynamic",
            name=obj.name,
        )


def hints(obj: bpy.types.Object) -> Iterator[str]:
    """Suggestions for an artist who looks at the targets."""
    if len(obj.dynamorph.targets) == 1:
        yield (
            "The body is soft without targets. A target changes its shape and stiffness in a pose: pose the armature, "
            "and press New from Pose"
        )


def notes(obj: bpy.types.Object) -> Iterator[Problem]:
    """What does not prevent a simulation of a mesh, or its `Skinning`, but will be ignored or will hide its result."""
    skinning = Skinning.of(obj)
    obj = skinning.obj
    for modifier in skinning.modifiers[-1:]:
        for before in modifier_order.before(obj, modifier):
            if before.type in DEFORMING and before != cache_modifier(obj):
                yield Problem(
                    "'{name}': modifier '{modifier}' before the Armature is not simulated",
                    name=obj.name,
                    modifier=before.name,
                )
    yield from animation_checks.standing_drivers(obj, [modifier.object for modifier in skinning.modifiers])
    yield from animation_checks.keyed_settings(obj)
    read = opened.read_poses.get(obj.session_uid)
    if read and read.found and obj.dynamorph.bake.exists:
        yield Problem(read.found)
    if skinning.beyond_bones:
        yield Problem(
            "'{name}' is skinned with {reason}, which takes longer to bake and to play than plain bones",
            name=obj.name,
            reason=skinning.beyond_bones,
        )
    for mover in animation.rigid_bodies(skinning):
        text = "'{name}' moves with '{mover}', which Rigid Body moves: bake that to keyframes (Object > Rigid Body)"
        yield Problem(text, name=obj.name, mover=mover)
    if not obj.override_library:  # which shares the linked mesh, and does not move with it
        yield from shared_mesh(obj)
    keys = obj.data.shape_keys
    for block in keys.key_blocks if keys else ():
        if not isfinite(block.value) and not block.mute:
            yield Problem(
                "'{name}': the value of shape key '{key}' is not a number, so Blender cannot show the mesh: set it "
                "again",
                name=obj.name,
                key=block.name,
            )
    sculpting = obj.dynamorph.sculpt.active and obj.mode != "OBJECT"  # which shows that key alone on purpose
    if obj.show_only_shape_key and not sculpting:
        yield Problem(
            "'{name}' shows only its active shape key: unpin it (Shape Keys panel) to see the bake",
            "UNPIN",
            name=obj.name,
        )


def outgrown(obj: bpy.types.Object) -> str:
    """A message if the mesh was edited since its model was built, judging by the number of vertices; otherwise ''."""
    model, count = obj.dynamorph.model, len(obj.data.vertices)
    if not model.content_id or model.vertices in (0, count):
        return ""
    return Message(
        "'{name}' has {count} vertices now, its model was built for {expected}. Targets and settings are kept: build "
        "the model again",
        name=obj.name,
        count=count,
        expected=model.vertices,
    )


def shared_mesh(obj: bpy.types.Object) -> Iterator[Problem]:
    """Yields nothing when `obj` is the only user of its mesh."""
    users = obj.data.users - obj.data.use_fake_user
    if users > 1:
        yield Problem(
            "Mesh '{name}' is shared by {count} objects, which would all move alike: make it single-user (Object > "
            "Relations > Make Single User > Object & Data)",
            "SINGLE_USER",
            name=obj.data.name,
            count=users,
        )


def attachment_problems(of_body: Skinning, of_attachment: Skinning) -> Iterator[Problem]:
    """What prevents one mesh object from moving with the soft skin of the other."""
    obj, other, armature, body = of_body.obj, of_attachment.obj, of_body.rig, of_body.obj.name
    if other.type != "MESH":
        text = "'{name}' is no mesh, or its library is missing: restore that, or remove it from the Attachments"
        yield Problem(text, name=other.name)
        return
    if other == obj:
        yield Problem("'{body}' cannot be attached to itself: remove it from the Attachments", body=body)
    elif not of_attachment.modifiers:
        text = "'{name}' has no Armature modifier with an armature: skin it to '{armature}', or choose Rigid"
        yield Problem(text, name=other.name, armature=armature.name)
    elif of_attachment.modifier_of(armature) is None:
        text = "'{name}' is moved by another armature: choose '{armature}' in its Armature modifier, or Rigid"
        yield Problem(text, name=other.name, armature=armature.name)
    if other.dynamorph.targets:
        yield Problem("'{name}' is a soft skin of its own: choose Own Cage", name=other.name)
    elif other.dynamorph.follows not in (None, obj) and other.dynamorph.follows.users_scene:
        owner = other.dynamorph.follows.name
        yield Problem(
            "'{name}' follows '{other}': delete the bake of that soft skin first, or turn its Live off",
            name=other.name,
            other=owner,
        )
    if of_attachment.modifiers:
        for problem in modifier_order.problems(of_attachment):
            yield Problem(problem.text)
    if other.mode == "EDIT":
        yield Problem("'{name}' is in Edit Mode: leave it first", name=other.name)
    if not other.data.vertices:
        yield Problem(
            "Mesh '{mesh}' has no vertices: remove '{name}' from the Attachments",
            mesh=other.data.name,
            name=other.name,
        )
    keys = other.data.shape_keys
    if keys and not keys.use_relative:
        yield Problem("'{name}' uses absolute shape keys: turn on Relative in the Shape Keys panel", name=other.name)
    bound = next((m for m in other.modifiers if follows_by(m, obj)), None)
    if bound:
        yield Problem(
            "'{name}' follows '{body}' by its modifier '{modifier}' already: choose Rigid",
            name=other.name,
            body=body,
            modifier=bound.name,
        )


def follows_by(modifier: bpy.types.Modifier, obj: bpy.types.Object) -> bool:
    """Whether a modifier moves its mesh with `obj`, which one that takes weights from it does not."""
    followed = getattr(modifier, "target", None), getattr(modifier, "object", None)
    return modifier.show_viewport and modifier.type in DEFORMING and obj in followed


def active_targets(obj: bpy.types.Object) -> list:
    """The neutral target and those that are not muted."""
    return [target for i, target in enumerate(obj.dynamorph.targets) if i == 0 or not target.mute]


def no_mesh(obj: bpy.types.Object) -> Iterator[Problem]:
    """Yields nothing when `obj` is a mesh object."""
    if obj is None or obj.type != "MESH":
        name = obj.name if obj else "Nothing"
        yield Problem("'{name}' is not a mesh: select the character's mesh object", name=name)


def mesh(obj: bpy.types.Object) -> Iterator[Problem]:
    """Yields nothing when `obj` has a surface, and is not being edited."""
    if obj.mode == "EDIT":
        yield Problem("'{name}' is in Edit Mode: leave it first", "LEAVE_EDIT_MODE", name=obj.name)
    elif obj.data.is_editmode:
        yield Problem(edited_elsewhere(obj))
    elif not obj.data.polygons:
        yield Problem("Mesh '{name}' has no faces: model some, or choose the right object", name=obj.name)


def _modifier(obj: bpy.types.Object, modifier: bpy.types.Modifier) -> Iterator[Problem]:
    if not modifier.show_viewport:
        yield Problem(
            "'{name}': Armature modifier '{modifier}' is disabled in viewports: enable it",
            "ENABLE_MODIFIER",
            name=obj.name,
            modifier=modifier.name,
        )
    if modifier.use_bone_envelopes or not modifier.use_vertex_groups:
        yield Problem(
            "'{name}' is skinned by bone envelopes: in Armature modifier '{modifier}' turn Bone Envelopes off and "
            "Vertex Groups on",
            "ENVELOPES",
            name=obj.name,
            modifier=modifier.name,
        )


def armature_state(armature: bpy.types.Object) -> Iterator[Problem]:
    """Whether the armature shows its pose."""
    name = armature.name
    if armature.mode == "EDIT":
        yield Problem("Armature '{name}' is in Edit Mode: leave it first", "LEAVE_EDIT_MODE", name=name)
    if armature.data.pose_position == "REST":
        yield Problem(
            "Armature '{name}' is shown in rest position: choose Pose Position in its Data tab",
            "POSE_POSITION",
            name=name,
        )
    if armature.hide_viewport:
        yield Problem(
            "Armature '{name}' is disabled in viewports, so Blender does not move it: enable it",
            "ENABLE_ARMATURE",
            name=name,
        )


def _bones(skinning: Skinning, armature: bpy.types.Object) -> Iterator[Problem]:
    """For each kind of problem only the first bone, because its fix repairs all of them."""
    bones = skinning.bones(armature)
    if not bones:
        yield Problem(
            "'{name}' has no vertex group named after a deforming bone of '{armature}': weight it first",
            name=skinning.obj.name,
            armature=armature.name,
        )
        return
    multiplied = next((bone for bone in bones if bone.use_envelope_multiply), None)
    if multiplied:
        yield Problem(
            "Bone '{bone}' of '{armature}': turn off Envelope Multiply in its Deform panel",
            "ENVELOPE_MULTIPLY",
            bone=multiplied.name,
            armature=armature.name,
        )
    lengths = [bone.length for bone in bones]
    if min(lengths) <= 1e-5 * max(lengths):
        point = bones[lengths.index(min(lengths))]
        yield Problem(
            "Bone '{bone}' of '{armature}' has no length: move its tail, or turn off its Deform",
            bone=point.name,
            armature=armature.name,
        )


def _keys(obj: bpy.types.Object) -> Iterator[Problem]:
    keys = obj.data.shape_keys
    targets = active_targets(obj)
    if keys is None:
        if len(targets) > 1:  # a bake, like Add Soft Skin, makes the Basis that it needs
            yield Problem("'{name}' has no shape keys: add a Basis and one key per target", "ADD_BASIS", name=obj.name)
        return
    if not keys.use_relative:
        yield Problem(
            "'{name}' uses absolute shape keys: turn on Relative in the Shape Keys panel",
            "RELATIVE_KEYS",
            name=obj.name,
        )
    count = len(obj.data.vertices)
    for block in keys.key_blocks:
        if len(block.points) != count:  # by a script: Blender itself keeps them alike
            yield Problem(
                "'{name}': shape key '{key}' has {points} points and the mesh {count} vertices: enter Edit Mode and "
                "leave it, or delete the key",
                name=obj.name,
                key=block.name,
                points=len(block.points),
                count=count,
            )
            break
    for target in targets[1:]:
        if target.name not in keys.key_blocks:
            yield Problem(
                "'{name}': the shape key of target '{target}' is gone: remove the target",
                name=obj.name,
                target=target.name,
            )
        elif keys.key_blocks[target.name] == keys.reference_key:
            yield Problem(
                "'{name}': target '{target}' has become the Basis, which moves nothing: put a Basis above it in the "
                "Shape Keys panel, or remove the target",
                name=obj.name,
                target=target.name,
            )


# What others ask for ------------------------------------------------------------------------------------------------


def skinned(obj: bpy.types.Object) -> Skinning:
    """How the mesh object `obj` is skinned. Raises SceneError unless an armature skins it."""
    refuse(no_mesh(obj))
    skinning = Skinning.of(obj)
    refuse(skinning_problems(skinning))
    return skinning


def armature_modifier(obj: bpy.types.Object) -> bpy.types.Modifier:
    """The Armature modifier whose armature places the targets of `obj`. Raises SceneError."""
    return skinned(obj).modifier


def check_mesh(obj: bpy.types.Object) -> None:
    """Raises SceneError about a mesh that has no surface, or is being edited."""
    refuse(mesh(obj))


def skinning_problems(skinning: Skinning) -> Iterator[Problem]:
    """Yields nothing when there is an Armature modifier with an armature."""
    obj = skinning.obj
    if is_armature(obj.parent) and obj.parent_type == "ARMATURE" and skinning.modifiers:
        text = "'{name}' is deformed twice, by its parent and by its Armature modifier: set Parent Type to Object"
        yield Problem(text, "PARENT_OBJECT", name=obj.name)
    elif not skinning.modifiers:
        yield Problem(
            "'{name}' has no Armature modifier with an armature: add one, or parent the mesh to it",
            "ADD_ARMATURE" if armature_for(obj) else "",
            name=obj.name,
        )


def rig(skinning: Skinning) -> Iterator[Problem]:
    """Whether Blender skins a mesh as it will be simulated: the Armature modifier, its armature and its bones."""
    yield from _modifier(skinning.obj, skinning.modifier)
    yield from armature_state(skinning.rig)
    yield from _bones(skinning, skinning.rig)
