# SPDX-License-Identifier: GPL-3.0-or-later
"""What the artist authored about the model and its attachments, stored on the Object."""

from __future__ import annotations

from dataclasses import fields

import bpy
from bpy.types import PropertyGroup

from ...core.firmness import NEUTRAL
from ...core.settings import METHODS, ModelSettings
from ..events import Event, emit, mesh_changed, shown_changed
from ..keyless import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty
from ..references import OVERRIDE

CONTEXT = "Dynamorph"  # of translations: words that mean something else in Blender, where Hold is to stop
QUALITIES = (
    (
        "AUTOMATIC", "Automatic",
        "Live is Reduced. Bakes are too, except those of a body that collides: they are Full, for accurate dents",
        0,
    ),
    ("REDUCED", "Reduced", "Simulates a few characteristic modes, which is fast. Dents are coarse", 1),
    (
        "FULL", "Full",
        "Simulates every node of the cage, with all ripples. It takes much longer and needs no other build",
        2,
    ),
)  # fmt: skip


def _is_other_mesh(chosen: DynamorphAttachment | DynamorphModel, obj: bpy.types.Object) -> bool:
    return obj.type == "MESH" and obj != chosen.id_data


def _choice_made(attachment: DynamorphAttachment, _context: bpy.types.Context) -> None:
    if attachment.reason:
        attachment.reason = ""


def _part_set(part: DynamorphPart, _context: bpy.types.Context) -> None:
    emit(Event.PART_SET, part.id_data, part.name, part.firmness)


class DynamorphPart(PropertyGroup):
    """A soft part of the body, by its `name`."""

    firmness: FloatProperty(
        name="Firmness",
        description="How firm this part of the body is, on both sides: 0 is softest, 0.5 unchanged, and 1 held by the "
        "bones. It shifts the Firmness map there, which you can go on painting",
        default=NEUTRAL, min=0.0, max=1.0, subtype="FACTOR", override=OVERRIDE, update=_part_set,
    )  # fmt: skip


class DynamorphAttachment(PropertyGroup):
    """Eyes, teeth or clothes: another mesh object, or a part of this mesh or of the other one. `name` is the name it
    had when it was found.
    """

    object: PointerProperty(
        name="Object", description="Another mesh on the same armature. Leave it empty for a part of this mesh",
        type=bpy.types.Object, poll=_is_other_mesh, override=OVERRIDE,
    )  # fmt: skip
    group: StringProperty(
        name="Vertex Group",
        description="Limits the attachment to the vertices that have a weight of 0.5 or more in this group",
        override=OVERRIDE,
    )  # fmt: skip
    attached_by: EnumProperty(
        name="Attached By",
        description="What moves the attachment",
        items=(
            ("WITH_BODY", "With Body", "It is simulated in the cage of the body, so that the seam stays closed", 0),
            ("OWN_CAGE", "Own Cage", "It is simulated separately, in its own cage", 1),
            ("RIGID", "Rigid", "Only its bones move it", 2),
            (
                "HELD", "Held",
                "It is as hard as bone, in the cage of the soft skin that it touches, so that the seam stays closed",
                3,
            ),
        ),
        default="WITH_BODY", override=OVERRIDE, update=_choice_made,
    )  # fmt: skip
    reason: StringProperty(
        name="Reason", description="Why the attachment was listed this way. It is empty if the artist has chosen",
        override=OVERRIDE,
    )  # fmt: skip


def _get_quality(model: DynamorphModel) -> int:
    if model.solver == "FULL":
        return 2
    return 0 if model.id_data.dynamorph.collision.bake_full else 1


def _set_quality(model: DynamorphModel, number: int) -> None:
    quality = QUALITIES[number][0]
    if quality != "FULL":
        model.id_data.dynamorph.collision.bake_full = quality == "AUTOMATIC"
    model.solver = "FULL" if quality == "FULL" else "REDUCED"


class DynamorphModel(PropertyGroup):
    """How the model of an object is built, and what came of it."""

    method: EnumProperty(
        name="Method",
        description="What the targets do to the soft tissue. Change it only to see what one of their effects does",
        items=tuple((method, *texts, number) for number, (method, texts) in enumerate(METHODS.items())),
        default=ModelSettings.method, override=OVERRIDE,
    )  # fmt: skip
    material_model: EnumProperty(
        name="Material Model",
        description="How the soft tissue resists deformation. Stable suits every body; the others are for comparisons",
        items=(
            ("LINEAR", "Linear", "Fastest. Good for small jiggle, but it swells when it rotates far", 0),
            (
                "STVK", "StVK",
                "St. Venant-Kirchhoff. Right under large rotations, but may stay inverted after a hard stop",
                1,
            ),
            ("STABLE_STVK", "Stable", "Right under large rotations, and it recovers from any compression", 2),
        ),
        default=ModelSettings.material_model,
        override=OVERRIDE,
    )  # fmt: skip
    solver: EnumProperty(
        name="Quality",
        description="How accurately the motion is simulated, in bakes and in Live. Choose Full for the final bake of a "
        "shot in which ripples matter",
        items=tuple((*texts, number) for number, (*texts, _) in enumerate(QUALITIES[1:])),
        default=ModelSettings.solver, override=OVERRIDE, update=shown_changed,
    )  # fmt: skip
    quality: EnumProperty(
        name="Quality",
        description="How accurately the motion is simulated, in bakes and in Live. Choose Full for the final bake of a "
        "shot in which ripples matter, or Reduced to bake exactly what Live shows",
        items=QUALITIES, get=_get_quality, set=_set_quality, options={"SKIP_SAVE"}, override=OVERRIDE,
    )  # fmt: skip
    blending: EnumProperty(
        name="Between Targets",
        description="How the skin looks halfway between two targets. Choose Stiffer Wins if a hard muscle must keep "
        "its shape",
        items=(
            ("FORCES", "Stiffer Wins", "The forces are blended, so the stiffer target's shape dominates", 0),
            ("EVEN", "Halfway Shape", "Halfway in pose is halfway in shape, whatever the stiffness", 1),
        ),
        default=ModelSettings.blending, override=OVERRIDE,
    )  # fmt: skip
    modes: IntProperty(
        name="Detail (Modes)",
        description="Number of displacement modes that Reduced Quality simulates, and the most keys that a Full "
        "Quality bake may have. Choose 120 for a whole body with bone responses. Without them, choose 20 for a limb; "
        "more than 40 are slow",
        default=ModelSettings.modes, min=1, max=400, soft_min=5, soft_max=240,
        override=OVERRIDE,
    )  # fmt: skip
    basis: EnumProperty(
        name="Modes From",
        description="Which modes Reduced Quality uses. Choose Vibration for a single limb",
        items=(
            (
                "MODES", "Vibration",
                "Vibration modes and how they bend, all in full detail. Best for a limb, with few modes",
                0,
            ),
            (
                "RESPONSES", "Bones",
                "What each bone does to the soft tissue: the largest part in full detail and the rest "
                "linearly. Best for whole bodies, with many modes",
                1,
            ),
        ),
        default=ModelSettings.basis, override=OVERRIDE,
    )  # fmt: skip
    fit_to_shot: BoolProperty(
        name="Fit Modes to Shot",
        description="Fit vibration modes to the motion of the shot when the model is built. Far fewer modes are then "
        "as accurate, but the model suits other shots less: build it again for each shot. Turn it on for a limb with "
        "few modes. Modes from bones, which are more accurate still, are not fitted",
        default=ModelSettings.fit_to_shot, override=OVERRIDE,
    )  # fmt: skip
    cage_nodes: IntProperty(
        name="Cage Nodes",
        description="Approximate number of nodes of the simulated cage of tetrahedra. More nodes follow the body more "
        "closely and take longer to build. Raise it for slim parts and small sculpts",
        default=ModelSettings.cage_nodes, min=50, max=200_000, soft_max=20_000,
        override=OVERRIDE,
    )  # fmt: skip
    cage_object: PointerProperty(
        name="Cage Object",
        description="Closed mesh that encloses the skin in rest pose when the scene starts. It is filled with "
        "tetrahedra and replaces the automatic cage. Choose one if the automatic cage encloses the wrong parts",
        type=bpy.types.Object, poll=_is_other_mesh, update=mesh_changed, override=OVERRIDE,
    )  # fmt: skip
    pin_radius: FloatProperty(
        name="Bone Pinning",
        description="How far the hold of a bone reaches on the way from the bone to the skin. 0 holds the soft tissue "
        "only at the bone. Raise it if the body wobbles too much",
        default=ModelSettings.pin_radius, min=0.0, max=0.95, subtype="FACTOR",
        override=OVERRIDE,
    )  # fmt: skip
    hold: EnumProperty(
        name="Hold", translation_context=CONTEXT,
        description="What holds the soft tissue against the skeleton. Thickness suits every body",
        items=(
            ("BONES", "Bones", "What is near a bone is fixed to it, as far as Bone Pinning says", 0),
            ("THICKNESS", "Thickness", "The core of the body and its thin parts are held, wherever its bones are", 1),
        ),
        default=ModelSettings.hold, override=OVERRIDE,
    )  # fmt: skip
    hold_head: BoolProperty(
        name="Hold Head",
        description="Hold the skin of head, hands and feet as if it were bone, less and less along neck, forearms and "
        "shins. Paint Firmness with 0 where it must stay soft",
        default=ModelSettings.hold_head, override=OVERRIDE,
    )  # fmt: skip
    head: StringProperty(name="Head", description="Bone of the head, found together with the attachments")
    vertices: IntProperty(name="Vertices", description="Number of vertices of the mesh when the model was built")
    cage: StringProperty(name="Cage", description="Size of the cage of the model")
    built: StringProperty(name="Built With", description="The settings of the built model, as JSON")
    content_id: StringProperty(name="Model Id", description="Hash of the model, which is also the name of its file")
    summary: StringProperty(name="Result", description="What the last build made")
    warnings: StringProperty(name="Warnings", description="Warnings of the last build, one per line")
    expected_error: FloatProperty(
        name="Expected Error",
        description="How far the reduced motion of a hop is from that of Full Quality, as a fraction of it",
    )  # fmt: skip
    expected_from: StringProperty(name="Error Of", description="Hash of what the expected error was measured with")
    bounce_reference: FloatProperty(
        name="Bounce Reference",
        description="Undamped frequency in Hz of the neutral body where stiffness over density is 1, measured by the "
        "last build",
        options={"SKIP_SAVE"},
    )  # fmt: skip
    poisson_reference: FloatProperty(
        name="Poisson Reference",
        description="Poisson's ratio of the neutral target at which the bounce reference was measured",
        options={"SKIP_SAVE"},
    )
    stale: StringProperty(name="Out of Date", description="Why a change of the mesh requires another build")
    stale_part: StringProperty(name="Rebuilt From", description="The first part of the model that this build rebuilds")

    def set_reference(self, bounce: float, poisson: float) -> None:
        """Store what the build measured at this Poisson's ratio: Hz, 0 where it could not."""
        self.bounce_reference, self.poisson_reference = bounce, poisson

    def settings(self) -> ModelSettings:
        """As the panels show them."""
        return ModelSettings(**{field.name: getattr(self, field.name) for field in fields(ModelSettings)})


class DynamorphMode(PropertyGroup):
    """One displacement mode of the built model, as the artist wants to see it."""

    gain: FloatProperty(
        name="Amount",
        description="How much of this mode's motion about the targets' shapes is shown, in Live and in the next bake. "
        "Lower it to calm one ripple",
        default=1.0, min=0.0, max=10.0, soft_max=2.0, override=OVERRIDE, update=shown_changed,
    )  # fmt: skip
    solo: BoolProperty(
        name="Solo",
        description="Show only this mode, and others that are solo, while Live plays",
        override=OVERRIDE,
        update=shown_changed,
    )
