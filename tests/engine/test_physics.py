# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine against analytic solutions, invariants and an independent integrator."""

import threading

import dynamorph
import numpy as np
import pytest
from scenes import bar
from scipy.integrate import solve_ivp
from scipy.linalg import eigh
from scipy.signal import argrelmax
from scipy.spatial.transform import Rotation

MATERIAL_MODELS = list(dynamorph.MaterialModel.__members__.values())
BLENDINGS = list(dynamorph.Blending.__members__.values())
EULER, BDF2 = dynamorph.Integrator.EULER, dynamorph.Integrator.BDF2
ONE = np.ones(1)


def lame(young, poisson):
    return {
        "lame_lambda": young * poisson / ((1 + poisson) * (1 - 2 * poisson)),
        "lame_mu": young / (2 * (1 + poisson)),
    }


def cantilever(
    cells, size, young=1e5, poisson=0.0, material_model=dynamorph.MaterialModel.LINEAR, density=1000.0, **damping
):
    """A bar pinned at x = 0 on one bone, with one target: its rest shape."""
    nodes, tets = bar(cells, size)
    count = np.ones(len(tets))
    body = dynamorph.SoftBody(
        dynamorph.TetMesh(nodes, tets), count, count, count[:, None], nodes[:, 0] < 1e-9, np.ones((len(nodes), 1))
    )
    target = dynamorph.MorphTarget(
        "rest", np.zeros_like(nodes), young=young, poisson=poisson, density=density, **damping
    )
    return dynamorph.FullModel(body, [target], material_model, dynamorph.Blending.FORCES), nodes


def bones(rotation=None, translation=(0, 0, 0)):
    """One bone's transform (1, 3, 4)."""
    matrix = np.eye(3) if rotation is None else rotation.as_matrix()
    return np.hstack([matrix, np.reshape(translation, (3, 1))])[None]


def hold(simulation, steps):
    """Advance with the bone at rest."""
    return simulation.advance(np.repeat(bones()[None], steps, axis=0), np.ones((steps, 1)))


def displaced(simulation, q):
    """Put a simulation at rest at coordinates q: bones at the identity, no velocity."""
    simulation.start(bones(), bones(), ONE)
    simulation.state = dynamorph.State([q] * 4, simulation.state.bones)


def simulation_displacement(simulation, q):
    model = simulation.model
    return model.displacement(q)[model.body.free_nodes].ravel()


def test_cantilever_bends_as_timoshenko_says():
    """Deflection under gravity tends to the beam's as the mesh is refined: w = q L^4 / 8 E I + q L^2 / 2 k G A."""
    length, side, young, density, g = 1.0, 0.25, 1e6, 1000.0, 9.81
    area, inertia, shear = side**2, side**4 / 12, young / 2
    q = density * area * g
    beam = q * length**4 / (8 * young * inertia) + q * length**2 / (2 * 5 / 6 * shear * area)
    errors = []
    for n in (2, 4, 8):
        model, nodes = cantilever((4 * n, n, n), (length, side, side), young, density=density)
        simulation = dynamorph.Simulation(model, 0.01, gravity=(0, 0, -g))
        coordinates, _ = simulation.solve_static(bones(), ONE)
        tip = -model.displacement(coordinates)[nodes[:, 0] > length - 1e-9, 2].mean()
        errors.append(1 - tip / beam)
    assert errors[2] < 0.06  # linear tetrahedra are too stiff in bending ...
    assert errors[1] / errors[2] > 3  # ... by a second-order error
    extrapolated = errors[2] - (errors[1] - errors[2]) / 3
    assert abs(extrapolated) < 0.015  # of a beam only four times as long as high


def test_axial_mode_has_the_rod_s_frequency():
    """omega = pi / 2 L sqrt(E / rho) for a rod pinned at one end (Poisson's ratio 0)."""
    model, nodes = cantilever((20, 2, 2), (1.0, 0.1, 0.1), young=1e6)
    omega, shapes = model.linear_modes(0, 8)
    axial = np.abs(shapes.reshape(-1, 3, 8)[:, 0].sum(axis=0)).argmax()
    assert omega[axial] == pytest.approx(np.pi / 2 * np.sqrt(1e6 / 1000), rel=3e-3)


def one_mode_oscillator(h, integrator, mode=0):
    """The first mode alone, as a reduced linear model: an undamped oscillator of known frequency."""
    model, _ = cantilever((8, 2, 2), (0.4, 0.1, 0.1), young=5e4)
    omega, shapes = model.linear_modes(0, mode + 1)
    basis = shapes[:, mode : mode + 1] * np.sqrt(1000.0)  # orthonormal for unit density
    tables = dynamorph.reduce(model, basis)
    nodes = len(model.displacement(np.zeros(model.dofs)))
    target = dynamorph.MorphTarget("rest", np.zeros((nodes, 3)), density=1000.0, **lame(5e4, 0.0))
    reduced = dynamorph.ReducedModel(model.body, [target], tables, dynamorph.Blending.FORCES)
    return dynamorph.Simulation(reduced, h, integrator=integrator, tolerance=1e-12), omega[mode], basis


@pytest.mark.parametrize(("integrator", "order"), [(EULER, 1), (BDF2, 2)])
def test_free_oscillator_converges_to_the_analytic_motion(integrator, order):
    """z(t) = cos(omega t) after a quarter of the sway and three more, with the order the integrator claims."""
    errors = []
    for steps in (800, 1600, 3200):
        _, omega, _ = one_mode_oscillator(1.0, integrator)
        end = 3.25 * 2 * np.pi / omega
        simulation, _, _ = one_mode_oscillator(end / steps, integrator)
        # A past on the exact trajectory: the integrator's own error alone is measured.
        simulation.start(bones(), bones(), ONE)
        past = [np.array([np.cos(-k * omega * end / steps)]) for k in range(4)]
        simulation.state = dynamorph.State(past, simulation.state.bones)
        hold(simulation, steps)
        errors.append(abs(simulation.coordinates[0] - np.cos(omega * end)))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(orders > order - 0.25)


def test_damping_decays_as_rayleigh_s():
    """The peaks of a mode fall by exp(-2 pi zeta / sqrt(1 - zeta^2)), zeta = (alpha / omega + beta omega) / 2."""
    alpha, beta = 1.0, 0.0005
    model, _ = cantilever((8, 2, 2), (0.4, 0.1, 0.1), young=5e4, mass_damping=alpha, stiffness_damping=beta)
    omega, shapes = model.linear_modes(0, 1)
    zeta = (alpha / omega[0] + beta * omega[0]) / 2
    simulation = dynamorph.Simulation(model, 2 * np.pi / omega[0] / 400)
    displaced(simulation, 1e-3 * shapes[:, 0])
    path = []
    for _ in range(1300):
        hold(simulation, 1)
        path.append(simulation.coordinates @ shapes[:, 0])
    peaks = np.array(path)[argrelmax(np.array(path))]
    assert peaks[1:3] / peaks[:2] == pytest.approx(np.exp(-2 * np.pi * zeta / np.sqrt(1 - zeta**2)), rel=0.01)


@pytest.mark.parametrize("integrator", [EULER, BDF2])
@pytest.mark.parametrize("material_model", MATERIAL_MODELS)
def test_energy_never_grows_without_input(material_model, integrator):
    """Released from a random deformation at a fixed pose, the total energy stays within 1 % of where it began."""
    model, _ = cantilever((4, 2, 2), (0.2, 0.1, 0.1), young=2e4, poisson=0.3, material_model=material_model)
    simulation = dynamorph.Simulation(model, 1 / 240, integrator=integrator)
    rng = np.random.default_rng(5)
    displaced(simulation, 0.01 * rng.standard_normal(model.dofs))
    begin = simulation.elastic_energy + simulation.kinetic_energy
    total = []
    for _ in range(120):
        assert hold(simulation, 1).converged
        total.append(simulation.elastic_energy + simulation.kinetic_energy)
    assert np.isfinite(total).all()
    assert max(total) <= 1.01 * begin
    assert total[-1] < begin


@pytest.mark.parametrize("blending", BLENDINGS)
@pytest.mark.parametrize("material_model", MATERIAL_MODELS)
def test_reduced_energy_never_grows_between_targets(material_model, blending):
    """The same of a reduced model at blended weights, against the energy of the pose's own static solution."""
    model, _, _ = sculpted(material_model, blending, True)
    simulation = simulation_of(model, 1 / 240)
    weights = np.array([0.4, 0.3, 0.3])
    simulation.start(TWO_BONES, TWO_BONES, weights)
    rest = simulation.elastic_energy
    state = simulation.state
    nudge = np.random.default_rng(3).standard_normal(model.dofs) * 0.01 * np.sqrt(0.004)
    simulation.state = dynamorph.State([q + nudge for q in state.coordinates], state.bones)
    begin = simulation.elastic_energy - rest
    total = []
    for _ in range(120):
        assert simulation.advance(TWO_BONES[None], weights[None]).converged
        total.append(simulation.elastic_energy + simulation.kinetic_energy - rest)
    assert max(total) <= 1.01 * begin
    assert total[-1] < begin


@pytest.fixture(scope="module")
def rotating_bar():
    model, nodes = cantilever((3, 1, 1), (0.3, 0.1, 0.1), young=4e4, poisson=0.3, stiffness_damping=0.0)
    _, _, stiffness = model.linearize(ONE, np.zeros(model.dofs))
    mass = model.inertia(bones(), 1000.0).diagonal()
    rest = nodes[model.body.free_nodes]
    return model, stiffness.toarray() / mass[:, None], rest


AXIS = np.array([0.2, 0.5, 1.0]) / np.linalg.norm([0.2, 0.5, 1.0])


def angle(t):
    """A rotation that starts at rest, speeds up and slows down, with its first and second derivatives."""
    return 1.5 * (1 - np.cos(4 * t)), 6 * np.sin(4 * t), 24 * np.cos(4 * t)


def rotating_frame(rotating_bar, end):
    """u(end) of the same bar from its equation of motion in the rotating frame: Euler, Coriolis, centrifugal terms."""
    _, stiffness, rest = rotating_bar

    def rate(t, y):
        u, v = np.split(y, 2)
        _, speed, acceleration = angle(t)
        omega, alpha = speed * AXIS, acceleration * AXIS
        position, velocity = rest + u.reshape(-1, 3), v.reshape(-1, 3)
        inertial = (
            np.cross(alpha, position) + 2 * np.cross(omega, velocity) + np.cross(omega, np.cross(omega, position))
        )
        return np.concatenate([v, -stiffness @ u - inertial.ravel()])

    size = 2 * rest.size
    # The body moves with the frame before t = 0 as angle() does, which is at rest there: u = 0, u' = 0.
    return solve_ivp(rate, (0, end), np.zeros(size), rtol=1e-9, atol=1e-11).y[: rest.size, -1]


def test_rotating_body_feels_euler_coriolis_and_centrifugal_forces(rotating_bar):
    """A bar on an accelerating, rotating bone, against its equation of motion in the rotating frame."""
    model, _, _ = rotating_bar
    end = 0.5
    exact = rotating_frame(rotating_bar, end)
    errors = []
    for steps in (400, 800, 1600):
        h = end / steps
        simulation = dynamorph.Simulation(model, h, tolerance=1e-12)
        frames = np.array([bones(Rotation.from_rotvec(angle(k * h)[0] * AXIS)) for k in range(steps + 1)])
        simulation.start(frames[0], frames[0], ONE)
        simulation.advance(frames[1:], np.ones((steps, 1)))
        errors.append(np.abs(simulation.coordinates - exact).max() / np.abs(exact).max())
    assert errors[2] < 2e-3
    assert errors[1] / errors[2] > 3.4  # second order


def test_rotating_frame_at_constant_speed_is_centrifugal_statics(rotating_bar):
    """With damping, the bar settles where K u = M omega^2 (X + u) across the axis."""
    speed, h = 5.0, 1 / 500
    model, nodes = cantilever((3, 1, 1), (0.3, 0.1, 0.1), young=4e4, poisson=0.3, stiffness_damping=0.2)
    _, stiffness, rest = rotating_bar
    across = np.kron(np.eye(len(rest)), np.eye(3) - np.outer(AXIS, AXIS))
    exact = np.linalg.solve(stiffness - speed**2 * across, speed**2 * across @ rest.ravel())
    frames = np.array([bones(Rotation.from_rotvec(speed * k * h * AXIS)) for k in range(1500)])
    simulation = dynamorph.Simulation(model, h)
    simulation.start(frames[0], frames[1], ONE)
    simulation.advance(frames[1:], np.ones((len(frames) - 1, 1)))
    assert np.abs(simulation.coordinates - exact).max() < 2e-3 * np.abs(exact).max()


def test_a_sudden_stop_is_a_finite_impulse():
    """A bar moving at 3 m/s whose bone stops within a step: the mode peaks at its momentum over omega, within 3 %."""
    _, omega, _ = one_mode_oscillator(1.0, BDF2)
    h = 0.3 / omega
    simulation, omega, basis = one_mode_oscillator(h, BDF2)
    speed, axis = 3.0, np.abs(basis.reshape(-1, 3).sum(axis=0)).argmax()
    direction = np.eye(3)[axis]
    simulation.start(bones(translation=-speed * h * direction), bones(), ONE)
    peak = 0.0
    for _ in range(40):
        hold(simulation, 1)
        peak = max(peak, abs(simulation.coordinates[0]))
    volumes = simulation.model.body.volumes[:, 0]
    momentum = speed * np.abs((volumes[:, None] * basis.reshape(-1, 3))[:, axis].sum())
    assert peak < 1.001 * momentum / omega
    assert peak > 0.97 * momentum / omega


# Targets -----------------------------------------------------------------------------------------------------------


def sculpture(damping=0.5, cells=(8, 2, 2)):
    """Neutral, a stiff bulge and a soft bend of a bar on two bones; (body, targets, displacements)."""
    nodes, tets = bar(cells, (0.4, 0.1, 0.1))
    count = np.ones(len(tets))
    s = nodes[:, 0] / 0.4
    weights = np.stack([1 - s, s], axis=1)
    body = dynamorph.SoftBody(dynamorph.TetMesh(nodes, tets), count, count, count[:, None], nodes[:, 0] < 1e-9, weights)
    bulge = (nodes - [0, 0.05, 0.05]) * [0, 1, 1] * (0.5 * np.sin(np.pi * s))[:, None]
    bend = np.stack([-0.05 * s**2, 0 * s, 0.12 * s**2], axis=1)
    shapes = [np.zeros_like(nodes), bulge, bend]
    materials = [(2e4, 0.3, 900.0), (1.6e5, 0.4, 1100.0), (8e3, 0.2, 1000.0)]
    targets = [
        dynamorph.MorphTarget(
            name, shape, density=rho, mass_damping=damping, stiffness_damping=0.003, **lame(young, nu)
        )
        for name, shape, (young, nu, rho) in zip("nbs", shapes, materials, strict=True)
    ]
    return body, targets, shapes


def sculpted(material_model, blending, reduced, damping=0.5, modes=12, cells=(8, 2, 2)):
    """A model of that bar; (model, displacements, size)."""
    body, targets, shapes = sculpture(damping, cells)
    model = dynamorph.FullModel(body, targets, material_model, blending)
    if reduced:
        tables = dynamorph.reduce(model, dynamorph.make_basis(model, modes).U)
        model = dynamorph.ReducedModel(body, targets, tables, blending)
    return model, shapes, body.size


def simulation_of(model, h=1 / 120, **options):
    return dynamorph.Simulation(model, h, **options)


TWO_BONES = np.repeat(bones(), 2, axis=0)
FLEXED = np.concatenate([bones(), bones(Rotation.from_euler("y", 70, degrees=True), (0.1, 0, 0.1))])


@pytest.mark.parametrize("reduced", [False, True])
@pytest.mark.parametrize("blending", BLENDINGS)
@pytest.mark.parametrize("material_model", MATERIAL_MODELS)
def test_static_solution_at_a_target_is_the_sculpted_shape(material_model, blending, reduced):
    model, shapes, size = sculpted(material_model, blending, reduced)
    simulation = simulation_of(model, tolerance=1e-9)
    rng = np.random.default_rng(1)
    for j, shape in enumerate(shapes):
        # From the shape with 5 mm of noise on its larger coordinates: the solution is found, not guessed.
        target = model.target(j)
        noise = rng.uniform(-1, 1, model.dofs) * (0.005 if not reduced else 0.005 * np.sqrt(0.004))
        coordinates, report = simulation.solve_static(FLEXED, np.eye(3)[j], guess=target + noise)
        assert report.converged and report.iterations > 0
        assert np.abs(model.displacement(coordinates) - shape).max() < 1e-6 * size


@pytest.mark.parametrize("reduced", [False, True])
@pytest.mark.parametrize("material_model", MATERIAL_MODELS)
def test_a_simulation_comes_to_rest_at_the_target(material_model, reduced):
    """From the neutral's pose to the bulge's in 20 steps, then still: the motion dies out at the sculpted shape."""
    model, shapes, size = sculpted(material_model, dynamorph.Blending.EVEN, reduced, damping=10.0)
    simulation = simulation_of(model, 1 / 60)
    simulation.start(TWO_BONES, TWO_BONES, np.eye(3)[0])
    bulged = np.clip(np.arange(1, 401) / 20, 0, 1)[:, None]
    weights = bulged * np.eye(3)[1] + (1 - bulged) * np.eye(3)[0]
    report = simulation.advance(np.repeat(TWO_BONES[None], len(weights), axis=0), weights)
    assert report.converged
    assert np.abs(model.displacement(simulation.coordinates) - shapes[1]).max() < 1e-5 * size


def test_balanced_targets_do_not_sag_and_gravity_s_difference_still_acts():
    model, shapes, size = sculpted(dynamorph.MaterialModel.STABLE_STVK, dynamorph.Blending.EVEN, True)
    simulation = simulation_of(model, gravity=(0, 0, -9.81))
    weights = np.eye(3)[1]
    sagging, _ = simulation.solve_static(FLEXED, weights)
    assert np.abs(model.displacement(sagging) - shapes[1]).max() > 1e-4 * size
    simulation.balance_targets(np.array([TWO_BONES, FLEXED, TWO_BONES]))
    balanced, _ = simulation.solve_static(FLEXED, weights)
    assert np.abs(model.displacement(balanced) - shapes[1]).max() < 1e-6 * size
    tilted, _ = simulation.solve_static(TWO_BONES, weights)
    assert np.abs(model.displacement(tilted) - shapes[1]).max() > 1e-4 * size


def test_stiff_target_answers_a_push_less_than_the_soft_one():
    """The dynamic property of a dynamic morph target: one force, two stiffnesses."""
    model, shapes, _ = sculpted(dynamorph.MaterialModel.STVK, dynamorph.Blending.EVEN, False)
    push = np.zeros_like(shapes[0])
    push[-1] = (0, 0, -0.05)
    simulation = simulation_of(model)
    answers = [
        np.abs(model.displacement(simulation.solve_static(TWO_BONES, np.eye(3)[j], push)[0]) - shapes[j]).max()
        for j in range(2)
    ]
    assert answers[0] / answers[1] > 8  # moduli are 8 : 1, and the bulge is thicker


@pytest.mark.parametrize("h", [1 / 120, 1 / 480, 1 / 960])
def test_small_swings_about_a_large_sculpt_are_not_lost(h):
    """A tenth of a millimeter about a bend of 12 cm: the default tolerance moves as a tight one does."""
    paths = []
    for tolerance in (1e-6, 1e-12):
        model, _, _ = sculpted(dynamorph.MaterialModel.STABLE_STVK, dynamorph.Blending.EVEN, True, damping=0.0)
        simulation = simulation_of(model, h, tolerance=tolerance)
        weights = np.eye(3)[2]
        simulation.start(TWO_BONES, TWO_BONES, weights)
        state = simulation.state
        nudge = np.zeros(model.dofs)
        nudge[3] = 1e-4 * np.sqrt(0.004)
        simulation.state = dynamorph.State([q + nudge for q in state.coordinates], state.bones)
        path = []
        for _ in range(60):
            simulation.advance(TWO_BONES[None], weights[None])
            path.append(simulation.coordinates)
        paths.append(np.array(path))
    swing = np.abs(paths[1] - paths[1].mean(axis=0)).max()
    assert swing > 1e-2 * np.abs(nudge).max()
    assert np.abs(paths[0] - paths[1]).max() < 1e-2 * swing


def test_reduced_follows_full():
    """A bar swinging far beyond small strain, in 20 modes for three targets, stays close to the unreduced one."""
    full, _, size = sculpted(dynamorph.MaterialModel.STABLE_STVK, dynamorph.Blending.EVEN, False)
    reduced, _, _ = sculpted(dynamorph.MaterialModel.STABLE_STVK, dynamorph.Blending.EVEN, True, modes=20)
    times = np.arange(1, 121) / 120
    swing = 0.2 * np.sin(2 * np.pi * times)
    rig = np.array([np.concatenate([bones(), bones(Rotation.from_euler("y", a))]) for a in swing])
    weights = np.stack([1 - np.abs(swing), np.clip(swing, 0, None), np.clip(-swing, 0, None)], axis=1)
    paths = []
    for model in (full, reduced):
        simulation = simulation_of(model)
        simulation.start(TWO_BONES, TWO_BONES, np.eye(3)[0])
        path = []
        for k in range(len(times)):
            simulation.advance(rig[k : k + 1], weights[k : k + 1])
            path.append(model.displacement(simulation.coordinates))
        paths.append(np.array(path))
    moved = np.sqrt((paths[0] ** 2).mean())
    assert moved > 0.01 * size
    assert np.sqrt(((paths[0] - paths[1]) ** 2).mean()) < 0.05 * moved


# State -------------------------------------------------------------------------------------------------------------


def swing(model, count):
    rig = np.array([np.concatenate([bones(), bones(Rotation.from_euler("y", 0.05 * k))]) for k in range(count)])
    return rig, np.tile([0.5, 0.5, 0.0], (count, 1))


@pytest.mark.fault("C01")
@pytest.mark.parametrize("reduced", [False, True])
def test_state_resumes_bit_for_bit(reduced):
    model, _, _ = sculpted(dynamorph.MaterialModel.STVK, dynamorph.Blending.FORCES, reduced)
    rig, weights = swing(model, 20)
    simulation = simulation_of(model)
    simulation.start(rig[0], rig[1], weights[0])
    simulation.advance(rig[1:10], weights[1:10])
    state = simulation.state
    simulation.advance(rig[10:], weights[10:])
    resumed = simulation_of(model)
    resumed.state = state
    with pytest.raises(ValueError, match="after setting a state a step"):
        _ = resumed.kinetic_energy
    resumed.advance(rig[10:], weights[10:])
    assert np.array_equal(resumed.coordinates, simulation.coordinates)


@pytest.mark.fault("A01")
def test_a_cut_in_the_root_motion_carries_the_past_along():
    """The rig jumps 50 m and turns; with the teleport rule the tissue swings on as if nothing had happened."""
    model, _, size = sculpted(dynamorph.MaterialModel.STABLE_STVK, dynamorph.Blending.EVEN, True)
    rig, weights = swing(model, 20)
    jump = np.vstack([bones(Rotation.from_euler("z", 100, degrees=True), (50, 0, 3))[0], [0, 0, 0, 1]])
    cut = rig.copy()
    homogeneous = np.concatenate([rig[10:], np.tile([[[[0, 0, 0, 1.0]]]], (10, 2, 1, 1))], axis=2)
    cut[10:] = (jump @ homogeneous)[:, :, :3]
    ends = []
    for path, teleport in ((rig, 0.0), (cut, 0.15 * size), (cut, 0.0)):
        simulation = simulation_of(model, teleport=teleport)
        simulation.start(path[0], path[1], weights[0])
        report = simulation.advance(path[1:], weights[1:])
        assert np.isfinite(simulation.coordinates).all()
        ends.append(model.displacement(simulation.coordinates))
        assert report.teleported == (teleport > 0)
    assert np.abs(ends[1] - ends[0]).max() < 0.1 * np.abs(ends[0]).max()
    assert np.abs(ends[2] - ends[0]).max() > np.abs(ends[0]).max()


# Bad input ---------------------------------------------------------------------------------------------------------


def test_wrong_shapes_name_the_parameter():
    model, _, _ = sculpted(dynamorph.MaterialModel.LINEAR, dynamorph.Blending.EVEN, True)
    simulation = simulation_of(model)
    with pytest.raises(ValueError, match=r"now: expected shape \(any, 3, 4\), got \(2, 4, 4\)"):
        simulation.start(np.zeros((2, 4, 4)), TWO_BONES, np.eye(3)[0])
    with pytest.raises(ValueError, match="expected 2 transforms, got 1"):
        simulation.start(bones(), bones(), np.eye(3)[0])
    with pytest.raises(ValueError, match="weights: expected 3, got 1"):
        simulation.start(TWO_BONES, TWO_BONES, ONE)
    for wrong in ([0.0, 0.0, 0.0], [-1.0, 1.0, 1.0], [0.5, 0.2, 0.2]):
        with pytest.raises(ValueError, match=r"weights: .*sum to one"):
            simulation.start(TWO_BONES, TWO_BONES, np.array(wrong))
    with pytest.raises(ValueError, match="next: expected 2 finite transforms, got 1"):
        simulation.start(TWO_BONES, bones(), np.eye(3)[0])
    for early in ("kinetic_energy", "elastic_energy"):
        with pytest.raises(ValueError, match=r"start\(\) comes first"):
            getattr(simulation_of(model), early)
    with pytest.raises(ValueError, match="target: expected 0 to 2, got 3"):
        model.target(3)
    with pytest.raises(ValueError, match="q: expected 12 coordinates, got 2"):
        model.energy(np.eye(3)[0], np.zeros(2))
    with pytest.raises(ValueError, match=r"bones: expected shape \(2, 3, 4\)"):
        model.inertia(bones(), 1000.0)
    with pytest.raises(ValueError, match=r"start\(\) comes first"):
        simulation.advance(TWO_BONES[None], np.eye(3)[:1])
    with pytest.raises(dynamorph.Error, match="not a number"):
        simulation.start(TWO_BONES * np.nan, TWO_BONES, np.eye(3)[0])


def test_a_force_that_is_not_a_number_is_an_error():
    model, shapes, _ = sculpted(dynamorph.MaterialModel.STVK, dynamorph.Blending.EVEN, True)
    simulation = simulation_of(model)
    simulation.start(TWO_BONES, TWO_BONES, np.eye(3)[0])
    with pytest.raises(ValueError, match="external: must be finite"):
        simulation.advance(TWO_BONES[None], np.eye(3)[:1], np.full_like(shapes[0], np.nan))


@pytest.mark.parametrize("reduced", [False, True])
def test_a_bone_that_collapses_leaves_the_state_finite(reduced):
    """Scaled to zero for one step, as riggers hide things: regularized, not refused."""
    model, _, size = sculpted(dynamorph.MaterialModel.STVK, dynamorph.Blending.EVEN, reduced)
    rig, weights = swing(model, 12)
    rig[6, :, :, :3] = 0.0
    simulation = simulation_of(model)
    simulation.start(rig[0], rig[1], weights[0])
    simulation.advance(rig[1:], weights[1:])
    assert np.isfinite(simulation.coordinates).all()


@pytest.mark.fault("R03")
@pytest.mark.parametrize("single", [False, True])
@pytest.mark.parametrize("scale", [(1, 1, 0), (1, 0, 0), (1, 1, 1e-9)])
def test_a_bone_that_is_flat_at_the_start_is_at_rest(scale, single):
    """Scaled to zero along an axis, and turned: the determinant is round-off, and so would be the past."""
    model, _, _ = sculpted(dynamorph.MaterialModel.STVK, dynamorph.Blending.EVEN, True, cells=(4, 1, 1), modes=6)
    simulation = simulation_of(model)
    for seed in range(20):
        posed, rest = (turn.as_matrix() for turn in Rotation.random(2, random_state=seed))
        rig = np.array([np.concatenate([bones(), bones(translation=(0.3, 0.1, 0))])] * 2)
        for k in range(2):
            flat = Rotation.from_euler("z", 0.01 * k).as_matrix() @ posed @ np.diag(scale)
            rig[k, 1, :, :3] = (flat.astype(np.float32) if single else flat) @ rest.T
        for after in rig:
            simulation.start(rig[0], after, np.eye(3)[0])
            for past in simulation.state.bones:
                assert np.array_equal(past, rig[0].reshape(-1, 12))


def test_regions_that_do_not_overlap_have_the_body_s_modes():
    """Two target sets, each with one half of the bar: the reduced model keeps the unreduced one's frequencies."""
    nodes, tets = bar((8, 2, 2), (0.4, 0.1, 0.1))
    count = np.ones(len(tets))
    left = (nodes[tets].mean(axis=1)[:, 0] < 0.2).astype(float)
    body = dynamorph.SoftBody(
        dynamorph.TetMesh(nodes, tets), count, count, np.stack([left, 1 - left], axis=1), nodes[:, 0] < 1e-9,
        np.ones((len(nodes), 1)),
    )  # fmt: skip
    targets = [
        dynamorph.MorphTarget("n", np.zeros_like(nodes), density=1000.0, set=s, **lame(2e4, 0.3)) for s in range(2)
    ]
    full = dynamorph.FullModel(body, targets, dynamorph.MaterialModel.LINEAR, dynamorph.Blending.EVEN)
    simulation = simulation_of(full, gravity=(0, 0, -9.81))
    simulation.balance_targets(np.array([bones(), bones()]))  # each set balances its own half
    assert np.abs(simulation.solve_static(bones(), np.ones(2))[0]).max() < 1e-9
    reduced = dynamorph.ReducedModel(
        body, targets, dynamorph.reduce(full, dynamorph.make_basis(full, 14).U), dynamorph.Blending.EVEN
    )
    frequencies = []
    for model in (full, reduced):
        stiffness = model.linearize(np.ones(2), np.zeros(model.dofs))[2]
        mass = model.inertia(bones(), 1000.0)
        dense = [m.toarray() if hasattr(m, "toarray") else m for m in (stiffness, mass)]
        frequencies.append(np.sqrt(eigh(*dense, eigvals_only=True)[:4]))
    assert frequencies[1] == pytest.approx(frequencies[0], rel=0.01)


def test_cancel_stops_a_long_call():
    model, _, _ = sculpted(dynamorph.MaterialModel.STVK, dynamorph.Blending.EVEN, False)
    with pytest.raises(dynamorph.Cancelled):
        dynamorph.make_basis(model, 12, lambda fraction: fraction < 0.3)


# Energies ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("reduced", [True, False])
def test_energies_are_those_of_the_state_whatever_was_asked_between(reduced):
    """Static solutions and balanced targets pose the model elsewhere; that is not where the simulation is."""
    model, _, _ = sculpted(dynamorph.MaterialModel.STABLE_STVK, dynamorph.Blending.EVEN, reduced)
    rig, weights = swing(model, 12)
    simulation = simulation_of(model)
    simulation.start(rig[0], rig[1], weights[0])
    simulation.advance(rig[1:], weights[1:])
    before = simulation.elastic_energy, simulation.kinetic_energy
    assert before[0] > 0.0
    simulation.solve_static(rig[3], np.eye(3)[1])
    assert (simulation.elastic_energy, simulation.kinetic_energy) == before
    simulation.balance_targets(np.array([rig[0]] * 3))
    assert (simulation.elastic_energy, simulation.kinetic_energy) == before
    assert simulation.elastic_energy == pytest.approx(model.energy(weights[-1], simulation.coordinates), rel=1e-12)


@pytest.mark.parametrize(("integrator", "stencil"), [(EULER, (1.0, -1.0, 0.0)), (BDF2, (1.5, -2.0, 0.5))])
def test_kinetic_energy_has_the_integrator_s_velocity(integrator, stencil):
    """A bar that is thrown and turned by its bone: 1/2 sum m |v|^2 of the posed nodes."""
    model, nodes = cantilever((3, 1, 1), (0.3, 0.1, 0.1), young=4e4)
    h = 1 / 60
    frames = np.array([bones(Rotation.from_rotvec([0, 0.04 * k**2, 0]), (0.1 * k, 0, 0.02 * k**2)) for k in range(6)])
    simulation = dynamorph.Simulation(model, h, integrator=integrator)
    simulation.start(frames[0], frames[1], ONE)
    simulation.advance(frames[1:], np.ones((5, 1)))
    state, velocity = simulation.state, 0.0
    for coefficient, q, bone in zip(stencil, state.coordinates, state.bones, strict=False):
        matrix = np.reshape(bone, (3, 4))
        velocity = velocity + coefficient / h * ((nodes + model.displacement(q)) @ matrix[:, :3].T + matrix[:, 3])
    _, tets = bar((3, 1, 1), (0.3, 0.1, 0.1))
    corners = nodes[tets]
    quarters = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 24.0
    mass = 1000.0 * np.bincount(tets.ravel(), np.repeat(quarters, 4)) * (nodes[:, 0] > 1e-9)  # what is free
    expected = 0.5 * (mass * (velocity**2).sum(axis=1)).sum()
    assert simulation.kinetic_energy == pytest.approx(expected, rel=1e-9)


def test_threads_take_turns_with_one_simulation():
    """What four of them step together is a whole number of steps of one."""
    model, _, _ = sculpted(dynamorph.MaterialModel.STVK, dynamorph.Blending.EVEN, True)
    rig, weights = swing(model, 2)
    alone, shared = simulation_of(model), simulation_of(model)
    for simulation in (alone, shared):
        simulation.start(rig[0], rig[1], weights[0])
    still, same = np.repeat(rig[1:], 50, axis=0), np.repeat(weights[1:], 50, axis=0)
    for _ in range(12):
        alone.advance(still, same)
    threads = [threading.Thread(target=lambda: [shared.advance(still, same) for _ in range(3)]) for _ in range(4)]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        assert np.isfinite(shared.coordinates).all() and np.isfinite(shared.elastic_energy)
    assert np.array_equal(shared.coordinates, alone.coordinates)


def test_a_step_that_fails_leaves_the_past_where_it_was():
    """Even where the rig jumps, and the past would have been carried along."""
    model, _, _ = sculpted(dynamorph.MaterialModel.STABLE_STVK, dynamorph.Blending.EVEN, True)
    rig, weights = swing(model, 6)
    simulation = dynamorph.Simulation(model, 1 / 60, teleport=0.2)
    simulation.start(rig[0], rig[1], weights[0])
    simulation.advance(rig[1:4], weights[1:4])
    before = simulation.state
    away = rig[4].copy()
    away[:, 0, 3] += 50.0
    with pytest.raises(ValueError, match="finite"):
        simulation.advance(
            away[None], weights[4][None], np.full((len(model.displacement(np.zeros(model.dofs))), 3), np.nan)
        )
    after = simulation.state
    assert all(map(np.array_equal, before.coordinates, after.coordinates))
    assert all(map(np.array_equal, before.bones, after.bones))
    assert simulation.advance(away[None], weights[4][None]).teleported
