# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's force fields push the skin as they push particles at rest, and always alike."""

import hashlib

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core.motion import noise
from bl_ext.user_default.dynamic_morph_targets.run.bake import bake_input
from bl_ext.user_default.dynamic_morph_targets.scene.motion import rig_motion
from builders import activate, rig_of
from layout import drawn
from mathutils import noise as blender
from robustness import OPS, bake, coarse, motion

STEP = 0.04  # seconds: of Blender's particles
POINTS = np.random.default_rng(0).uniform(-2.0, 2.0, (100, 3)).astype(np.float32).astype(float)


def add_field(kind, **settings):
    """A tilted empty with a force field that falls off with the distance."""
    obj = bpy.data.objects.new("Field", None)
    bpy.context.scene.collection.objects.link(obj)
    activate(obj)
    bpy.ops.object.forcefield_toggle()
    obj.location, obj.rotation_euler, obj.scale = (0.3, -0.2, 0.5), (0.4, 0.3, 0.8), (2.0, 2.0, 2.0)
    obj.field.type, obj.field.flow = kind, 0.0
    for name, value in {"strength": 3.0, "falloff_power": 1.5, **settings}.items():
        setattr(obj.field, name, value)
    return obj


def pushed_particles(points):
    """The forces (V, 3) of the scene's fields on particles of 1 kg that begin at rest at points (V, 3)."""
    mesh = bpy.data.meshes.new("Emitter")
    mesh.from_pydata(points.tolist(), [], [])
    emitter = bpy.data.objects.new("Emitter", mesh)
    bpy.context.scene.collection.objects.link(emitter)
    emitter.modifiers.new("Particles", "PARTICLE_SYSTEM")
    particles = emitter.particle_systems[0].settings
    particles.count, particles.emit_from, particles.use_emit_random = len(points), "VERT", False
    particles.frame_start = particles.frame_end = 1
    particles.normal_factor, particles.effector_weights.gravity = 0.0, 0.0
    particles.integrator, particles.subframes, particles.mass = "EULER", 0, 1.0
    for frame in (1, 2):
        bpy.context.scene.frame_set(frame)
    evaluated = emitter.evaluated_get(bpy.context.evaluated_depsgraph_get()).particle_systems[0].particles
    places, velocities = np.empty((2, len(points), 3))
    evaluated.foreach_get("location", places.ravel())  # they have not moved yet
    evaluated.foreach_get("velocity", velocities.ravel())
    np.testing.assert_allclose(places, points, atol=1e-6)
    return velocities / STEP


@pytest.mark.parametrize("shape", ["POINT", "PLANE"])
@pytest.mark.parametrize(
    ("kind", "settings"),
    [
        ("WIND", {}),
        ("FORCE", {"use_min_distance": True, "distance_min": 1.0}),
        ("VORTEX", {}),
        ("VORTEX", {"strength": -0.5, "use_max_distance": True, "distance_max": 2.0}),
        ("TURBULENCE", {}),
        ("TURBULENCE", {"size": 0.7, "falloff_power": 0.0}),
        ("TURBULENCE", {"size": 0.7, "use_global_coords": True}),
    ],
)
def test_the_skin_is_pushed_as_particles_are(soft_arm, kind, settings, shape):
    add_field(kind, shape=shape, **settings)
    (field,) = rig_motion.sample_rig(soft_arm, 1, 1, 1).fields
    forces = pushed_particles(POINTS)
    assert np.abs(forces).max() > 0.1
    np.testing.assert_allclose(field.pull(0, POINTS), forces, atol=2e-5 * np.abs(forces).max())


def test_an_animated_field_prints_nothing(soft_arm, capfd):
    """Where a scene has no rigid bodies, Blender prints an error for each."""
    bpy.ops.rigidbody.world_add()  # the artist's scene has one
    add_field("WIND").keyframe_insert("field.strength", frame=1)
    bpy.context.view_layer.update()
    capfd.readouterr()
    rig_motion.sample_rig(soft_arm, 1, 3, 2)
    assert "RIGIDBODY" not in "".join(capfd.readouterr())


def test_the_noise_is_blender_s(addon):
    points = np.random.default_rng(1).uniform(-300.0, 300.0, (500, 3)).astype(np.float32).astype(float)
    theirs = [blender.noise(tuple(point), noise_basis="PERLIN_NEW") for point in points]
    np.testing.assert_allclose(noise.perlin(points), theirs, atol=5e-6)  # they compute in single precision


def test_the_noise_has_the_same_bytes_everywhere(addon):
    """Whatever NumPy and processor: a farm may have several."""
    points = (np.arange(3000) * 7919 % 10007 / 97.0 - 50.0).reshape(-1, 3)
    found = hashlib.sha256(noise.turbulence(points).tobytes()).hexdigest()
    assert found == "1b29b18a3f8dff71178b09c544471b94e2ebecb407582c86956ac901c5077a4a"


def test_the_noise_of_a_point_does_not_depend_on_the_others(addon):
    points = np.random.default_rng(2).uniform(-9.0, 9.0, (noise.CHUNK + 100, 3))
    whole = noise.turbulence(points)
    assert np.abs(whole).max() <= 1.0
    parts = [noise.turbulence(points[first : first + 37]) for first in range(0, len(points), 37)]
    np.testing.assert_array_equal(whole, np.concatenate(parts))


@pytest.fixture
def blown(soft_arm):
    """A coarse arm in a whirl and in turbulence that moves past it."""
    pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    add_field("VORTEX", strength=30.0, shape="POINT", falloff_power=0.0)
    gusts = add_field("TURBULENCE", strength=200.0, size=0.5, falloff_power=0.0)
    for frame, x in ((1, 0.0), (20, 3.0)):
        gusts.location.x = x
        gusts.keyframe_insert("location", frame=frame)
    activate(soft_arm)
    return coarse(soft_arm)


def test_turbulence_and_vortex_push_the_skin_alike_in_live_and_bakes(scene, blown, monkeypatch):
    rig_of(blown).animation_data_clear()
    whole = bake(blown).outcome.bake
    assert np.abs(whole.displacement(19) - whole.displacement(10)).max() > 1e-3
    again = bake(blown).outcome.bake
    np.testing.assert_array_equal(again.coordinates, whole.coordinates)
    monkeypatch.setattr(bake_input, "CHUNK_FRAMES", 7)
    in_chunks = bake(blown).outcome.bake
    np.testing.assert_array_equal(in_chunks.coordinates, whole.coordinates)
    baked = motion(blown, range(1, 21))
    OPS.delete_bake()
    scene.frame_set(1)
    OPS.live()
    assert np.abs(motion(blown, range(1, 21)) - baked).max() < 1e-5


def test_turbulence_keeps_its_size_in_other_units(soft_arm):
    add_field("TURBULENCE", size=0.7, falloff_power=0.0)
    (field,) = rig_motion.sample_rig(soft_arm, 1, 1, 1).fields
    bpy.context.scene.unit_settings.scale_length = 0.01
    (small,) = rig_motion.sample_rig(soft_arm, 1, 1, 1).fields
    np.testing.assert_allclose(small.pull(0, 0.01 * POINTS), field.pull(0, POINTS), atol=1e-5)  # 0.01 is rounded


def test_the_panel_says_what_a_strength_is(soft_arm):
    """Where there is a field."""
    said = "A Wind or Force field of strength 1 pushes with 1 N/m² of skin"
    assert said not in " ".join(drawn(soft_arm, "DYNAMORPH_PT_solver"))
    add_field("WIND")
    assert said in " ".join(drawn(soft_arm, "DYNAMORPH_PT_solver"))
