# SPDX-License-Identifier: GPL-3.0-or-later
"""The recipes of docs/recipes: their steps work as the pages say, and the pages name what the interface has."""

import json
import re
import struct
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core.geometry import diagonal, signed_volume
from bl_ext.user_default.dynamic_morph_targets.core.result import judge
from bl_ext.user_default.dynamic_morph_targets.scene.read import mesh_data
from recipes import cast, pictures, steps

ROOT = Path(__file__).parents[3]

PAGES, PICTURES = ROOT / "docs/recipes", ROOT / "docs/images/recipes"
ADDON = ROOT / "addon/dynamic_morph_targets"
NAMES = [*steps.RECIPES]
SYMBOLS = {"+", "-"}  # of buttons that have no text
LARGEST = 80_000  # bytes of a picture


@dataclass
class Cooked:
    """A recipe that was followed. plain, baked: where the vertices are (F, V, 3) at each frame, world space, meters;
    first_verdict: on the bake that was there before the first step; folder: for files.
    """

    body: object
    plain: np.ndarray
    baked: np.ndarray
    first_verdict: str
    folder: Path

    def __post_init__(self):
        self.motion = np.linalg.norm(self.baked - self.plain, axis=2)
        self.size = diagonal(self.plain[0])

    def of_bones(self, *beginnings: str) -> float:
        """How far the skin moves that these bones carry alone, of the body's size."""
        groups = {group.index for group in self.body.vertex_groups if group.name.startswith(beginnings)}
        carried = [sum(g.weight for g in each.groups if g.group in groups) for each in self.body.data.vertices]
        return float(self.motion[:, np.array(carried) > 0.99].max()) / self.size

    def near(self, point, radius: float) -> np.ndarray:
        """How far the skin moves (F,) that is there at first, at most, of the size."""
        chosen = np.linalg.norm(self.plain[0] - point, axis=1) < radius
        return self.motion[:, chosen].max(axis=1) / self.size


def check_jiggle(cooked):
    assert cooked.near(steps.NAVEL, steps.BELLY).max() > 0.02
    assert cooked.of_bones("hand", "foot", "head") < 0.004


def check_bulge(cooked):
    neutral, biceps = cooked.body.dynamorph.targets
    assert biceps.bone_names() == ("forearm",) and biceps.region
    assert biceps.omega > 2 * neutral.omega
    flexed = cooked.motion[steps.FLEXED - bpy.context.scene.frame_start]
    assert flexed.max() > 0.02
    assert cooked.of_bones("chest") * cooked.size < 0.1 * flexed.max()


def check_shape(cooked):
    _, pose = cooked.body.dynamorph.targets
    assert {"thigh_l", "calf_l"} <= {*pose.bone_names()} and pose.region
    lifted = steps.LIFTED - bpy.context.scene.frame_start
    triangles = mesh_data.mesh_triangles(cooked.body.data)
    volumes = [signed_volume(each, triangles) for each in (cooked.plain[lifted], cooked.baked[lifted])]
    plain, shaped = np.array(volumes) / signed_volume(cast.coordinates(cooked.body.data), triangles) - 1.0
    assert plain < -0.02 and abs(shaped) < 0.5 * abs(plain)
    assert cooked.of_bones("head", "hand_r") < 0.001


def check_flex(cooked):
    neutral, tension = cooked.body.dynamorph.targets
    assert not tension.bone_names() and tension.region and tension.channel == "Tension"
    assert tension.stiffness == pytest.approx(8 * neutral.stiffness, rel=1e-3)
    assert tuple(cooked.plain[-1][0]) == tuple(cooked.plain[0][0])  # no bone moves
    relaxed, tense = cooked.motion[0], cooked.motion[-1]
    assert relaxed.max() < 0.005 < 0.02 < tense.max()
    assert cooked.of_bones("chest") * cooked.size < 0.1 * tense.max()


def check_breathe(cooked):
    neutral, breath = cooked.body.dynamorph.targets
    assert not breath.bone_names() and (breath.channel, breath.reached_at) == ("Breath", 1.0)
    swelled = np.linalg.norm(cooked.baked[17] - cooked.baked[0], axis=1)
    assert 0.04 < swelled.max() < 0.06
    assert cooked.of_bones("head", "hand", "foot") < 0.001


def check_firm_parts(cooked):
    assert cooked.of_bones("hand", "thumb", "foot", "ball") < 0.001
    assert cooked.near(steps.NAVEL, steps.BELLY).max() > 0.02
    firmness = pictures.firmness(cooked.body)
    assert firmness.min() == pytest.approx(0.2, abs=0.02) and firmness.max() == 1.0


def check_collision(cooked):
    ball, radius = bpy.data.objects["Ball"], bpy.data.objects["Ball"].dimensions.x / 2
    deepest = {"plain": 0.0, "baked": 0.0}
    for k, frame in enumerate(frames()):
        bpy.context.scene.frame_set(frame)
        for name in deepest:
            away = np.linalg.norm(getattr(cooked, name)[k] - ball.matrix_world.translation, axis=1)
            deepest[name] = max(deepest[name], radius - away.min())
    assert deepest["plain"] > 0.02 * cooked.size
    assert deepest["baked"] < 0.003 * cooked.size


def check_grab(cooked):
    moved = cooked.near(steps.NAVEL, steps.BELLY)
    pulled = steps.DRAG[-1] - bpy.context.scene.frame_start
    assert [grip.name for grip in cooked.body.dynamorph.grips] == ["Drag"]
    assert moved[0] < 0.001 and moved[pulled] > 0.02
    assert moved[-1] < 0.5 * moved[pulled]


def check_strap(cooked):
    (grip,) = cooked.body.dynamorph.grips
    ball = bpy.data.objects["Ball"]
    assert grip.object == ball
    moved = cooked.near(steps.NAVEL, steps.BELLY)
    assert moved[: steps.HELD].max() < 0.005 < 0.03 < moved[22]  # held, it comes along
    assert moved[29] < 0.7 * moved[22]  # let go, it swings back


def check_clothes(cooked):
    attached = {each.object.name: each.attached_by for each in cooked.body.dynamorph.attachments}
    assert {attached["Shirt"], attached["Shorts"]} == {"WITH_BODY"} and attached["Eye"] == attached["Cap"] == "RIGID"
    shirt = bpy.data.objects["Shirt"]
    worst = int(cooked.motion.max(axis=1).argmax())
    bpy.context.scene.frame_set(frames()[worst])
    rest, below = cast.coordinates(shirt.data), cast.coordinates(cooked.body.data)
    nearest = [int(np.linalg.norm(below - point, axis=1).argmin()) for point in rest]
    apart = np.linalg.norm(steps.shown(shirt) - cooked.baked[worst][nearest], axis=1)
    assert apart.max() < 0.03 and np.median(apart) < 0.016  # as in the rest pose
    assert not pictures.is_baked(bpy.data.objects["Eye"])


def check_walk_cycle(cooked):
    np.testing.assert_allclose(cooked.baked[0], cooked.baked[-1], atol=1e-5 * cooked.size)
    assert cooked.near(steps.NAVEL, steps.BELLY).max() > 0.005
    path = cooked.folder / "walk.glb"
    steps.export(cooked.body, path)
    gltf = json.loads(path.read_bytes()[20 : 20 + struct.unpack("<I", path.read_bytes()[12:16])[0]])
    targets = [len(primitive.get("targets", ())) for mesh in gltf["meshes"] for primitive in mesh["primitives"]]
    assert 1 <= max(targets) <= 8
    assert any(c["target"]["path"] == "weights" for each in gltf["animations"] for c in each["channels"])


def check_rigify(cooked):
    assert cooked.body.dynamorph.model.head == "MCH-ROT-head"
    assert cooked.near(steps.NAVEL, steps.BELLY).max() > 0.01
    assert cooked.of_bones("DEF-hand", "DEF-foot", "DEF-spine.006") < 0.004


def check_mixamo(cooked):
    assert cooked.body.parent.scale.x == pytest.approx(0.01) and 1.0 < cooked.size < 2.5
    assert cooked.body.dynamorph.model.head == "mixamorig:Head"
    assert cooked.near(steps.NAVEL, steps.BELLY).max() > 0.01


def check_vrm(cooked):
    face = bpy.data.objects["Face"]
    seam = [(b, f) for b, point in enumerate(cast.coordinates(cooked.body.data)) if point[2] > 1.35
            for f in np.flatnonzero(np.linalg.norm(cast.coordinates(face.data) - point, axis=1) < 1e-6)]  # fmt: skip
    assert len(seam) > 20
    bpy.context.scene.frame_set(frames()[int(cooked.motion.max(axis=1).argmax())])
    body, of_face = np.transpose(seam)
    gap = np.linalg.norm(steps.shown(cooked.body)[body] - steps.shown(face)[of_face], axis=1)
    assert gap.max() < 1e-5


def check_motion_blur(cooked):
    scene, keys = bpy.context.scene, cooked.body.data.shape_keys.key_blocks
    assert scene.render.use_motion_blur and cooked.body.cycles.use_deform_motion

    def values(frame: float) -> np.ndarray:
        scene.frame_set(int(frame), subframe=frame % 1)
        return np.array([key.value for key in keys if key.name.startswith("Dynamorph Mode")])

    frame = pictures.BLUR_FRAME
    straight = 0.5 * (values(frame) + values(frame + 1))
    assert np.abs(values(frame + 0.5) - straight).max() > 0.01  # of the largest


def check_repair(cooked):
    assert not judge.parsed(cooked.first_verdict).is_believable
    assert judge.parsed(cooked.body.dynamorph.bake.verdict).is_believable


def frames() -> range:
    return range(bpy.context.scene.frame_start, bpy.context.scene.frame_end + 1)


CHECKS = {
    "jiggle": check_jiggle,
    "bulge": check_bulge,
    "shape": check_shape,
    "flex": check_flex,
    "breathe": check_breathe,
    "firm_parts": check_firm_parts,
    "collision": check_collision,
    "grab": check_grab,
    "strap": check_strap,
    "clothes": check_clothes,
    "walk_cycle": check_walk_cycle,
    "rigify": check_rigify,
    "mixamo": check_mixamo,
    "vrm": check_vrm,
    "motion_blur": check_motion_blur,
    "repair": check_repair,
}


@pytest.mark.parametrize("name", NAMES)
def test_the_steps_do_what_the_page_says(scene, tmp_path, name):
    pytest.importorskip("dynamorph", reason="needs the engine")
    verdicts = []

    def started(body):
        assert body.dynamorph.bake.exists == bool(body.dynamorph.targets)  # only what is repaired was baked
        verdicts.append(body.dynamorph.bake.verdict)

    body, _ = steps.cook(name, draft=True, started=started)
    baked = pictures.played([body])[body.name]
    bpy.ops.dynamorph.show_plain()
    plain = pictures.played([body])[body.name]
    bpy.ops.dynamorph.show_plain()
    assert np.isfinite(baked).all()
    CHECKS[name](Cooked(body, plain, baked, *verdicts, tmp_path))


@pytest.mark.parametrize("name", NAMES)
def test_a_page_names_what_the_interface_has(name):
    """What is bold is a text of the interface, or the beginning of one."""
    text = (PAGES / f"{name}.md").read_text("utf-8")
    code = "\n".join(path.read_text("utf-8") for path in ADDON.rglob("*.py"))
    bold = {re.sub(r"\s+", " ", words) for words in re.findall(r"\*\*(.+?)\*\*", text, re.DOTALL)} - SYMBOLS
    unknown = {words for words in bold if not re.search(rf'"{re.escape(words)}["\s]', code)}
    assert {words.rstrip(".") for words in unknown} <= {"A bench", "The floor", "The body itself"}


@pytest.mark.parametrize("name", NAMES)
def test_a_page_has_steps_a_picture_and_a_table(name):
    text = (PAGES / f"{name}.md").read_text("utf-8")
    assert re.search(r"^1\. ", text, re.MULTILINE) and f"{name}_start.blend" in text and f"{name}_done.blend" in text
    assert f"../images/recipes/{name}.webp" in text and "Measured at commit" in text
    assert f"({name}.md)" in (PAGES / "index.md").read_text("utf-8")
    for picture in (f"{name}.webp", f"{name}_small.webp"):
        assert 0 < (PICTURES / picture).stat().st_size <= LARGEST
