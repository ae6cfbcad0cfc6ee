# SPDX-License-Identifier: GPL-3.0-or-later
"""Nine rigged, animated characters of ../shared, made by others and opened as an artist opens them."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import bpy
import numpy as np
from assets import ASSETS

NODES, SUBSTEPS = 800, 2  # nodes of the cage, and steps per frame: enough to see what goes wrong, and quick


@dataclass(frozen=True)
class Shot:
    """A character with one of its clips.

    keys: shape key -> frame of the clip whose pose is that target's; without any, there is one material. scale: how an
    artist reacts to the warning that the size of the body is unlikely. stiffness: of all targets, Pa.
    """

    file: str
    clip: str
    frames: tuple[int, int]
    keys: dict[str, int] = field(default_factory=dict)
    scale: float = 1.0
    stiffness: float = 2e4

    @property
    def path(self) -> Path:
        return ASSETS / self.file


SHOTS = {
    "Cylinder": Shot("cylinder_4bones.blend", "gen_bend_and_stop", (8, 24), {"bulge_elbow": 30}),
    "Shoulder": Shot("mh_shoulder_arm_4bones.blend", "gen_raise_flex", (24, 40), {"biceps_bulge_L": 40}),
    "MakeHuman, male": Shot("mh_male_53bones.blend", "gen_jump", (18, 34), {"muscular": 37}),
    "MakeHuman, chubby": Shot(
        "mh_chubby_53bones.blend", "gen_run_in_place", (40, 56), {"thigh_muscle_L": 49, "thigh_muscle_R": 58}
    ),
    "Cesium Man": Shot("CesiumMan_notexture.glb", "Anim_0", (10, 26)),
    "Fox": Shot("Fox.glb", "Run", (5, 21), scale=0.01),
    "KayKit knight": Shot("KayKit_Knight.glb", "Walking_A", (5, 21)),
    "T-rex": Shot("Quaternius_Trex.glb", "Armature|TRex_Run", (5, 21), scale=0.2, stiffness=2e5),
    "Robot": Shot("RobotExpressive.glb", "Walking", (3, 19), scale=0.4),
}


def open_shot(shot: Shot):
    """The character's largest skinned mesh as a soft skin that plays the shot's clip; the scene has its frames.

    Bones hold it, and nothing limits its motion, which demands more of the engine than a soft skin made by one click.
    """
    open_file(shot.path)
    scene, body = bpy.context.scene, largest_skinned()
    scene.frame_start, scene.frame_end = shot.frames
    bpy.context.view_layer.objects.active = body
    play(body.modifiers["Armature"].object, bpy.data.actions[shot.clip])
    resize(body, shot.scale)
    if body.data.shape_keys and body.data.shape_keys.animation_data:
        body.data.shape_keys.animation_data.action = None  # it moves keys that are not targets
    bpy.ops.dynamorph.add_soft_skin()
    bpy.ops.dynamorph.find_attachments()
    for key in body.data.shape_keys.key_blocks:
        key.mute = key.name not in shot.keys and key != body.data.shape_keys.reference_key  # it would show on top
    for key, frame in shot.keys.items():
        scene.frame_set(frame)
        bpy.ops.dynamorph.add_target(key=key)
    for target in body.dynamorph.targets:
        target.frequency, target.stiffness = 0.0, shot.stiffness
    model, simulation = body.dynamorph.model, body.dynamorph.simulation
    model.cage_nodes, model.method = NODES, "DYNAMIC" if shot.keys else "SINGLE"
    model.hold, model.hold_head = "BONES", False
    body.dynamorph.firmness_group = body.vertex_groups.new(name="Firmness").name  # robots, too, are taken for soft
    simulation.max_displacement = simulation.max_thickness = 0.0
    scene.frame_set(scene.frame_start)
    return body


def open_file(path: Path):
    """The file as it is."""
    if path.suffix == ".glb":
        bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
        bpy.ops.import_scene.gltf(filepath=str(path))
    else:
        bpy.ops.wm.open_mainfile(filepath=str(path))


def largest_skinned():
    """The mesh object with an Armature modifier that has the most vertices."""
    skinned = [obj for obj in bpy.context.scene.objects if obj.type == "MESH" and armature_of(obj)]
    return max(skinned, key=lambda obj: len(obj.data.vertices))


def armature_of(obj):
    """The armature object that skins a mesh object, or None."""
    rigs = [modifier.object for modifier in obj.modifiers if modifier.type == "ARMATURE" and modifier.object]
    return rigs[0] if rigs else None


def play(rig, action):
    rig.animation_data.action = action
    rig.animation_data.action_slot = rig.animation_data.action_suitable_slots[0]  # some have one for the keys, too


def resize(obj, scale: float):
    """Scale the whole character through a parent of all its objects."""
    while obj.parent:
        obj = obj.parent
    obj.scale *= scale
    bpy.context.view_layer.update()


@dataclass(frozen=True)
class Baked:
    """A character's object and the job that baked it."""

    body: object
    job: object

    @property
    def skin(self) -> np.ndarray:
        """(V, 3), bind space."""
        return self.job.outcome.character.vertices @ self.job.outcome.character.to_bind.T

    @property
    def size(self) -> float:
        """Diagonal of the bounding box, meters."""
        return float(np.linalg.norm(np.ptp(self.skin, axis=0)))

    @cached_property
    def displacements(self) -> np.ndarray:
        """(F, V, 3), bind space."""
        result = self.job.outcome.bake
        local = np.array([result.displacement(k) for k in range(len(result.frames))])
        return local @ self.job.outcome.character.to_bind.T

    @property
    def inside(self) -> np.ndarray:
        """Which of the skin's vertices are in the cage's tetrahedra, except those that bones alone move."""
        from dynamorph import TetMesh, embed  # opening and playing a character needs no engine

        model = self.job.outcome.model
        soft = self.skin[self.job.outcome.character.cage_index >= 0]
        return embed(TetMesh(model.nodes, model.tets), soft).distances < 1e-6 * self.size


def bake(jobs, body) -> Baked:
    """The scene's frames. jobs: the add-on's module, under the name by which it was loaded."""
    job = jobs.Job(body, goal="BAKE", substeps=SUBSTEPS)
    jobs.run(job)
    return Baked(body, job)
