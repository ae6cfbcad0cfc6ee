# SPDX-License-Identifier: GPL-3.0-or-later
"""`make convergence`: how much the motion of an unreduced body depends on the number of its cage's nodes.

    python evidence/convergence.py --sizes 2000 4000 8000

Motions stay in build/convergence: with --keep a size that was simulated is not simulated again. The figures go to
docs/convergence.json, from which believable.py makes a section of its page. The largest cage takes about two minutes.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import replace
from functools import partial

import fresh_blender  # noqa: F401
from project import ROOT

import believable_bake
import bpy
import characters
import dynamic_morph_targets
import numpy as np
from assets import require
from contact_sheet import quiet
from dynamic_morph_targets.core.character import Target
from dynamic_morph_targets.core.material import calibration
from dynamic_morph_targets.core.motion import simulate
from dynamic_morph_targets.core.motion.rig_samples import RigSamples
from dynamic_morph_targets.run.bake import batch
from dynamic_morph_targets.run.bake.job import Job
from measured import measured_at

CACHE = ROOT / "build" / "convergence"
FIGURES = ROOT / "docs" / "convergence.json"
BODY = characters.ASSETS / "mh_male_53bones.blend"
SIZES = (2000, 4000, 8000, 16000)  # nodes asked for
FRAMES = 24


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES, help="nodes of the cages; default: all four")
    parser.add_argument("--keep", action="store_true", help="simulate only what was not simulated before")
    arguments = parser.parse_args()
    require("convergence", [BODY.name])
    CACHE.mkdir(parents=True, exist_ok=True)
    dynamic_morph_targets.register()
    job, rig = shot()
    stiffness = None
    for size in sorted({SIZES[0], *arguments.sizes}):
        kept = read(size) if arguments.keep else None
        if kept is None:
            kept = simulated(job, rig, size, stiffness)
        stiffness = stiffness or kept["stiffness"]
        print(f"{size}: {kept['nodes']} nodes, {kept['stiffness']:.0f} Pa, {kept['seconds']:.0f} s", flush=True)
    found = compare({SIZES[0], *arguments.sizes})
    FIGURES.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(f"written to {FIGURES.relative_to(ROOT)}: {found[0]['own']:.1%} from {found[0]['asked']} nodes to the most")
    return 0


def shot() -> tuple[Job, RigSamples]:
    """The body after one click, and the liveliest frames of its liveliest clip."""
    with quiet():
        characters.open_file(BODY)
        body = characters.largest_skinned()
        believable_bake.FRAMES = FRAMES
        believable_bake.choose_clip(characters.armature_of(body))
        bpy.context.view_layer.objects.active = body
        bpy.ops.dynamorph.add_soft_skin()
        job = Job(body, "BAKE", whole=True, stored=False)
        return job, batch.read_rig(job)


def simulated(job: Job, rig: RigSamples, size: int, stiffness: float | None) -> dict:
    """Simulates the shot in a cage of this size, unreduced: with the stiffness that its own frequency asks for, and,
    where there is one, with another cage's stiffness. Keeps both motions."""
    began = time.perf_counter()
    frames = len(job.input.settings.frames)
    character = job.input.character.with_settings(solver="FULL", modes=frames, cage_nodes=size)
    model = simulate.build_for(character, rig, job.input.settings)
    character = calibration.calibrated(character, calibration.reference(model, character))
    own = character.targets[0].material.stiffness
    figures = {
        "nodes": len(model.nodes),
        "tets": len(model.tets),
        "stiffness": own,
        "frames": frames,
        "commit": measured_at("believable.md"),
        "frequency": character.targets[0].frequency,
    }
    own_motion = motion(job, rig, model, character)
    fixed = own_motion
    if stiffness is not None:
        fixed = motion(job, rig, model, character.with_targets(partial(stiffened, stiffness / own)))
    figures["seconds"] = time.perf_counter() - began
    np.savez(CACHE / f"{size}.npz", own=own_motion, fixed=fixed, areas=areas(character))
    (CACHE / f"{size}.json").write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    return figures


def stiffened(factor: float, _index: int, target: Target) -> Target:
    return replace(target, material=replace(target.material, stiffness=target.material.stiffness * factor))


def motion(job: Job, rig: RigSamples, model, character) -> np.ndarray:
    """Displacement (F, V, 3) of the surface, bind space."""
    bake, _ = simulate.bake(model, character, rig, job.input.settings)
    return np.array([bake.displacement(k) for k in range(len(bake.frames))]) @ character.to_bind.T


def areas(character) -> np.ndarray:
    """Of the surface about each vertex (V,)."""
    corners = (character.vertices @ character.to_bind.T)[character.triangles]
    thirds = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 6.0
    return np.bincount(character.triangles.ravel(), np.repeat(thirds, 3), len(character.vertices))


def read(size: int) -> dict | None:
    file = CACHE / f"{size}.json"
    return json.loads(file.read_text(encoding="utf-8")) if file.exists() else None


# Comparing ------------------------------------------------------------------------------------------------------------


def compare(sizes) -> list[dict]:
    """Of each size: how far its motion about its mean is from the finest cage's, RMS over the
    surface, of the latter's; and how large it is."""
    sizes = sorted(sizes)
    finest = np.load(CACHE / f"{sizes[-1]}.npz")
    found = []
    for size in sizes:
        these = np.load(CACHE / f"{size}.npz")
        row = {"asked": size, **read(size)}
        for kind in ("fixed", "own"):
            row[kind] = distance(these[kind], finest[kind], finest["areas"])
            row[f"{kind}_size"] = rms(about_mean(these[kind]), finest["areas"])
        found.append(row)
    return found


def about_mean(motion: np.ndarray) -> np.ndarray:
    return motion - motion.mean(axis=0)


def distance(motion: np.ndarray, reference: np.ndarray, areas: np.ndarray) -> float:
    return rms(about_mean(motion) - about_mean(reference), areas) / rms(about_mean(reference), areas)


def rms(motion: np.ndarray, areas: np.ndarray) -> float:
    return float(np.sqrt(np.einsum("fvc,v->", motion**2, areas) / areas.sum() / len(motion)))


if __name__ == "__main__":
    sys.exit(main())
