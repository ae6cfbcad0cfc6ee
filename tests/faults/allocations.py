# SPDX-License-Identifier: GPL-3.0-or-later
"""Fails the n-th allocation of the engine in each of its calls; tests/engine/test_allocations.py runs it.

    LD_PRELOAD=fail_nth.so python tests/faults/allocations.py SAMPLES      of each call; 0: every n

Each failure, in a process of its own, must be a MemoryError or change nothing; afterward the same call on the same
objects must return what it did before.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import dynamorph as dm
import scenes
from dynamorph import _mesher

fail_malloc = ctypes.CDLL(os.environ["LD_PRELOAD"]).fail_malloc
fail_malloc.argtypes, fail_malloc.restype = [ctypes.c_long], ctypes.c_long


class Scene:
    """A bar with two targets and a tube, as small as the engine takes."""

    def __init__(self):
        self.nodes, tets = scenes.bar((3, 1, 1), (0.4, 0.1, 0.1))
        self.mesh = dm.TetMesh(self.nodes, tets)
        pinned = self.nodes[:, 0] < 1e-9
        ones = np.ones(len(tets))
        body = dm.SoftBody(self.mesh, ones, ones, ones[:, None], pinned, np.ones((len(self.nodes), 1)))
        material = {
            "lame_lambda": 1e4, "lame_mu": 1e4, "density": 1e3, "mass_damping": 1.0, "stiffness_damping": 1e-3
        }  # fmt: skip
        bent = np.zeros((len(self.nodes), 3))
        bent[~pinned, 1] = 0.02 * self.nodes[~pinned, 0]
        shapes = {"rest": 0.0 * bent, "bent": bent}
        self.targets = [dm.MorphTarget(name, shape, **material) for name, shape in shapes.items()]
        self.body = body
        self.full = dm.FullModel(body, self.targets, dm.MaterialModel.STABLE_STVK, dm.Blending.EVEN)
        self.basis = dm.make_basis(self.full, 3)
        self.tables = dm.reduce(self.full, self.basis.U)
        self.reduced = dm.ReducedModel(body, self.targets, self.tables, dm.Blending.EVEN)
        self.skin, faces = scenes.tube(5, 6)
        fans = [[f[0], f[k], f[k + 1]] for f in faces for k in range(1, len(f) - 1)]
        self.triangles = np.array(fans, np.int32)
        self.cage = dm.TetMesh(*_mesher.tetrahedralize(self.skin, self.triangles, 60))
        self.bones = np.hstack([np.eye(3), np.zeros((3, 1))])[None]
        self.moved = self.bones + 0.01 * np.eye(3, 4)[None]
        self.weights = np.array([0.5, 0.5])
        self.model_file = (Path(__file__).parents[1] / "golden" / "model.dynamorph").read_bytes()

        models = {"full": self.full, "reduced": self.reduced}
        self.simulations = {kind: dm.Simulation(model, 0.01) for kind, model in models.items()}
        points = 0.9 * self.nodes
        self.points = {"rest": points, "embedding": dm.embed(self.mesh, points), "weights": np.ones((len(points), 1))}
        self.reduced_skin = dm.Skin(self.reduced, **self.points)
        faces = self.mesh.tets[:, [0, 2, 1]].astype(np.int32)
        self.limits = {
            "rest": self.nodes,
            "embedding": dm.embed(self.mesh, self.nodes),
            "triangles": faces,
            "weights": np.ones((len(self.nodes), 1)),
            "distances": np.full(len(self.nodes), 1e-3),
        }
        self.simulations |= {
            f"limited {kind}": dm.Simulation(model, 0.01, limit=dm.MotionLimit(model, **self.limits))
            for kind, model in models.items()
        }
        self.grabs = dm.Grabs(self.reduced_skin, [0, 1], points[None, :2] + 0.01, [10.0, 20.0])
        self.poses = np.repeat(np.eye(4)[None], 2, 0)
        self.poses[1, 1:3, 1:3] = [[0.6, -0.8], [0.8, 0.6]]
        self.set = dm.TargetSet([1], ["a", "b"], [np.repeat(np.eye(4)[None], 2, 0), self.poses])
        self.space = dm.PoseSpace([self.set])
        self.cut = dm.MeshCut(self.cage, self.skin, self.triangles)

    def step(self, kind: str):
        simulation = self.simulations[kind]
        simulation.start(self.bones, self.moved, self.weights)
        simulation.advance(self.moved[None], self.weights[None])
        return simulation.coordinates

    def grabbed_step(self):
        simulation = self.simulations["reduced"]
        simulation.start(self.bones, self.moved, self.weights)
        simulation.advance(self.moved[None], self.weights[None], grabs=self.grabs)
        return self.reduced_skin.positions(self.moved, self.weights, simulation.coordinates)

    def response_basis(self):
        basis = dm.make_response_basis(self.full, 3, 2)
        basis = dm.adapt_response_basis(self.full, basis.U, basis.W)
        return dm.reduce(self.full, basis).lame_mu


def calls(scene: Scene) -> dict[str, Callable]:
    """What returns arrays. Not the meshers, which have processes of their own: without memory TetGen crashes, and CGAL
    does not work in that process any more.
    """
    heads, tails = np.array([[0.0, 0.0, 0.2]]), np.array([[0.0, 0.0, 1.8]])
    at_rest = np.zeros(scene.full.dofs)
    return {
        "closed_surface": lambda: dm.closed_surface(scene.skin, scene.triangles)[:2],
        "embed": lambda: dm.embed(scene.cage, 0.9 * scene.skin).weights,
        "fill": lambda: dm.fill_fractions(scene.cage, scene.skin, scene.triangles),
        "pinned": lambda: dm.pinned(scene.cage, scene.skin, scene.triangles, heads, tails, 0.4),
        "cut": lambda: scene.cut.embed(scene.cut.cut()).weights,
        "linearize": lambda: scene.full.linearize(scene.weights, at_rest)[:2],
        "basis": lambda: dm.make_basis(scene.full, 3).U,
        "reduce": lambda: dm.reduce(scene.full, scene.basis.U).lame_mu,
        "response_basis": scene.response_basis,
        "full_step": lambda: scene.step("full"),
        "reduced_step": lambda: scene.step("reduced"),
        "grabbed_step": scene.grabbed_step,
        "limited_full_step": lambda: scene.step("limited full"),
        "limited_reduced_step": lambda: scene.step("limited reduced"),
        "weights": lambda: scene.space.weights(scene.poses[None]),
        "model_file": lambda: dm.unpack_model(scene.model_file)[0]["nodes"],
    }


def constructors(scene: Scene) -> dict[str, Callable]:
    """What makes an object."""
    even = dm.Blending.EVEN
    return {
        "TetMesh": lambda: dm.TetMesh(scene.nodes, scene.mesh.tets),
        "FullModel": lambda: dm.FullModel(scene.body, scene.targets, dm.MaterialModel.STVK, even),
        "ReducedModel": lambda: dm.ReducedModel(scene.body, scene.targets, scene.tables, even),
        "FullSimulation": lambda: dm.Simulation(scene.full, 0.01),
        "ReducedSimulation": lambda: dm.Simulation(scene.reduced, 0.01),
        "FullSkin": lambda: dm.Skin(scene.full, **scene.points),
        "FullMotionLimit": lambda: dm.MotionLimit(scene.full, **scene.limits),
        "ReducedMotionLimit": lambda: dm.MotionLimit(scene.reduced, **scene.limits),
        "symmetric": lambda: dm.symmetric_like(scene.cage, scene.skin, scene.triangles),
        "MeshCut": lambda: dm.MeshCut(scene.cage, scene.skin, scene.triangles),
        "PoseSpace": lambda: dm.PoseSpace([scene.set]),
    }


FINE, REFUSED, OTHER = 0, 1, 2  # exit codes: all the same; MemoryError; another error or another result
PYBIND = 2  # last allocations of a constructor, where pybind11 notes the new object: if it cannot, it ends the process


def digest(found) -> str:
    arrays = found if isinstance(found, tuple) else (found,) if isinstance(found, np.ndarray) else ()
    return hashlib.sha256(b"".join(np.ascontiguousarray(each).tobytes() for each in arrays)).hexdigest()


def tried(call: Callable, n: int) -> tuple[str | None, int]:
    """The digest of a call whose n-th allocation fails, None when it raises MemoryError; how many there were."""
    fail_malloc(n)
    try:
        found = call()
    except MemoryError:
        found = None
    finally:
        count = fail_malloc(0)
    return None if found is None else digest(found), count


def survives(call: Callable, n: int, expected: str) -> int:
    """The outcome of one failing allocation, in a process of its own: its exit code, or minus a signal."""
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    os.close(2)  # what the C library says of a crash
    code = OTHER
    try:
        found, _ = tried(call, n)
        if found in (None, expected) and tried(call, 0)[0] == expected:  # and the same objects serve on
            code = FINE if found else REFUSED
    finally:
        os._exit(code)


def attack(call: Callable, samples: int, spared: int) -> dict:
    call()  # what is allocated once
    expected, count = tried(call, 0)
    count -= spared
    every = range(1, count + 1) if not samples else np.unique(np.linspace(1, count, samples).astype(int)).tolist()
    codes = {n: survives(call, n, expected) for n in every}
    return {
        "allocations": count,
        "tried": len(codes),
        "refused": sum(code == REFUSED for code in codes.values()),
        "wrong": [n for n, code in codes.items() if code == OTHER],
        "crashed": [n for n, code in codes.items() if code < 0],
    }


def main(samples: int) -> None:
    dm.set_threads(1)  # no others are there after a fork
    scene = Scene()
    found = {name: attack(call, samples, 0) for name, call in calls(scene).items()}
    found |= {name: attack(call, samples, PYBIND) for name, call in constructors(scene).items()}
    print(json.dumps(found))


if __name__ == "__main__":
    main(int(sys.argv[1]))
