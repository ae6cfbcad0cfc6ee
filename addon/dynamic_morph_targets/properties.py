# SPDX-License-Identifier: GPL-3.0-or-later
"""What the artist authored, stored on the Object as `Object.dynamorph`, and how it follows renames.

Blender gives shape keys no lasting identity and bones only their names, so each reference keeps a second clue: a hash
of the key's shape, the bone's rest matrix. `reconcile` uses it when a name is gone. The settings live on the Object
(not the Key, which vanishes with its last shape key, and not the ShapeKey, which takes no properties).
"""

from __future__ import annotations

import hashlib
import math
from contextlib import contextmanager
from dataclasses import asdict, fields

import bpy
import numpy as np
from bpy.app.handlers import persistent
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)
from bpy.types import PropertyGroup

from . import events, materials
from .scene_data import METHODS, Material, ModelSettings, OutputSettings, Skeleton

NEUTRAL = "Neutral"
OVERRIDE = {"LIBRARY_OVERRIDABLE"}
OVERRIDE_LIST = {"LIBRARY_OVERRIDABLE", "USE_INSERTION"}
IDENTITY = tuple(np.eye(4).ravel())
NEVER = 1e5  # frames: of a swing that nothing damps


# Reading the two things that references point at -------------------------------------------------------------------


def rig_of(obj):
    """The armature object that places the targets of `obj`, or None: of the first Armature modifier that skins it.

    That has a deforming bone with a vertex group; if none has, the first that has an armature.
    """
    rigs = [m.object for m in obj.modifiers if m.type == "ARMATURE" and m.object]
    if len(rigs) < 2:
        return rigs[0] if rigs else None
    groups = set(obj.vertex_groups.keys())
    skins = (rig for rig in rigs if any(bone.use_deform and bone.name in groups for bone in rig.data.bones))
    return next(skins, rigs[0])


def rest_skeleton(armature) -> Skeleton:
    """The armature's bones at rest, parents before children."""
    bones = sorted(armature.bones, key=lambda bone: len(bone.parent_recursive))  # stable: siblings keep their order
    names = tuple(bone.name for bone in bones)
    parents = np.array([names.index(bone.parent.name) if bone.parent else -1 for bone in bones], dtype=np.int64)
    rest = np.array([bone.matrix_local for bone in bones], dtype=np.float64).reshape(-1, 4, 4)
    return Skeleton(names, parents, rest)


def bones_key(armature) -> tuple:
    """The bones' names and where they rest, to be compared."""
    rest = np.empty(16 * len(armature.bones), np.float32)
    armature.bones.foreach_get("matrix_local", rest)
    return tuple(armature.bones.keys()), rest.tobytes()


def key_points(block) -> np.ndarray:
    """The points of a shape key, (V, 3) float32, local space. float32 because Blender then copies in one piece."""
    points = np.empty((len(block.points), 3), np.float32)
    block.points.foreach_get("co", points.ravel())
    return points


def key_hash(block) -> str:
    """Identifies a shape key by what it sculpts, whatever its name or place in the list."""
    return _hash(_key_shape(block))


def basis_hash(blocks) -> str:
    """Tells when the mesh itself was edited, which changes all its shape keys."""
    return _hash(key_points(blocks[0]))


def _hash(points: np.ndarray) -> str:
    return hashlib.blake2b(points.tobytes(), digest_size=8).hexdigest()


def key_reach(block) -> float:
    """How far a shape key moves a point, at most. Unlike the hash it survives an edit of the Basis."""
    return float(np.abs(_key_shape(block)).max(initial=0.0))


def _key_shape(block) -> np.ndarray:
    return key_points(block) - key_points(block.relative_key)


# Property groups ---------------------------------------------------------------------------------------------------


class KeyReference:
    """Mixin: a shape key, found again after a rename. The group's own `name` is the key's name."""

    key_index: IntProperty(name="Key Index", description="Place of the shape key in the list", override=OVERRIDE)
    key_hash: StringProperty(name="Key Hash", description="Identifies the sculpted shape", override=OVERRIDE)

    def refer_to(self, blocks, index: int):
        """Point at `blocks[index]`. Writes only what changed: a write tags the object for evaluation."""
        block = blocks[index]
        for field, value in (("name", block.name), ("key_index", index), ("key_hash", key_hash(block))):
            if getattr(self, field) != value:
                setattr(self, field, value)


KEY_REFERENCE = ("name", *KeyReference.__annotations__)


class DynamorphKey(KeyReference, PropertyGroup):
    """A shape key that a bake added or muted. A key of the bake that is gone leaves a reference without a name."""

    reach: FloatProperty(name="Reach", description="Largest displacement of a key that the bake added")
    was_muted: BoolProperty(name="Was Muted", description="Whether the artist had muted the key before the bake")

    def looks_like(self, block) -> bool:
        return key_hash(block) == self.key_hash or math.isclose(key_reach(block), self.reach, rel_tol=0.01)


class DynamorphBone(PropertyGroup):
    """The name of a bone that places a target in pose space."""


class DynamorphBonePose(PropertyGroup):
    """One bone of a captured pose. Matrices are row after row."""

    rest: FloatVectorProperty(
        name="Rest", description="Rest matrix, to find a renamed bone", size=16, override=OVERRIDE
    )
    local: FloatVectorProperty(
        name="Local", description="Transform relative to the evaluated parent", size=16, override=OVERRIDE
    )


def _seconds_a_frame() -> float:
    render = bpy.context.scene.render
    return render.fps_base / render.fps


def _get_bounce(target) -> float:
    return materials.swing(target.bounce_reference, target.material()).frequency if target.is_measured else 0.0


def _set_bounce(target, frequency: float):
    if target.is_measured:
        target.set_material(materials.with_bounce(target.bounce_reference, target.material(), frequency))
        target.frequency, target.by_hand = frequency, True


def _get_settle(target) -> float:
    if not target.is_measured:
        return 0.0
    return min(materials.swing(target.bounce_reference, target.material()).settle / _seconds_a_frame(), NEVER)


def _set_settle(target, frames: float):
    if target.is_measured:
        target.mass_damping, target.stiffness_damping = materials.damping_for(
            target.bounce_reference, target.material(), frames * _seconds_a_frame()
        )


def _get_weight(target) -> float:
    return target.density * target.volume if target.is_measured else 0.0


def _set_weight(target, weight: float):
    if target.is_measured:
        target.density = weight / target.volume


_computed = False  # whether a stiffness that is written now follows from something else


@contextmanager
def as_computed():
    """What is written to a stiffness meanwhile does not count as set by hand."""
    global _computed
    before, _computed = _computed, True
    try:
        yield
    finally:
        _computed = before


def _stiffness_set(target, _context):
    """update: the artist, or a script, wants the stiffness in pascals as it is."""
    if not _computed:
        target.frequency, target.by_hand = 0.0, True


def _shown_changed(group, _context):
    from . import live  # which looks at what is authored here

    live.refresh(group.id_data)


def _region_chosen(target, _context):
    target.auto_region = False  # `regions.update` sets it again for those that it chooses itself


class DynamorphTarget(KeyReference, PropertyGroup):
    """A dynamic morph target: a shape key, the pose at which the skin takes it, and the elastic properties there.

    The first target of an object is the neutral one; its shape is the Basis.
    """

    mute: BoolProperty(name="Mute", description="Leave this target out of the model", override=OVERRIDE)
    stiffness: FloatProperty(
        name="Stiffness",
        description="Young's modulus at this target, in pascal: fat about 3e3, relaxed muscle 2e4, flexed muscle 2e5",
        default=Material.stiffness, min=1.0, max=1e12, soft_min=1e3, soft_max=1e6, step=10000, precision=0,
        override=OVERRIDE, update=_stiffness_set,
    )  # fmt: skip
    poisson: FloatProperty(
        name="Poisson's Ratio",
        description="How much the flesh keeps its volume: 0 not at all, near 0.5 entirely. Values over 0.4 make "
        "coarse cages too stiff",
        default=Material.poisson, min=0.0, max=0.49, soft_max=0.45, override=OVERRIDE,
    )  # fmt: skip
    density: FloatProperty(
        name="Density",
        description="Mass per volume at this target, in kg/m³: water 1000",
        default=Material.density, min=1.0, max=1e5, soft_min=500.0, soft_max=2000.0, step=1000, precision=0,
        override=OVERRIDE,
    )  # fmt: skip
    mass_damping: FloatProperty(
        name="Mass Damping",
        description="Rayleigh damping in proportion to mass, in 1/s: calms slow, large motion",
        default=Material.mass_damping, min=0.0, max=1e4, soft_max=20.0, override=OVERRIDE,
    )  # fmt: skip
    stiffness_damping: FloatProperty(
        name="Stiffness Damping",
        description="Rayleigh damping in proportion to stiffness, in seconds: calms fast ripples",
        default=Material.stiffness_damping, min=0.0, max=10.0, soft_max=0.1, step=0.1, precision=4, override=OVERRIDE,
    )  # fmt: skip
    radius: FloatProperty(
        name="Radius",
        description="How far from its pose, over all its bones, the target reaches: it has faded out there. 0: as far "
        "as there is no nearer target",
        default=0.0, min=0.0, soft_max=np.pi, subtype="ANGLE", override=OVERRIDE,
    )  # fmt: skip
    influence: FloatProperty(
        name="Influence",
        description="How much of the motion shows in this target's pose, within its region: at 0 there is the sculpted "
        "shape alone",
        default=1.0, min=0.0, max=1.0, subtype="FACTOR", override=OVERRIDE, update=_shown_changed,
    )  # fmt: skip
    region: StringProperty(
        name="Region",
        description="Vertex group that the target is limited to. The targets of a region form a set of their own, with "
        "the neutral target at rest: they do not compete with those of the rest of the body",
        override=OVERRIDE, update=_region_chosen,
    )  # fmt: skip
    auto_region: BoolProperty(
        name="Automatic Region",
        description="Whether the region is made from what is sculpted, together with the targets that share a bone "
        "with this one. A region that you choose or paint stays as it is",
        override=OVERRIDE,
    )  # fmt: skip
    made_region: StringProperty(
        name="Region As Made", description="Hash of the automatic region's weights, to tell whether they were painted",
        options={"SKIP_SAVE"}, override=OVERRIDE,
    )  # fmt: skip
    bones: CollectionProperty(
        name="Bones", description="Bones whose rotations decide when the target applies", type=DynamorphBone,
        override=OVERRIDE_LIST,
    )  # fmt: skip
    auto_bones: BoolProperty(
        name="Automatic Bones",
        description="Whether Finish Sculpting chooses the bones, by what is sculpted. Bones that you choose stay",
        override=OVERRIDE,
    )  # fmt: skip
    pose: CollectionProperty(
        name="Pose", description="The captured pose of every bone", type=DynamorphBonePose, override=OVERRIDE_LIST
    )
    rig_world: FloatVectorProperty(
        name="Armature Transform", description="World transform of the armature when the pose was captured",
        size=16, default=IDENTITY, override=OVERRIDE,
    )  # fmt: skip

    frequency: FloatProperty(
        name="Frequency",
        description="Natural frequency in hertz that the next build gives the stiffness of this target. 0: the "
        "stiffness in pascals counts as it is",
        default=0.0, min=0.0, max=1000.0, override=OVERRIDE,
    )  # fmt: skip
    by_hand: BoolProperty(
        name="Set by Hand",
        description="Whether the artist has set the bounce or the stiffness, which no build or rehearsal then changes",
        override=OVERRIDE,
    )  # fmt: skip

    # What artists call it. Computed from the properties above and from what the last build measured.
    bounce: FloatProperty(
        name="Bounce (Hz)",
        description="Natural frequency: how often a second the soft tissue swings after a push, in this pose. Sets the "
        "stiffness, and both dampings so that it settles as soon as before",
        min=0.05, max=1000.0, soft_min=0.5, soft_max=20.0, step=10, precision=2, options={"SKIP_SAVE"},
        get=_get_bounce, set=_set_bounce,
    )  # fmt: skip
    settle: FloatProperty(
        name="Settle (Frames)",
        description="Frames until a twentieth of a swing is left, in this pose. Sets both dampings, in the proportion "
        "they have",
        min=0.1, max=NEVER, soft_min=1.0, soft_max=100.0, step=100, precision=1, options={"SKIP_SAVE"},
        get=_get_settle, set=_set_settle,
    )  # fmt: skip
    weight: FloatProperty(
        name="Weight (kg)",
        description="Of the flesh in the target's region, with what the bones hold. Sets the density and nothing else: "
        "heavier flesh bounces slower",
        min=1e-6, max=1e6, soft_max=100.0, step=10, precision=3, options={"SKIP_SAVE"},
        get=_get_weight, set=_set_weight,
    )  # fmt: skip
    bounce_reference: FloatProperty(
        name="Bounce Reference", description="Undamped, in Hz, where stiffness over density is 1; by the last build",
        options={"SKIP_SAVE"},
    )  # fmt: skip
    poisson_reference: FloatProperty(
        name="Poisson Reference", description="Poisson's ratio that it was measured at", options={"SKIP_SAVE"}
    )
    volume: FloatProperty(
        name="Volume", description="Of the flesh in the target's region, in m³, by the last build",
        options={"SKIP_SAVE"},
    )  # fmt: skip

    @property
    def is_measured(self) -> bool:
        """Whether the last build knows how the flesh swings at this target; else bounce, settle and weight are 0."""
        measured = self.bounce_reference > 0.0 and self.volume > 0.0
        return measured and math.isclose(self.poisson, self.poisson_reference, rel_tol=1e-5)

    def set_references(self, bounce: float, volume: float, poisson: float):
        """As `materials.references` gives them, measured at this Poisson's ratio."""
        self.bounce_reference, self.volume, self.poisson_reference = bounce, volume, poisson

    def material(self) -> Material:
        return Material(self.stiffness, self.poisson, self.density, self.mass_damping, self.stiffness_damping)

    def set_material(self, material: Material, by_hand=False):
        """Its stiffness then counts as it is. by_hand: no rehearsal changes it either."""
        with as_computed():
            for name, value in asdict(material).items():
                setattr(self, name, value)
        self.frequency, self.by_hand = 0.0, by_hand

    def set_computed_stiffness(self, stiffness: float):
        """Young's modulus in pascals that follows from the frequency: it does not count as set by hand."""
        with as_computed():
            self.stiffness = stiffness

    def set_frequency(self, frequency: float, damping: tuple[float, float]):
        """Let it swing so often a second, with this mass and stiffness damping: at once if it is measured, else from
        the next build on. It does not count as set by hand.
        """
        self.mass_damping, self.stiffness_damping = damping
        self.frequency, self.by_hand = frequency, False
        if self.is_measured:
            self.set_computed_stiffness(materials.stiffness_for(self.bounce_reference, self.material(), frequency))

    def bone_names(self) -> tuple[str, ...]:
        return tuple(bone.name for bone in self.bones)

    def set_bones(self, names, automatic=False):
        """automatic: nobody chose them by hand."""
        self.auto_bones = automatic
        self.bones.clear()
        for name in names:
            self.bones.add().name = name

    def set_region(self, group: str, automatic: bool):
        """automatic: `regions.update` keeps the vertex group up to date."""
        if self.region != group:
            self.region = group
        self.auto_region = automatic

    def set_pose(self, skeleton: Skeleton, local: np.ndarray, rig_world: np.ndarray):
        """Store a pose: local (B, 4, 4) as `Skeleton.local_transforms` gives it, rig_world (4, 4)."""
        self.pose.clear()
        for name, rest, transform in zip(skeleton.names, skeleton.rest, local, strict=True):
            bone = self.pose.add()
            bone.name, bone.rest, bone.local = name, rest.ravel(), transform.ravel()
        self.rig_world = rig_world.ravel()

    def placing(self) -> tuple:
        """All that places the target among others, to be compared: cheap enough for every frame."""
        return self.region, self.radius, self.bone_names(), self.pose_bytes()

    def pose_bytes(self) -> bytes:
        """The captured transforms, float32."""
        stored = np.empty(16 * len(self.pose), np.float32)
        self.pose.foreach_get("local", stored)
        return stored.tobytes()

    def local(self, skeleton: Skeleton) -> np.ndarray:
        """The captured pose (B, 4, 4) in the skeleton's order; bones added since then are at rest."""
        stored = np.frombuffer(self.pose_bytes(), np.float32).reshape(-1, 4, 4).astype(np.float64)
        by_name = dict(zip((bone.name for bone in self.pose), stored, strict=True))
        return np.array([by_name.get(name, np.eye(4)) for name in skeleton.names]).reshape(-1, 4, 4)


def _is_other_mesh(chosen, obj) -> bool:
    return obj.type == "MESH" and obj != chosen.id_data


def _cage_chosen(model, _context):
    from . import watch  # which looks at what is authored here

    if model.content_id:
        watch.look_soon()


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
        default=1.0, min=0.0, max=10.0, soft_max=2.0, override=OVERRIDE, update=_shown_changed,
    )  # fmt: skip
    solo: BoolProperty(
        name="Solo", description="Show only the solo modes while Live plays", override=OVERRIDE, update=_shown_changed
    )


class DynamorphLive(PropertyGroup):
    """Simulation during playback, shown by one shape key that is rewritten at each frame."""

    key: PointerProperty(name="Key", description="The shape key that Live rewrites", type=DynamorphKey)
    muted: CollectionProperty(name="Muted", description="Target keys that Live muted", type=DynamorphKey)
    slot: EnumProperty(
        name="Slot", description="Which of two sets of settings is in use",
        items=(("A", "A", "Settings A"), ("B", "B", "Settings B")), default="A",
    )  # fmt: skip
    other: StringProperty(name="Other Slot", description="The settings of the slot that is not in use, as JSON")
    checks: StringProperty(name="Targets", description="How far each target is missed, a line each")


class DynamorphSimulation(PropertyGroup):
    """How a shot is simulated."""

    use_scene_range: BoolProperty(
        name="Scene Range", description="Bake the frames of the scene", default=True, override=OVERRIDE
    )
    start: IntProperty(name="Start", description="First frame", default=1, override=OVERRIDE)
    end: IntProperty(name="End", description="Last frame", default=250, override=OVERRIDE)
    substeps: IntProperty(
        name="Substeps",
        description="Steps a frame; 0 chooses as many as keep a step below 1/120 s",
        default=0, min=0, max=1000, soft_max=20, override=OVERRIDE,
    )  # fmt: skip
    samples: IntProperty(
        name="Samples",
        description="Times a frame at which the motion is kept, so that motion blur sees it swing between two frames. "
        "Substeps are rounded up to a multiple",
        default=1, min=1, max=32, soft_max=8, override=OVERRIDE,
    )  # fmt: skip
    scheme: EnumProperty(
        name="Scheme",
        description="Time integration",
        items=(
            ("BDF2", "BDF2", "Second order: keeps the bounce"),
            ("EULER", "Implicit Euler", "First order: damps strongly"),
        ),
        default="BDF2", override=OVERRIDE,
    )  # fmt: skip
    gravity: FloatProperty(
        name="Gravity",
        description="Factor on the scene's gravity. Targets do not sag: in a target's own pose and tilt it is balanced",
        default=1.0, min=-10.0, max=10.0, soft_min=0.0, soft_max=1.0, override=OVERRIDE,
    )  # fmt: skip
    fields: FloatProperty(
        name="Force Fields",
        description="Factor on the scene's Wind and Force fields, whose strength is newtons on a square metre of skin",
        default=1.0, min=0.0, soft_max=1.0, override=OVERRIDE,
    )  # fmt: skip
    amount: FloatProperty(
        name="Amount",
        description="How much of the motion shows, in Live and in the next bake: 0 none, 1 as simulated",
        default=1.0, min=0.0, max=4.0, soft_max=2.0, subtype="FACTOR", override=OVERRIDE, update=_shown_changed,
    )  # fmt: skip
    max_displacement: FloatProperty(
        name="Max Displacement",
        description="How far the skin may move away from the animation, as a part of the body's size. The first bake "
        "of a shot rehearses it and raises Bounce until this holds. 0: no limit",
        default=0.0, min=0.0, max=1.0, soft_max=0.2, precision=3, subtype="FACTOR", override=OVERRIDE,
    )  # fmt: skip
    max_thickness: FloatProperty(
        name="Of Thickness",
        description="How far the skin may move away from the animation, as a part of how thick the body is there. "
        "0: no limit",
        default=0.0, min=0.0, max=10.0, soft_max=1.0, precision=2, subtype="FACTOR", override=OVERRIDE,
    )  # fmt: skip
    rehearsed: StringProperty(
        name="Rehearsed", description="What the rehearsal of the shot has set, for the artist", override=OVERRIDE
    )
    begin: EnumProperty(
        name="Begin",
        description="What the flesh does before the first frame",
        items=(
            ("REST", "Rest", "It has the targets' shape, at rest, and the first motion hits it"),
            ("SETTLE", "Settle", "It is in balance with gravity, and moves with the rig as if that had always moved"),
        ),
        default="SETTLE", override=OVERRIDE,
    )  # fmt: skip
    preroll: IntProperty(
        name="Pre-Roll", description="Frames that are simulated before the start",
        default=0, min=0, max=10_000, soft_max=100, override=OVERRIDE,
    )  # fmt: skip
    preroll_pose: EnumProperty(
        name="Pre-Roll Pose",
        description="What the rig does in the frames before the start. A loop needs no animated ones",
        items=(
            ("HELD", "Held", "It holds the pose of the start"),
            ("ANIMATED", "Animated", "It moves as its animation says: by keyframes before the start, or extrapolated"),
        ),
        default="HELD", override=OVERRIDE,
    )  # fmt: skip
    keep_outside: BoolProperty(
        name="Keep Other Frames",
        description="Bake the range into the last bake, of which the other frames stay as they are. The rig runs up to "
        "the range for a second, and where the two meet they are blended",
        override=OVERRIDE,
    )  # fmt: skip
    loop: BoolProperty(
        name="Loop", description="The range is a cycle: its last frame continues with its first, without a jump",
        override=OVERRIDE,
    )  # fmt: skip

    @property
    def is_patch(self) -> bool:
        """Whether the range is to go into the last bake."""
        return self.keep_outside and not self.use_scene_range

    def steps_per_frame(self, fps: float) -> int:
        return self.substeps or max(1, math.ceil(120.0 / fps - 1e-6))


class DynamorphOutput(PropertyGroup):
    """What a bake becomes."""

    sink: EnumProperty(
        name="Bake To", description="What plays the motion in Blender",
        items=(
            ("MODES", "Shape Keys", "A few keys, the modes, with a curve each: small, editable, for engines too"),
            ("FRAMES", "Shape Key a Frame", "The surface at single frames as keys, and curves that blend them"),
            ("PC2", "Point Cache (PC2)", "A file with the surface at every frame, played by a Mesh Cache modifier"),
            ("MDD", "Point Cache (MDD)", "As PC2, for programs that read only that"),
        ),
        default=OutputSettings.sink, override=OVERRIDE,
    )  # fmt: skip
    keys: IntProperty(
        name="Keys",
        description="How many shape keys the motion may take; the best for this shot are found. 0: one for each mode",
        default=OutputSettings.keys, min=0, soft_max=32, override=OVERRIDE,
    )  # fmt: skip
    every: IntProperty(
        name="Frame Step", description="Frames from one key to the next", default=OutputSettings.every,
        min=1, soft_max=10, override=OVERRIDE,
    )  # fmt: skip
    tolerance: FloatProperty(
        name="Tolerance",
        description="How far the surface may be off between keys, which then are where they are needed. 0: a key at "
        "regular frames",
        default=OutputSettings.tolerance, min=0.0, soft_max=0.01, precision=4, subtype="DISTANCE", override=OVERRIDE,
    )  # fmt: skip

    def settings(self) -> OutputSettings:
        """As the panels show them: lengths in Blender units."""
        return OutputSettings(**{field.name: getattr(self, field.name) for field in fields(OutputSettings)})


class DynamorphBake(PropertyGroup):
    """What a bake changed, so that Free Bake can undo exactly that."""

    keys: CollectionProperty(name="Keys", description="Shape keys that the bake added", type=DynamorphKey)
    cache: StringProperty(name="Cache", description="File name of the point cache, if one plays the motion")
    muted: CollectionProperty(name="Muted", description="Target keys that the bake muted", type=DynamorphKey)
    action: PointerProperty(name="Action", description="Action with the modal curves", type=bpy.types.Action)
    had_animation_data: BoolProperty(
        name="Had Animation Data", description="Whether the shape keys were animated before the bake"
    )
    active_index: IntProperty(name="Active Key", description="Index of the active shape key before the bake")
    basis: StringProperty(name="Basis", description="Hash of the Basis that the keys belong to")
    summary: StringProperty(name="Result", description="What the last bake made")
    warnings: StringProperty(name="Warnings", description="Of the last bake, a line each")
    inputs: StringProperty(name="Inputs", description="What the bake was made from, as JSON")
    animation: StringProperty(name="Animation", description="Hashes of the rig's animation as last seen, as JSON")
    verdict: StringProperty(name="Verdict", description="How believable the last bake looks, as JSON")
    was_rendered: BoolProperty(
        name="Was Rendered", description="Whether renders showed the point cache before plain skinning was shown",
        default=True,
    )  # fmt: skip
    content_id: StringProperty(name="Bake Id", description="Hash of all that the bake was made from")
    digest: StringProperty(name="Result Id", description="Hash of what was simulated")

    @property
    def exists(self) -> bool:
        return bool(self.keys or self.cache)


class DynamorphSculpt(PropertyGroup):
    """What sculpting a target in its pose changed, so that Finish Sculpting can put it back."""

    active: BoolProperty(name="Sculpting", description="Whether a target is being sculpted")
    was_pinned: BoolProperty(name="Was Pinned", description="Whether the active shape key was shown alone before")
    was_posing: BoolProperty(name="Was Posing", description="Whether the armature was in Pose Mode before")
    in_editmode: BoolProperty(name="In Edit Mode", description="Whether Edit Mode showed the Armature modifier before")
    on_cage: BoolProperty(name="On Cage", description="Whether Edit Mode edited through the modifier before")
    key: PointerProperty(name="Key", description="The shape key that is sculpted", type=DynamorphKey)
    is_new: BoolProperty(name="New", description="Whether it began with what the other targets show in its pose")
    shown: PointerProperty(
        name="Shown", description="The target's shape key that is turned on to be looked at before there is a model",
        type=DynamorphKey,
    )  # fmt: skip


class DynamorphSettings(PropertyGroup):
    """Everything about the soft skin of one object."""

    targets: CollectionProperty(
        name="Targets", description="Dynamic morph targets; the first is the neutral one", type=DynamorphTarget,
        override=OVERRIDE_LIST,
    )  # fmt: skip
    active_target_index: IntProperty(
        name="Active Target", description="Index of the target selected in the list", override=OVERRIDE
    )
    soft_group: StringProperty(
        name="Soft",
        description="Vertex group: 1 where the skin is soft, 0 where the bones hold it. All is soft without a group",
        override=OVERRIDE,
    )
    groups: StringProperty(name="Groups", description="Names of the vertex groups, a line each, to follow renames")
    stiffness_group: StringProperty(
        name="Stiffness",
        description="Vertex group of places that are stiffer, or softer, than the targets say; see Factor",
        override=OVERRIDE,
    )
    stiffness_factor: FloatProperty(
        name="Factor",
        description="On the stiffness where the Stiffness group is 1; there is no change where it is 0",
        default=4.0, min=0.01, max=100.0, soft_min=0.1, soft_max=10.0, override=OVERRIDE,
    )  # fmt: skip
    pieces: CollectionProperty(
        name="Attachments", description="Parts of the mesh, and other meshes, that do not simply belong to the body",
        type=DynamorphPiece, override=OVERRIDE_LIST,
    )  # fmt: skip
    active_piece_index: IntProperty(
        name="Active Attachment", description="Index of the attachment selected in the list", min=0, override=OVERRIDE
    )
    follows: PointerProperty(
        name="Follows", description="The soft skin whose motion the bake or Live shows on this mesh",
        type=bpy.types.Object,
    )  # fmt: skip
    had_keys: BoolProperty(name="Had Shape Keys", description="Whether the mesh had a Basis before it followed")
    model: PointerProperty(
        name="Model", description="How the model is built, and what came of it", type=DynamorphModel, override=OVERRIDE
    )
    modes: CollectionProperty(
        name="Modes", description="Displacement modes of the built model", type=DynamorphMode, override=OVERRIDE_LIST
    )
    active_mode_index: IntProperty(
        name="Active Mode", description="Index of the mode selected in the list", min=0, override=OVERRIDE
    )
    simulation: PointerProperty(
        name="Simulation", description="How a shot is simulated", type=DynamorphSimulation, override=OVERRIDE
    )
    live: PointerProperty(name="Live", description="Simulation during playback", type=DynamorphLive)
    output: PointerProperty(name="Output", description="What a bake becomes", type=DynamorphOutput, override=OVERRIDE)
    bake: PointerProperty(name="Bake", description="What the last bake changed", type=DynamorphBake)
    sculpt: PointerProperty(name="Sculpt", description="Sculpting in a target's pose", type=DynamorphSculpt)

    @property
    def active_target(self):
        """The target selected in the list, or None."""
        inside = 0 <= self.active_target_index < len(self.targets)
        return self.targets[self.active_target_index] if inside else None

    @property
    def active_piece(self):
        """The piece selected in the list, or None."""
        return self.pieces[self.active_piece_index] if self.active_piece_index < len(self.pieces) else None


def _paint_surface(which: str, other: str):
    """The update of a toggle that colors the surface: only one of the two does, and viewports draw anew."""

    def update(display, _context):
        if getattr(display, which) and getattr(display, other):
            setattr(display, other, False)
        events.redraw(events.VIEWS)

    return update


def _show_influence(display, _context):
    from . import influence  # which reads what is authored here

    if display.influence and not bpy.app.background:
        influence.update_soon(0.0)


class DynamorphDisplay(PropertyGroup):
    """What the 3D viewport shows besides; for the session, like Blender's own overlays of a window."""

    cage: BoolProperty(name="Cage", description="Draw the cage of tetrahedra, with the nodes that the bones hold")
    influence: BoolProperty(
        name="Influence", description="Draw each target's weight over the frames, shading those far from every target",
        update=_show_influence,
    )  # fmt: skip
    heat: BoolProperty(
        name="Heat Map",
        description="Color the skin by how far it moves away from the animation, as a part of Max Displacement",
        update=_paint_surface("heat", "hold"),
    )  # fmt: skip
    hold: BoolProperty(
        name="Show Hold", description="Color the skin by how firmly the skeleton holds it, as the model was built",
        update=_paint_surface("hold", "heat"),
    )  # fmt: skip
    posed: StringProperty(name="Posed", description="The armature that was in Pose Mode when painting began")


# Settings as plain data --------------------------------------------------------------------------------------------


def plain(group, skip=()) -> dict:
    """The simple settings of a property group by name, fit for JSON: numbers, texts, enums and arrays of numbers.

    Groups and lists within it are left out, what follows from a built model, and what `skip` names.
    """
    out = {}
    for prop in group.bl_rna.properties:
        computed = prop.is_readonly or prop.is_skip_save
        if prop.identifier in ("rna_type", *skip) or prop.type in ("POINTER", "COLLECTION") or computed:
            continue
        value = getattr(group, prop.identifier)
        out[prop.identifier] = list(value) if getattr(prop, "is_array", False) else value
    return out


def assign(group, values: dict):
    """The inverse of `plain`. Writes only what differs; names that the group does not have are skipped."""
    with as_computed():  # whether a stiffness was set by hand is one of the values
        for name, value in values.items():
            if name in group.bl_rna.properties and plain(group).get(name) != value:
                setattr(group, name, value)


# Following renames -------------------------------------------------------------------------------------------------


def reconcile(obj):
    """Make the references of `obj` follow renamed or moved shape keys and renamed bones.

    A reference whose key or bone is really gone stays as it is; whoever uses it reports that.
    """
    settings = obj.dynamorph
    if obj.data.shape_keys:
        blocks = obj.data.shape_keys.key_blocks
        _follow_keys(blocks, settings.targets[1:])
        _follow_keys(blocks, settings.bake.muted)
        _follow_baked_keys(blocks, settings.bake)
        _follow_keys(blocks, settings.live.muted)
        for reference in (settings.live.key, settings.sculpt.key, settings.sculpt.shown):
            if reference.name:
                _follow_keys(blocks, [reference])
    _follow_groups(obj)
    rig = rig_of(obj)
    if rig and rig.mode != "EDIT":  # in Edit Mode the armature's bones lag behind
        skeleton = rest_skeleton(rig.data)
        for target in settings.targets:
            _follow_bones(skeleton, target)


def _follow_baked_keys(blocks, bake):
    """Free Bake deletes these keys: one that only has the name of a key of ours is somebody else's.

    Unless the mesh itself was edited, or its scale applied: then none looks as it did, and the name has to do.
    """
    basis = basis_hash(blocks) if bake.keys else bake.basis
    if bake.basis == basis:
        for reference in bake.keys:
            block = blocks.get(reference.name)
            if block and not reference.looks_like(block):
                reference.name = ""
    else:
        bake.basis = basis
    for reference in _follow_keys(blocks, bake.keys):
        reference.name = ""


def _follow_keys(blocks, references) -> list:
    """Returns the references whose key is gone."""
    lost, taken = [], {0}
    for reference in references:
        index = blocks.find(reference.name)
        if index < 0:
            lost.append(reference)
        else:
            reference.refer_to(blocks, index)
            taken.add(index)
    free = {i: key_hash(block) for i, block in enumerate(blocks) if i not in taken} if lost else {}
    gone = []
    for reference in lost:
        same = [i for i, digest in free.items() if digest == reference.key_hash]
        if not same:
            gone.append(reference)
            continue
        index = reference.key_index if reference.key_index in same else same[0]
        del free[index]
        reference.refer_to(blocks, index)
    return gone


def _follow_groups(obj):
    """Vertex groups have no other identity than their place among the others."""
    settings = obj.dynamorph
    now, then = obj.vertex_groups.keys(), settings.groups.split("\n")
    if now == then:
        return
    settings.groups = "\n".join(now)
    moved = zip(then, now, strict=True) if len(now) == len(then) else ()
    renamed = {old: new for old, new in moved if old not in now and new not in then}
    users = [(settings, "soft_group"), (settings, "stiffness_group")]
    users += [(piece, "group") for piece in settings.pieces]
    for user, name in users:
        if getattr(user, name) in renamed:
            setattr(user, name, renamed[getattr(user, name)])
    for target in settings.targets:
        if target.region in renamed:
            target.set_region(renamed[target.region], target.auto_region)


def _follow_bones(skeleton: Skeleton, target):
    index = {name: b for b, name in enumerate(skeleton.names)}
    rest = np.empty((len(target.pose), 4, 4), np.float32)
    target.pose.foreach_get("rest", rest.ravel())
    free = sorted(set(index.values()) - {index.get(bone.name) for bone in target.pose})
    before, after = [], []
    for bone, stored in zip(target.pose, rest, strict=True):
        b = index.get(bone.name)
        if b is None:
            b = next((b for b in free if np.allclose(skeleton.rest[b], stored, rtol=1e-5, atol=1e-6)), None)
            if b is None:
                continue
            free.remove(b)
            for used in target.bones:
                if used.name == bone.name:
                    used.name = skeleton.names[b]
            bone.name = skeleton.names[b]
        before.append(stored[:3, :3])
        after.append(skeleton.rest[b, :3, :3])
        if not np.array_equal(skeleton.rest[b].astype(np.float32), stored):
            bone.rest = skeleton.rest[b].ravel()
    _keep_tilt(target, np.array(before), np.array(after))


def _keep_tilt(target, before: np.ndarray, after: np.ndarray):
    """Bones (B, 3, 3) that at rest were all turned alike, as a rotation that is applied to the armature turns them,
    still stood in the world as they stood when the pose was captured."""
    if len(before) < 2:  # of a single bone it may be the roll
        return
    turn = after[0] @ before[0].T
    if np.allclose(turn, np.eye(3), atol=1e-4) or not np.allclose(turn @ before, after, atol=1e-4):
        return
    world = np.array(target.rig_world).reshape(4, 4)
    world[:3, :3] = world[:3, :3] @ turn.T
    target.rig_world = world.ravel()


def named_targets(obj) -> list[tuple]:
    """(name, target) of all targets; the neutral's name is empty, because a shape key may be called like it."""
    return [(target.name if i else "", target) for i, target in enumerate(obj.dynamorph.targets)]


def soft_skins(objects):
    """Those of `objects` that carry a soft skin."""
    return [obj for obj in objects if obj.type == "MESH" and obj.dynamorph.targets]


def parts_in(obj) -> list:
    """The pieces of a soft skin that are parts of its own mesh."""
    return parts_of(obj, None)


def parts_of(obj, mesh) -> list:
    """The pieces of a soft skin that are parts of another mesh object; None: of its own."""
    return [piece for piece in obj.dynamorph.pieces if piece.group and piece.object == mesh]


def clothes_in(obj) -> list:
    """The other meshes that the flesh of a soft skin is to carry along, without those that are deleted."""
    choices = {"WITH_BODY", "HELD"} if obj.dynamorph.model.one_cage else {"WITH_BODY"}
    pieces = [piece.object for piece in obj.dynamorph.pieces if not piece.group and piece.choice in choices]
    return [piece for piece in dict.fromkeys(pieces) if piece and piece.users_scene]


def is_shown_on(obj) -> bool:
    """Whether there are keys of a bake or of Live on a mesh."""
    return obj.dynamorph.bake.exists or bool(obj.dynamorph.live.key.name)


def cache_modifier(obj):
    """The modifier that plays the bake's point cache, or None. The artist may have renamed it, or moved the file."""
    file = obj.dynamorph.bake.cache
    caches = (modifier for modifier in obj.modifiers if modifier.type == "MESH_CACHE") if file else ()
    return next((modifier for modifier in caches if bpy.path.basename(modifier.filepath) == file), None)


def followers(obj) -> list:
    """The meshes that show the motion of the soft skin `obj` now, by its bake or by Live."""
    return [other for other in bpy.data.objects if other.dynamorph.follows == obj]


def mesh_in(context):
    """The mesh object that buttons and panels are about, or None: the active one, of an armature the soft skin on it.

    Of several soft skins on one armature, a selected one; without any, the largest mesh.
    """
    obj = context.object
    if obj is not None and obj.type == "ARMATURE":
        skins = [skin for skin in soft_skins(context.view_layer.objects) if rig_of(skin) == obj]
        return min(skins, key=lambda skin: not skin.select_get(), default=None) or _largest_on(obj, context)
    return obj if obj is not None and obj.type == "MESH" else None


def _largest_on(rig, context):
    """The mesh with the most vertices that an armature object skins, or None."""
    skinned = [obj for obj in context.view_layer.objects if obj.type == "MESH" and rig_of(obj) == rig]
    return max(skinned, key=lambda obj: len(obj.data.vertices), default=None)


@persistent
def _follow_changes(_scene, depsgraph):
    """depsgraph_update_post: see `changed_objects`. A renamed bone updates the Armature, but so does posing."""
    for obj in changed_objects(depsgraph):
        reconcile(obj)
    if any(isinstance(update.id, bpy.types.Armature) for update in depsgraph.updates):
        for obj in soft_skins(bpy.data.objects):
            rig = rig_of(obj)
            poses = [bone.name for target in obj.dynamorph.targets for bone in target.pose]
            if rig and obj.library is None and not set(poses).issubset(rig.data.bones.keys()):
                reconcile(obj)


def changed_objects(depsgraph) -> list:
    """Soft skins whose shape keys were edited: sculpted, renamed, moved, or a value was set.

    Posing also updates the Key, but only its geometry: an edit of the Key itself has the shading flag too.
    """
    changed = {u.id.original for u in depsgraph.updates if isinstance(u.id, bpy.types.Key) and u.is_updated_shading}
    if not changed:
        return []
    return [obj for obj in soft_skins(bpy.data.objects) if obj.library is None and obj.data.shape_keys in changed]


HANDLERS = {"depsgraph_update_post": _follow_changes}
CLASSES = (
    DynamorphKey,
    DynamorphBone,
    DynamorphBonePose,
    DynamorphTarget,
    DynamorphPiece,
    DynamorphModel,
    DynamorphMode,
    DynamorphLive,
    DynamorphSimulation,
    DynamorphOutput,
    DynamorphBake,
    DynamorphSculpt,
    DynamorphSettings,
    DynamorphDisplay,
)
_register_classes, _unregister_classes = bpy.utils.register_classes_factory(CLASSES)


def register():
    _register_classes()
    bpy.types.Object.dynamorph = PointerProperty(name="Dynamorph", type=DynamorphSettings, override=OVERRIDE)
    bpy.types.WindowManager.dynamorph = PointerProperty(name="Dynamorph", type=DynamorphDisplay)
    events.add(HANDLERS)


def unregister():
    events.remove(HANDLERS)
    del bpy.types.WindowManager.dynamorph
    del bpy.types.Object.dynamorph
    _unregister_classes()
