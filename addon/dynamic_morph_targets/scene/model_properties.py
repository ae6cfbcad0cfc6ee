# SPDX-License-Identifier: GPL-3.0-or-later
"""What the artist authored about the model and its attachments, stored on the Object."""

from __future__ import annotations

from dataclasses import fields

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty
from bpy.types import PropertyGroup

from ..core.settings import METHODS, ModelSettings
from . import events
from .events import shown_changed
from .references import OVERRIDE


def _is_other_mesh(chosen, obj) -> bool:
    return obj.type == "MESH" and obj != chosen.id_data


def _cage_chosen(model, _context):
    if model.content_id:
        events.emit(events.Event.CAGE_CHANGED)


def _choice_made(piece, _context):
    if piece.reason:
        piece.reason = ""


class DynamorphPiece(PropertyGroup):
    """Eyes, teeth, clothes: another mesh object, or a part of this mesh or of that one. `name` is what it was called
    when found.
    """

    object: PointerProperty(
        name="Object", description="Another mesh on the same armature; none for a part of this mesh",
        type=bpy.types.Object, poll=_is_other_mesh, override=OVERRIDE,
    )  # fmt: skip
    group: StringProperty(
        name="Vertex Group", description="Of a part of the mesh: its vertices have a weight of a half or more",
        override=OVERRIDE,
    )  # fmt: skip
    choice: EnumProperty(
        name="Attached By",
        description="What moves the attachment",
        items=(
            ("WITH_BODY", "With Body", "The soft tissue that it is in, or nearest to, carries it along", 0),
            ("OWN_CAGE", "Own Cage", "It is simulated by itself, in a cage of its own", 1),
            ("RIGID", "Rigid", "Its bones alone", 2),
            (
                "HELD", "Held",
                "It is as hard as bone, in one cage with the soft skin that it touches: their seam stays closed",
                3,
            ),
        ),
        default="WITH_BODY", override=OVERRIDE, update=_choice_made,
    )  # fmt: skip
    reason: StringProperty(
        name="Reason", description="Why the attachment was listed so. It is empty where the artist has chosen",
        override=OVERRIDE,
    )  # fmt: skip


class DynamorphModel(PropertyGroup):
    """How the model of an object is built, and what came of it."""

    method: EnumProperty(
        name="Method",
        description="What the targets do to the flesh",
        items=tuple((method, *texts) for method, texts in METHODS.items()),
        default=ModelSettings.method, override=OVERRIDE,
    )  # fmt: skip
    law: EnumProperty(
        name="Law",
        description="How the flesh resists deformation",
        items=(
            ("LINEAR", "Linear", "Fastest; good for small jiggle, swells when it rotates far"),
            ("STVK", "StVK", "St. Venant-Kirchhoff: right under large rotations, may stay inverted after a hard stop"),
            ("STABLE_STVK", "Stable StVK", "As StVK, and recovers from any compression"),
        ),
        default=ModelSettings.law,
        override=OVERRIDE,
    )  # fmt: skip
    solver: EnumProperty(
        name="Solver",
        description="How many degrees of freedom are simulated",
        items=(
            ("REDUCED", "Reduced", "A few characteristic modes: fast"),
            ("FULL", "Full", "Every node of the cage: slow, the reference"),
        ),
        default=ModelSettings.solver,
        override=OVERRIDE,
    )  # fmt: skip
    blending: EnumProperty(
        name="Blending",
        description="What happens halfway between two targets",
        items=(
            ("FORCES", "Forces", "The forces are blended: the stiffer target's shape dominates"),
            ("EVEN", "Even", "Halfway in pose is halfway in shape, whatever the stiffness"),
        ),
        default=ModelSettings.blending, override=OVERRIDE,
    )  # fmt: skip
    modes: IntProperty(
        name="Modes", description="How many displacement modes the reduced solver uses",
        default=ModelSettings.modes, min=1, max=200, soft_min=5, soft_max=40,
        override=OVERRIDE,
    )  # fmt: skip
    fit_to_shot: BoolProperty(
        name="Fit Modes to Shot",
        description="Choose the modes from how the shot moves when the model is built: as accurate with far fewer of "
        "them. The model then suits other shots less; build it again for each",
        default=ModelSettings.fit_to_shot, override=OVERRIDE,
    )  # fmt: skip
    cage_nodes: IntProperty(
        name="Cage Nodes", description="About how many nodes the simulated cage of tetrahedra has",
        default=ModelSettings.cage_nodes, min=50, max=200_000, soft_max=20_000,
        override=OVERRIDE,
    )  # fmt: skip
    cage_thickness: FloatProperty(
        name="Cage Thickness",
        description="How far the cage stands off the skin at least. It does so anyway by about a tenth of the size of "
        "its tetrahedra",
        default=ModelSettings.cage_thickness, min=0.0, soft_max=0.1, subtype="DISTANCE", override=OVERRIDE,
    )  # fmt: skip
    cage_grading: FloatProperty(
        name="Cage Grading",
        description="How much finer the cage is where targets move the skin, at the expense of the rest: for sculpts "
        "of small detail. 0: the same everywhere, which is best for how flesh swings",
        default=ModelSettings.cage_grading, min=0.0, max=1.0, subtype="FACTOR", override=OVERRIDE,
    )  # fmt: skip
    cage_object: PointerProperty(
        name="Cage Object",
        description="Closed mesh around the skin in rest pose, as it is when the scene starts, to be filled with "
        "tetrahedra instead of the automatic cage",
        type=bpy.types.Object, poll=_is_other_mesh, update=_cage_chosen, override=OVERRIDE,
    )  # fmt: skip
    pin_radius: FloatProperty(
        name="Bone Pinning",
        description="How far from a bone to the skin the flesh is held by the bone: 0 only at the bone",
        default=ModelSettings.pin_radius, min=0.0, max=0.95, subtype="FACTOR",
        override=OVERRIDE,
    )  # fmt: skip
    separate: BoolProperty(
        name="Split Touching Parts",
        description="Cut the cage where it joins parts of the skin that merely touch, such as an arm and the side it "
        "hangs at, so that they move by themselves",
        default=ModelSettings.separate, override=OVERRIDE,
    )  # fmt: skip
    hold: EnumProperty(
        name="Hold",
        description="What holds the soft tissue against the skeleton",
        items=(
            ("BONES", "Bones", "What is near a bone is fixed to it; see Bone Pinning", 0),
            ("THICKNESS", "Thickness", "The core of the body and its thin parts are held, wherever its bones are", 1),
        ),
        default=ModelSettings.hold, override=OVERRIDE,
    )  # fmt: skip
    one_cage: BoolProperty(
        name="One Cage",
        description="Simulate the meshes that are With Body together with this one, in a cage around all of them, so "
        "that their seams stay closed",
        default=ModelSettings.one_cage, override=OVERRIDE,
    )  # fmt: skip
    hold_head: BoolProperty(
        name="Hold Head",
        description="Hold the skin of the head as if it were bone, less and less along the neck. What is painted in "
        "the Soft group stays soft",
        default=ModelSettings.hold_head, override=OVERRIDE,
    )  # fmt: skip
    head: StringProperty(name="Head", description="Bone of the head that was found when the attachments were")
    vertices: IntProperty(name="Vertices", description="Of the mesh when the model was built")
    cage: StringProperty(name="Cage", description="What the cage of the model is made of")
    built: StringProperty(name="Built With", description="The settings of the built model, as JSON")
    content_id: StringProperty(name="Model Id", description="Hash of the model; the name of its file if it has one")
    summary: StringProperty(name="Result", description="What the last build made")
    warnings: StringProperty(name="Warnings", description="Of the last build, a line each")
    stale: StringProperty(name="Out of Date", description="Why the model must be built again, as the mesh says")

    def settings(self) -> ModelSettings:
        """As the panels show them: lengths in Blender units."""
        return ModelSettings(**{field.name: getattr(self, field.name) for field in fields(ModelSettings)})


class DynamorphMode(PropertyGroup):
    """One displacement mode of the built model, as the artist wants to see it."""

    gain: FloatProperty(
        name="Gain", description="Factor on this mode's motion about the targets' shapes, in Live and in the next bake",
        default=1.0, min=0.0, max=10.0, soft_max=2.0, override=OVERRIDE, update=shown_changed,
    )  # fmt: skip
    solo: BoolProperty(
        name="Solo", description="Show only the solo modes while Live plays", override=OVERRIDE, update=shown_changed
    )
