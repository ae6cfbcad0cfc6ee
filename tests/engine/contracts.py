# SPDX-License-Identifier: GPL-3.0-or-later
"""Calls of the binding with bad input, made from the types in its stubs, for test_contracts.py.

For each function, method, setter and constructor CALLS has one good call. Each of its parameters is then replaced by
what its type invites: numbers that are none, integers out of range, arrays of another shape or type, None.
As a program, `contracts.py FIRST` makes the calls from number FIRST on in this process, and writes the outcome of each
as a line of JSON, the number of a call before it is made: who reads the lines knows at which it crashed or hung.
"""

from __future__ import annotations

import ast
import json
import math
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import dynamorph
import numpy as np
from dynamorph import _mesher
from scenes import bar, tube

STUBS = [Path(dynamorph.__file__).with_name(name) for name in ("_core.pyi", "_mesher.pyi")]
EXPECTED = (ValueError, TypeError, OverflowError, dynamorph.Error, dynamorph.Cancelled)


@cache
def scene() -> SimpleNamespace:
    """A bar of two targets with all that is made of it, and things of other bodies."""
    s = SimpleNamespace()
    s.nodes, s.tets = bar((4, 2, 2), (0.4, 0.1, 0.1))
    s.n, s.m = len(s.nodes), len(s.tets)
    s.mesh = dynamorph.TetMesh(s.nodes, s.tets)
    s.ones, s.pinned = np.ones(s.m), s.nodes[:, 0] < 1e-9
    s.body = dynamorph.SoftBody(s.mesh, s.ones, s.ones, s.ones[:, None], s.pinned, np.ones((s.n, 1)))
    s.shape = np.zeros((s.n, 3))
    s.shape[:, 1] = 0.02 * s.nodes[:, 0]
    s.material = {"lame_lambda": 1e4, "lame_mu": 1e4, "density": 1000.0, "mass_damping": 1.0, "stiffness_damping": 1e-3}
    s.targets = [dynamorph.MorphTarget("rest", 0 * s.shape, **s.material)]
    s.targets.append(dynamorph.MorphTarget("flexed", s.shape, **s.material))
    s.material_model, s.blending = dynamorph.MaterialModel.STABLE_STVK, dynamorph.Blending.EVEN
    s.full = dynamorph.FullModel(s.body, s.targets, s.material_model, s.blending)
    s.basis = dynamorph.make_basis(s.full, 6)
    s.tables = dynamorph.reduce(s.full, s.basis.U)
    s.reduced = dynamorph.ReducedModel(s.body, s.targets, s.tables, s.blending)
    s.response_basis = dynamorph.make_response_basis(s.full, 5, 6)
    s.with_responses = dynamorph.reduce(s.full, s.response_basis)
    s.bones, s.weights = np.eye(3, 4)[None], np.array([0.5, 0.5])
    s.next = s.bones + np.array([0.0, 0.0, 0.0, 0.01]) * np.array([[[1.0], [0.0], [0.0]]])
    vertices, faces = tube(6, 8)
    s.vertices = vertices
    s.triangles = np.array([[f[0], f[k], f[k + 1]] for f in faces for k in range(1, len(f) - 1)], np.int32)
    s.tube = dynamorph.TetMesh(*_mesher.tetrahedralize(vertices, s.triangles, 120))
    s.embedding = dynamorph.embed(s.mesh, 0.9 * s.nodes[::2])
    s.points = 0.9 * s.nodes[::2]
    skin = {"rest": s.points, "embedding": s.embedding, "weights": np.ones((len(s.points), 1))}
    s.skin = dynamorph.Skin(s.reduced, **skin)
    faces = s.tets[:, [0, 2, 1]].astype(np.int32)  # inner ones too: any surface has a limit
    s.limits = {"rest": s.nodes, "embedding": dynamorph.embed(s.mesh, s.nodes), "triangles": faces,
                "weights": np.ones((s.n, 1)), "distances": np.full(s.n, 0.05)}  # fmt: skip
    s.painted = np.full(s.n, 0.5)
    s.limit = dynamorph.MotionLimit(s.reduced, **s.limits)
    own = dynamorph.SoftBody(s.mesh, s.ones, s.ones, s.ones[:, None], s.pinned, None)
    s.own_full = dynamorph.FullModel(own, s.targets, s.material_model, s.blending)
    s.groups = np.ones((len(own.free_nodes), 1))
    normals = s.points - s.points.mean(axis=0)
    s.samples = {"rest": s.points, "embedding": s.embedding, "weights": np.ones((len(s.points), 1)),
                 "normals": normals, "thickness": np.full(len(s.points), 0.05)}  # fmt: skip
    corners = {"corners": np.tile(np.arange(len(s.points), dtype=np.int32)[:, None], 3),
               "corner_weights": np.full((len(s.points), 3), 1.0 / 3.0)}  # fmt: skip
    s.samples |= corners
    s.places = {"basis": np.eye(s.full.dofs)[:, :4], "rest": s.points, "normals": normals, "embedding": s.embedding,
                **corners}  # fmt: skip
    s.dents = dynamorph.LocalResponses(s.full, **s.places, centers=[0, 1])
    s.contact = dynamorph.Contact(s.reduced, **s.samples, local=s.dents)
    balls = {"centers": s.points[:2], "radii": [0.05, 0.04], "weights": np.ones((2, 1)),
             "embedding": dynamorph.embed(s.mesh, s.points[:2]), "points": [0, 2], "of_balls": [0, 1],
             "of_points": [1, 0], "joints": [[0, 1]]}  # fmt: skip
    s.own = {"contact": s.contact, **balls}
    s.self_contact = dynamorph.SelfContact(**s.own)
    s.parts = {"limit": s.limit, "contact": s.contact, "distance": 0.01, "self_contact": s.self_contact,
               "self_friction": 0.5}  # fmt: skip
    s.collider_points = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]])
    s.collider_triangles = np.array([[0, 1, 2]], np.int32)
    s.collider = dynamorph.Collider(s.collider_points, s.collider_triangles)
    s.collider_motion = dynamorph.ColliderMotion(s.collider, np.repeat(s.bones, 2, 0), [0.5])
    s.grabs = dynamorph.Grabs(s.skin, [0, 3], s.points[None, [0, 3]] + 0.01, [10.0, 20.0])
    s.heads, s.tails = np.array([[0.0, 0.0, 0.1]]), np.array([[0.0, 0.0, 1.9]])
    turned = np.repeat(np.eye(4)[None], 2, 0)
    turned[1, 1:3, 1:3] = [[0.0, -1.0], [1.0, 0.0]]
    s.local, s.turned = np.repeat(np.eye(4)[None], 2, 0), turned
    s.channels = {"channels": [0], "values": [[0.0], [1.0]]}
    s.set = dynamorph.TargetSet([1], ["a", "b"], [s.local, turned], **s.channels)
    s.space = dynamorph.PoseSpace([s.set])
    s.cut = dynamorph.MeshCut(s.tube, vertices, s.triangles)
    s.thickness = dynamorph.Thickness(vertices, s.triangles)
    return s


def started():
    """A simulation of the bar, with all parts, that was started."""
    s = scene()
    simulation = dynamorph.Simulation(s.reduced, 0.01, **s.parts)
    simulation.start(s.bones, s.next, s.weights)
    return simulation


def coupled_bodies():
    """Two such simulations, each with its skin."""
    skin = scene().self_contact
    return [(started(), skin), (started(), skin)]


def touched(motion):
    """A simulation that such a collider touches, if it moves for one step."""
    simulation, s = started(), scene()
    return simulation.advance(s.next[None], s.weights[None], colliders=[motion]), simulation


def run_on(simulation):
    """The outcome of a simulation that goes on."""
    s = scene()
    return (simulation.start(s.bones, s.next, s.weights), simulation.advance(s.next[None], s.weights[None])), simulation


def gone_on(state):
    """A simulation that goes on from a state."""
    simulation, s = started(), scene()
    simulation.state = state
    taken = simulation.state  # advancing would refuse it, for another reason
    return taken, None if has_nan(taken) else simulation.advance(s.next[None], s.weights[None])


def model_of(body):
    s = scene()
    return run_on(dynamorph.Simulation(dynamorph.FullModel(body, s.targets, s.material_model, s.blending), 0.01))


def model_with(target):
    s = scene()
    model = dynamorph.FullModel(s.body, [s.targets[0], target], s.material_model, s.blending)
    return run_on(dynamorph.Simulation(model, 0.01))


def model_in(tables):
    s = scene()
    return run_on(dynamorph.Simulation(dynamorph.ReducedModel(s.body, s.targets, tables, s.blending), 0.01))


# What is made of a constructed object: only then some input is looked at.
USES: dict[str, Callable] = {
    "SoftBody": model_of,
    "MorphTarget": model_with,
    "ReducedTables": model_in,
    "FullModel": lambda model: run_on(dynamorph.Simulation(model, 0.01)),
    "ReducedModel": lambda model: run_on(dynamorph.Simulation(model, 0.01)),
    "Simulation": run_on,
    "State": gone_on,
    "TargetSet": lambda target_set: dynamorph.PoseSpace([target_set]).weights(scene().turned[None], [[0.5]]),
    "PoseSpace": lambda space: [at(scene().turned[None], [[0.5]]) for at in (space.weights, space.distances)],
    "Embedding": lambda embedding: (
        embedding.interpolate(scene().nodes),
        dynamorph.extend_to_nodes(scene().mesh, embedding, np.ones((len(embedding.nodes), 2))),
        scene().body.extend_shapes(embedding, np.zeros((1, len(embedding.nodes), 3))),
    ),
    "MeshCut": lambda cut: cut.embed(cut.cut()),
    "Collider": lambda collider: touched(dynamorph.ColliderMotion(collider, np.repeat(scene().bones, 2, 0))),
    "ColliderMotion": touched,
    "Thickness": lambda thickness: thickness.at(scene().vertices),
}


def going(_fraction: float) -> bool:
    return True


@cache
def calls() -> dict[str, tuple[object, dict]]:
    """For each callable of the stubs, by name: what has it, and the arguments of a good call."""
    s = scene()
    lib, material = dynamorph, s.material
    q, r = np.zeros(s.full.dofs), np.zeros(s.reduced.dofs)
    options = {
        "h": 0.01, "integrator": lib.Integrator.BDF2, "gravity": np.zeros(3), "tolerance": 1e-6, "max_iterations": 30,
        "teleport": 0.1,
    }  # fmt: skip
    skin, push = {"vertices": s.vertices, "triangles": s.triangles}, {"external": np.zeros((s.n, 3))}
    moment = {"stiffness": np.array([1.0, 2.0]), "distance": 0.01, "self_friction": 0.5}
    in_steps = {name: np.array([value]) for name, value in moment.items()}
    moving = (s.next[None], s.weights[None], push["external"], s.grabs, [s.collider_motion], *in_steps.values())
    state = touched(s.collider_motion)[1].state
    points = {"rest": s.points, "embedding": s.embedding, "weights": np.ones((len(s.points), 1)),
              "residual_shapes": np.zeros((2, len(s.points), 3))}  # fmt: skip
    along = np.clip(5.0 * s.nodes[:, :1] - 0.5, 0.0, 1.0)
    bent = np.hstack([1.0 - along, along])
    turned = np.array([[[0.0, -1.0, 0.0, 0.2], [1.0, 0.0, 0.0, -0.2], [0.0, 0.0, 1.0, 0.0]]])
    own_limits = s.limits | {"groups": s.groups, "painted": s.painted, "stretch": 0.4,
                             "edges_between": 100, "tissue": s.limit.tissue}  # fmt: skip
    found = {
        "TetMesh": (lib, {"nodes": s.nodes, "tets": s.tets}),
        "Embedding": (lib, {"nodes": s.embedding.nodes, "weights": s.embedding.weights}),
        "Embedding.interpolate": (s.embedding, {"values": s.nodes}),
        "MeshCut": (lib, {"mesh": s.tube, **skin}),
        "MeshCut.cut": (s.cut, {}),
        "MeshCut.embed": (s.cut, {"cut": s.cut.cut()}),
        "Thickness": (lib, {**skin, "progress": going}),
        "Thickness.at": (s.thickness, {"points": s.vertices}),
        "Thickness.covering": (s.thickness, {"points": s.vertices, "tolerance": 0.1}),
        "TargetSet": (lib, {"bones": [1], "names": ["a", "b"], "poses": [s.local, s.turned],
                            "radii": [0.0, 1.0], **s.channels}),
        "PoseSpace": (lib, {"sets": [s.set]}),
        "PoseSpace.distances": (s.space, {"local": s.turned[None], "channels": [[0.5]]}),
        "PoseSpace.weights": (s.space, {"local": s.turned[None], "channels": [[0.5]]}),
        "MorphTarget": (lib, {"name": "flexed", "displacement": s.shape, **material, "set": 0, "shifted": False}),
        "SoftBody": (lib, {"mesh": s.mesh, "fill": s.ones, "stiffness": s.ones, "region_weights": s.ones[:, None],
                           "pinned": s.pinned.tolist(), "weights": np.ones((s.n, 1)), "hold": s.ones}),
        "Collider": (lib, {"points": s.collider_points, "triangles": s.collider_triangles, "one_sided": False}),
        "Collider.signed_distances": (s.collider, {"points": s.vertices}),
        "ColliderMotion": (lib, {"collider": s.collider, "motion": np.repeat(s.bones, 2, 0),
                                 "friction": np.array([0.5]), "active": np.array([True])}),
        "SelfContact": (lib, s.own),
        "LocalResponses": (lib, {"model": s.full, **s.places, "centers": [0, 1]}),
        "Contact": (lib, {"model": s.reduced, **s.samples, "residual_shapes": np.zeros((2, len(s.points), 3)),
                          "local": s.dents, "found": dynamorph.Contact(s.reduced, **s.samples).found}),
        "SoftBody.extend_shapes": (s.body, {"embedding": s.embedding,
                                            "surfaces": np.zeros((2, len(s.embedding.nodes), 3))}),
        "FullModel": (lib, {"body": s.body, "targets": s.targets, "material_model": s.material_model,
                            "blending": s.blending}),
        "FullModel.linear_modes": (s.full, {"target": 0, "k": 4}),
        "ReducedTables": (lib, {"material_model": s.material_model, **{
            name: getattr(s.with_responses, name) for name in (
            "basis", "lame_lambda", "lame_mu", "responses", "response_lambda", "response_mu", "relaxation")}}),
        "ReducedModel": (lib, {"body": s.body, "targets": s.targets, "tables": s.tables, "blending": s.blending}),
        "Skin": (lib, {"model": s.full, **points}),
        "Skin.displacement": (s.skin, {"weights": s.weights, "q": r}),
        "Skin.positions": (s.skin, {"bones": s.bones, "weights": s.weights, "q": r}),
        "Skin.pull_back": (s.skin, {"bones": s.bones, "forces": np.ones((len(s.embedding.nodes), 3))}),
        "MotionLimit": (lib, {"model": s.own_full, **own_limits}),
        "Grabs": (lib, {"skin": s.skin, "points": np.array([0, 3]), "goals": np.zeros((1, 2, 3)),
                        "stiffness": np.ones(2)}),
        "Simulation": (lib, {"model": s.reduced, **s.parts, **options, "keep_going": lambda: True}),
        "Simulation.advance": (started, {"bones": s.next[None], "weights": s.weights[None], **push, "grabs": s.grabs,
                                         "colliders": [s.collider_motion], **in_steps}),
        "Simulation.balance_targets": (started, {"bones": np.repeat(s.bones[None], 2, 0)}),
        "Simulation.solve_static": (started, {"bones": s.bones, "weights": s.weights, **push, "guess": r,
                                              "stiffness": moment["stiffness"]}),
        "Simulation.start": (started, {"now": s.bones, "next": s.next, "weights": s.weights,
                                       "colliders": [s.collider_motion], **moment, "grabs": s.grabs}),
        "Simulation.state": (started, {"value": state}),
        "State": (lib, {name: getattr(state, name) for name in ("coordinates", "bones", "limit", "contact", "dents")}),
        "StepReport": (lib, {}),
        "Coupling": (lib, {"bodies": coupled_bodies(), "friction": 0.5, "garments": [(0, 1, np.eye(4)[:3])]}),
        "Coupling.advance": (lambda: dynamorph.Coupling(coupled_bodies()), {"motions": [moving, moving]}),
        "closed_surface": (lib, skin),
        "embed": (lib, {"mesh": s.mesh, "points": 0.9 * s.nodes}),
        "extend_to_nodes": (lib, {"mesh": s.mesh, "embedding": s.embedding,
                                  "values": np.ones((len(s.embedding.nodes), 2))}),
        "fill_fractions": (lib, {"mesh": s.tube, **skin, "progress": going}),
        "instruction_set": (lib, {}),
        "adapt_response_basis": (lib, {"model": s.full, "U": s.response_basis.U, "W": s.response_basis.W}),
        "make_basis": (lib, {"model": s.full, "r": 6, "progress": going}),
        "make_cage_surface": (lib, {**skin, "target_vertices": 60, "progress": going}),
        "make_response_basis": (lib, {"model": s.full, "r": 5, "h": 6, "progress": going}),
        "measure_deformation": (lib, {"rest": s.vertices, "triangles": s.triangles,
                                      "edges": [s.triangles[:, :2], s.triangles[:, 1:]], "coordinates": np.eye(2),
                                      "modes": 0.1 * np.stack([s.vertices, s.vertices]), "progress": going}),
        "pinned": (lib, {"mesh": s.tube, **skin, "heads": s.heads, "tails": s.tails, "ratio": 0.4}),
        "points_on_bones": (lib, {**skin, "skin": 0.8 * s.vertices, "skin_triangles": s.triangles, "heads": s.heads,
                                  "tails": s.tails, "ratio": 0.4}),
        "reduce": (lib, {"model": s.full, "U": s.basis.U, "progress": going}),
        "symmetric_like": (lib, {"mesh": s.tube, **skin}),
        "shape_by_physics": (lib, {"mesh": s.mesh, "stiffness": s.ones, "weights": bent, "rest": s.nodes,
                                   "embedding": dynamorph.embed(s.mesh, s.nodes), "skin_weights": bent,
                                   "triangles": s.limits["triangles"], "thickness": np.full(s.n, 0.05),
                                   "path": [np.repeat(s.bones, 2, 0), np.concatenate([s.bones, turned])],
                                   "progress": going}),
        "set_threads": (lib, {"limit": 2}),
        "tetrahedralize": (_mesher, {**skin, "target_nodes": 120, "inner": np.array([[0.0, 0.0, 1.0]])}),
        "unpack_model": (lib, {"buffer": b"\0" * 16}),
    }  # fmt: skip
    for kind, model, zero in (("FullModel", s.full, q), ("ReducedModel", s.reduced, r)):
        found |= {
            f"{kind}.displacement": (model, {"q": zero}),
            f"{kind}.energy": (model, {"weights": s.weights, "q": zero}),
            f"{kind}.inertia": (model, {"bones": s.bones, "density": 1000.0}),
            f"{kind}.linearize": (model, {"weights": s.weights, "q": zero}),
            f"{kind}.target": (model, {"target": 1}),
        }
    return found


# What the stubs say --------------------------------------------------------------------------------------------------


@cache
def declared() -> dict[str, dict[str, str]]:
    """The types of the parameters of each callable in the stubs, by name; of overloads the first. Enumerations and
    exceptions are left out: pybind11 makes them. So are the two that pickle calls, see test_contact.py.
    """
    found: dict[str, dict[str, str]] = {}
    for node in (each for stub in STUBS for each in ast.parse(stub.read_text(encoding="utf-8")).body):
        if isinstance(node, ast.FunctionDef):
            found.setdefault(node.name, types_of(node))
        elif isinstance(node, ast.ClassDef) and not node.bases and not is_enumeration(node):
            for method in (each for each in node.body if isinstance(each, ast.FunctionDef)):
                decorators = {ast.unparse(each) for each in method.decorator_list}
                if "property" not in decorators and method.name not in ("__getstate__", "__setstate__"):
                    name = node.name if method.name == "__init__" else f"{node.name}.{method.name}"
                    found.setdefault(name, types_of(method))
    return found


def is_enumeration(node: ast.ClassDef) -> bool:
    return any(isinstance(each, ast.AnnAssign) and ast.unparse(each.target) == "__members__" for each in node.body)


def types_of(function: ast.FunctionDef) -> dict[str, str]:
    every = [*function.args.args, *function.args.kwonlyargs]
    names = {"arg1": "value"}  # of a setter
    return {names.get(each.arg, each.arg): ast.unparse(each.annotation) for each in every if each.annotation}


# Bad input -----------------------------------------------------------------------------------------------------------


def bad_arrays(good: np.ndarray) -> Iterator[tuple[str, object]]:
    """Of a type that takes an array."""
    good = np.asarray(good)
    whole = good.dtype.kind == "i"
    wrong = (-1, 2**31 - 1, 2**31, 2**62) if whole else (math.nan, math.inf, 1e300, -1e300, 1e-320)
    for number in wrong:
        yield f"all {number}", np.full(good.shape, number)
    changed = good.astype(np.int64 if whole else float)
    changed.flat[-1:] = wrong[0]
    yield f"last {wrong[0]}", changed
    yield "flat", good.reshape(-1)
    yield "deeper", good[None]
    yield "a number", good.reshape(-1)[0] if good.size else 0.0
    for axis in range(good.ndim):
        yield f"shorter in {axis}", np.delete(good, slice(-1, None), axis)
        yield f"longer in {axis}", np.concatenate([good, good.take([0], axis)], axis) if good.size else np.ones((1, 3))
        yield f"none in {axis}", good.take([], axis)
    yield "texts", np.full(good.shape, "x")
    yield "objects", np.full(good.shape, None)
    yield "complex", good.astype(complex)
    yield "booleans", good.astype(bool)
    yield "fractions", good + 0.5
    yield "backward", good[::-1]
    yield "of single precision", good.astype(np.float32)
    yield "ragged", [[0.0], [0.0, 1.0]]
    yield from BAD


BAD: list[tuple[str, object]] = [("None", None), ("a text", "x"), ("an object", object()), ("a dictionary", {})]
INTEGERS = (-1, -(2**31), 0, 1, 2, 2**31 - 1, 2**31, 2**63, 2**100, 1.5, math.nan, True)
NUMBERS = (math.nan, math.inf, -math.inf, 0.0, -1.0, 1e300, 1e-300, 10**400, True)


def bad_values(kind: str, good: object) -> Iterator[tuple[str, object]]:
    """What a parameter of this type invites; good: a value that it takes."""
    kind = kind.removesuffix(" | None")
    if kind.startswith("typing.Annotated[numpy"):
        yield from bad_arrays(good)
    elif kind.startswith("tuple[") or kind.startswith("collections.abc.Sequence"):
        yield from bad_sequences(kind, list(good))
    elif kind == "typing.SupportsInt | typing.SupportsIndex":
        yield from ((str(number), number) for number in INTEGERS)
        yield from BAD
    elif kind == "typing.SupportsFloat | typing.SupportsIndex":
        yield from ((str(number), number) for number in NUMBERS)
        yield from BAD
    elif kind == "str":
        yield from (("nothing", ""), ("a zero", "a\0b"), ("half a character", "\ud800"), ("bytes", b"x"), *BAD)
    elif kind == "typing.Any":
        yield from (("no answer", lambda *_: None), ("a text as answer", lambda *_: "x"), ("stop", lambda *_: False))
        yield from (("raises", raises), ("too many arguments", lambda _a, _b, _c: True), *BAD[1:])
    else:  # an enumeration, a class of the engine, bool, bytes
        yield from BAD
        yield from (("a number", 7), ("another class", scene().set), ("an array", np.zeros((2, 2))))
        if hasattr(type(good), "__members__"):
            yield "no member", type(good)(7)
        if isinstance(good, dynamorph.TetMesh):
            yield "no tets", dynamorph.TetMesh(np.zeros((0, 3)), np.zeros((0, 4), int))
            yield "another mesh", scene().tube
        if isinstance(good, dynamorph.Embedding):
            yield "another embedding", dynamorph.embed(scene().tube, scene().vertices)


def bad_sequences(kind: str, good: list) -> Iterator[tuple[str, object]]:
    yield from (("nothing", []), ("one less", good[:-1]), ("one more", [*good, good[-1]]), ("many", good * 500), *BAD)
    whole = kind.startswith("tuple[")
    inner = kind.partition("[")[2][:-1]
    if whole:  # of a state (coordinates, bones' transforms, ...), the first two each of four; of a body; of a motion
        for at, part in enumerate(good):
            if isinstance(part, np.ndarray):
                for name, value in bad_arrays(part):
                    yield f"{at} {name}", (*good[:at], value, *good[at + 1 :])
            elif isinstance(part, list) and isinstance(part[0], np.ndarray):
                one = "typing.Annotated[numpy, collections.abc.Sequence]"
                for name, value in bad_values(one, part[-1]):
                    yield f"{at} last {name}", (*good[:at], [*part[:-1], value], *good[at + 1 :])
                yield f"{at} shorter", (*good[:at], part[:-1], *good[at + 1 :])
            else:
                for name, value in BAD:
                    yield f"{at} {name}", (*good[:at], value, *good[at + 1 :])
        return
    for name, value in bad_values(inner, good[-1]):
        yield f"last {name}", [*good[:-1], value]


class RaisedInside(Exception):
    """By a callback."""


def raises(*_: object) -> bool:
    raise RaisedInside


# The calls -----------------------------------------------------------------------------------------------------------


@cache
def cases() -> list[tuple[str, str, str]]:
    """(callable, parameter, what is bad) of all calls, without what would take the memory of all machines."""
    found = []
    for name, types in declared().items():
        _, good = calls()[name]
        for parameter, kind in types.items():
            found += [(name, parameter, how) for how, _ in bad_values(kind, good[parameter])]
    return found


def value_of(name: str, parameter: str, how: str) -> object:
    return dict(bad_values(declared()[name][parameter], calls()[name][1][parameter]))[how]


def call(name: str, arguments: dict) -> object:
    """Call it and use what it made."""
    owner = calls()[name][0]
    if callable(owner) and not isinstance(owner, type(dynamorph)):
        owner = owner()
    member = name.rpartition(".")[2]
    if member == "state":
        return gone_on(arguments["value"]), None, owner
    made = getattr(owner, member)(**arguments)
    return made, USES[name](made) if name in USES else None, owner


def has_nan(value: object, deep: int = 3) -> bool:
    """Whether there is one in what a call returned, or in the properties of the engine's objects in it."""
    if isinstance(value, float):
        return math.isnan(value)
    if isinstance(value, np.ndarray):
        return value.dtype.kind == "f" and bool(np.isnan(value).any())
    if isinstance(value, (list, tuple)):
        return any(has_nan(each, deep) for each in value)
    if isinstance(value, dict):
        return has_nan(list(value.values()), deep)
    if hasattr(value, "toarray"):
        return has_nan(value.toarray())
    if type(value).__module__.startswith("dynamorph") and deep and not hasattr(type(value), "__members__"):
        names = [name for name, member in vars(type(value)).items() if isinstance(member, property)]
        return any(has_nan(getattr(value, name), deep - 1) for name in names)
    return False


def outcome(name: str, parameter: str, how: str) -> str:
    """The outcome of a call: "refused", "taken", or what is wrong with it."""
    value = value_of(name, parameter, how)
    try:
        result = call(name, calls()[name][1] | {parameter: value})
    except (*EXPECTED, RaisedInside) as error:
        return "refused" if str(error) or isinstance(error, RaisedInside) else f"{type(error).__name__} without a word"
    except BaseException as error:  # whatever it is, it is reported
        return f"{type(error).__name__}: {error}"[:200]
    return "NaN" if has_nan(result) else "taken"


def main(first: int) -> None:
    np.seterr(all="ignore")
    np.set_printoptions(threshold=1, edgeitems=1)  # pybind11 writes all arguments into its refusals
    for number in range(first, len(cases())):
        print(json.dumps([number, None]), flush=True)
        print(json.dumps([number, outcome(*cases()[number])]), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]))
