# SPDX-License-Identifier: GPL-3.0-or-later
"""From triangles to tetrahedra: what is accepted, what comes out, and that a crash or a hang stays in the child."""

import ctypes
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from unittest import mock

import dynamorph
import numpy as np
import pytest
from dynamorph import _mesher, meshing

SHARED = Path(__file__).resolve().parents[3] / "shared"
BOX_TRIANGLES = np.array([*map(int, "021123456576014154263367042246135375")]).reshape(-1, 3)


def box(size=(1.0, 1.0, 1.0), center=(0.0, 0.0, 0.0)):
    corners = np.array([[x, y, z] for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
    return corners * size + center, BOX_TRIANGLES


def join(*meshes):
    offsets = np.cumsum([0] + [len(vertices) for vertices, _ in meshes])
    triangles = [triangles + offset for (_, triangles), offset in zip(meshes, offsets, strict=False)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(triangles)


def sphere(rings=24):
    """Radius 1, with degenerate triangles at its poles."""
    latitude, longitude = np.meshgrid(np.linspace(0, np.pi, rings), np.linspace(0, 2 * np.pi, 2 * rings), indexing="ij")
    vertices = np.stack(
        [np.sin(latitude) * np.cos(longitude), np.sin(latitude) * np.sin(longitude), np.cos(latitude)], axis=-1
    )
    index = np.arange(latitude.size).reshape(latitude.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    triangles = np.concatenate([np.stack([a, c, b], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)])
    return vertices.reshape(-1, 3), triangles


def is_closed(triangles):
    """Each directed edge once, and once the other way."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    directed = {tuple(edge) for edge in edges.tolist()}
    return len(directed) == len(edges) and all((b, a) in directed for a, b in directed)


def assert_carries(mesh, vertices, tolerance=1e-6):
    """Every surface point is inside, and its barycentric weights give it back."""
    size = np.linalg.norm(np.ptp(vertices, axis=0))
    embedding = dynamorph.embed(mesh, vertices)
    assert embedding.distances.max() < tolerance * size
    np.testing.assert_allclose(embedding.weights.sum(axis=1), 1)
    np.testing.assert_allclose(embedding.interpolate(mesh.nodes), vertices, atol=tolerance * size)


BODIES = {
    "sphere": sphere(),
    "box": box(),
    "overlapping boxes": join(box(), box(center=(0.4, 0.3, 0.2))),
    "separate boxes": join(box(), box(center=(3, 0, 0))),
    "open box": (box()[0], BOX_TRIANGLES[:-2]),
    "flipped box": (box()[0], np.concatenate([BOX_TRIANGLES[:5], BOX_TRIANGLES[5:, ::-1]])),
    "duplicate faces and vertices": join(box(), box()),
    "stray vertex": (np.concatenate([box()[0], [[9, 9, 9]]]), BOX_TRIANGLES),
    "tiny": box(size=(1e-3, 1e-3, 1e-3), center=(5e-3, 0, 0)),
    "huge": box(size=(1e3, 2e3, 1e3)),
}


@pytest.mark.fault("M05", "M08")
@pytest.mark.parametrize("name", BODIES)
def test_any_soup_gives_tets_around_it(name):
    vertices, triangles = BODIES[name]
    cage_vertices, cage_triangles, mesh = dynamorph.mesh_body(vertices, triangles, 300)
    assert is_closed(cage_triangles)
    np.testing.assert_allclose(mesh.nodes[: len(cage_vertices)], cage_vertices, atol=1e-12 * np.ptp(cage_vertices))
    assert (mesh.volumes > 0).all()
    assert_carries(mesh, vertices[np.unique(triangles)])


@pytest.mark.parametrize("target", [600, 2000])
def test_node_count_within_a_fifth(target):
    *_, mesh = dynamorph.mesh_body(*sphere(), target)
    assert abs(len(mesh.nodes) / target - 1) < 0.2


@pytest.mark.parametrize("name", ["cylinder", "herbert", "shoulder"])
def test_stored_meshes_are_read_back(name):
    file = SHARED / "meshes" / f"{name}.npz"
    if not file.exists():
        pytest.skip("../shared/meshes is absent")
    arrays = np.load(file)
    nodes, tets = arrays[arrays.files[0]], arrays[arrays.files[1]]
    mesh = dynamorph.TetMesh(nodes, tets)
    np.testing.assert_array_equal(mesh.tets, tets)
    assert (mesh.volumes > 0).all()


@pytest.mark.fault("M11")
@pytest.mark.parametrize("turned", [slice(0), slice(None, None, 2), slice(None)])
def test_filled_volume_is_the_bodys_whichever_way_its_faces_look(turned):
    vertices, triangles = sphere()
    triangles[turned] = triangles[turned, ::-1]
    *_, mesh = dynamorph.mesh_body(vertices, triangles, 600)
    fill = dynamorph.fill_fractions(mesh, vertices, triangles)
    assert fill.min() >= 0.05
    assert fill.max() <= 1
    assert fill @ mesh.volumes == pytest.approx(4 / 3 * np.pi, rel=0.03)
    axis = np.array([[[0, 0, -0.5]], [[0, 0, 0.5]]])
    assert dynamorph.pinned(mesh, vertices, triangles, *axis, 0.6).any()


def test_quality_of_a_regular_and_of_a_flat_tetrahedron():
    regular = np.array([[1, 1, 1], [-1, 1, -1], [1, -1, -1], [-1, -1, 1]])
    found = dynamorph.tet_quality(dynamorph.TetMesh(regular, [[0, 1, 2, 3]]))
    angle = np.degrees(np.arccos(1 / 3))
    assert found == pytest.approx(
        {"min_dihedral": angle, "max_dihedral": angle, "under_5": 0, "mean_aspect": 1, "max_aspect": 1}
    )
    sliver = np.array([[1, 0, 0.01], [-1, 0, 0.01], [0, 1, -0.01], [0, -1, -0.01]])
    found = dynamorph.tet_quality(dynamorph.TetMesh(sliver, [[0, 1, 2, 3]]))
    assert found["min_dihedral"] < 3 and found["max_dihedral"] > 175 and found["max_aspect"] > 30
    assert found["under_5"] == pytest.approx(2 / 3)


@pytest.mark.parametrize("name", ["sphere", "overlapping boxes"])
def test_slivers_are_few(name):
    """TetGen alone leaves angles of 1 to 2 degrees, and thirty times as many under 5."""
    found = dynamorph.tet_quality(dynamorph.mesh_body(*BODIES[name], 2000)[2])
    assert found["min_dihedral"] > 2.5
    assert found["under_5"] < 5e-4


def test_skin_weights_extend_into_the_body():
    vertices, triangles = box(size=(1, 1, 4))
    vertices, triangles = join((vertices, triangles), sphere(12))
    *_, mesh = dynamorph.mesh_body(vertices, triangles, 300)
    weights = np.column_stack([vertices[:, 2] > 0, vertices[:, 2] <= 0]).astype(float)
    nodes = dynamorph.extend_to_nodes(mesh, dynamorph.embed(mesh, vertices), weights)
    assert nodes.shape == (len(mesh.nodes), 2)
    np.testing.assert_allclose(nodes.sum(axis=1), 1, atol=1e-6)
    assert (nodes[mesh.nodes[:, 2] > 1.2, 0] > 0.8).all()


@pytest.mark.parametrize(
    "ratio, count, around", [(0.0, 11, False), (0.4, 11, True), (0.95, 11, True), (0.95, 4, False)]
)
def test_nodes_are_wanted_around_bones_where_there_is_room(ratio, count, around):
    """Around, not along: a body pinned along a line could spin about it. Where the ring would touch the cage, the
    line.
    """
    turn = np.arange(12) * np.pi / 6
    rings = [
        np.column_stack([0.1 * np.cos(turn), 0.1 * np.sin(turn), np.full(12, z)]) for z in np.linspace(0, 0.5, count)
    ]
    vertices = np.concatenate([*rings, [[0, 0, 0.0], [0, 0, 0.5]]])
    k, top = np.arange(12), 12 * count
    after = (k + 1) % 12
    sides = [np.column_stack([12 * j + a, 12 * j + b, 12 * j + c]) for j in range(count - 1)
             for a, b, c in ((k, after, after + 12), (k, after + 12, k + 12))]  # fmt: skip
    ends = [
        np.column_stack([after, k, np.full(12, top)]),
        np.column_stack([k + top - 12, after + top - 12, np.full(12, top + 1)]),
    ]
    tube = vertices, np.concatenate([*sides, *ends])
    points = dynamorph.points_on_bones(*tube, *tube, [[0, 0, 0.1]], [[0, 0, 0.4]], ratio)
    off = np.hypot(points[:, 0], points[:, 1])
    assert len(points) >= 2
    assert (off > 0.02).all() if around else (off < 1e-12).all()
    assert off.max() < max(ratio, 1e-9) * 0.1


def test_bones_hold_nodes_near_them():
    vertices, triangles = box(size=(1, 1, 4))
    *_, mesh = dynamorph.mesh_body(vertices, triangles, 600)
    heads, tails = np.array([[0, 0, -2.0]]), np.array([[0, 0, 2.0]])
    pins = [dynamorph.pinned(mesh, vertices, triangles, heads, tails, ratio) for ratio in (0, 0.3, 0.6)]
    assert pins[0].dtype == bool
    assert not pins[0].any()
    assert 0 < pins[1].sum() < pins[2].sum()
    assert (pins[1] <= pins[2]).all()


# --- Bad input -------------------------------------------------------------------------------------------------------


def with_nan():
    vertices, triangles = sphere()
    vertices[[3, 5, 8, 13, 21, 34]] = np.nan
    return vertices, triangles


@pytest.mark.fault("M01", "M02", "M03", "M04")
@pytest.mark.parametrize(
    ("body", "message"),
    [
        (with_nan(), r"6 of \d+ vertices .* \(first: 3, 5, 8, 13, 21\)"),
        ((np.full((3, 3), np.inf), [[0, 1, 2]]), "NaN or infinite"),
        ((np.zeros((0, 3)), np.zeros((0, 3), int)), "no faces"),
        ((box()[0], np.zeros((0, 3), int)), "no faces"),
        ((box(size=(1, 1, 0))[0], BOX_TRIANGLES), "flat.*Give it thickness"),
        ((box(size=(1, 0, 0))[0], BOX_TRIANGLES), "flat.*Give it thickness"),
        ((box(size=(1e8, 1e8, 1e8))[0], BOX_TRIANGLES), "Scale it"),
        ((box(size=(1e-8, 1e-8, 1e-8))[0], BOX_TRIANGLES), "Scale it"),
    ],
)
def test_unusable_bodies_are_refused_with_advice(children, body, message):
    with pytest.raises(dynamorph.Error, match=message):
        dynamorph.mesh_body(*body, 300)
    assert len(children) <= 1  # no other resolution is tried


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda v, t: dynamorph.mesh_body(v[:, :2], t, 300), r"vertices: expected shape \(any, 3\), got \(8, 2\)"),
        (lambda v, t: dynamorph.mesh_body(v, t.ravel(), 300), r"triangles: expected shape \(any, 3\), got \(36,\)"),
        (lambda v, t: dynamorph.mesh_body(v, t + 1, 300), "triangles: expected vertex indices from 0 to 7"),
        (lambda v, t: dynamorph.mesh_body(v, t, 2), "target_nodes: expected at least 4, got 2"),
        (
            lambda v, t: dynamorph.make_cage_surface(v[:, :2], t, 300),
            r"vertices: expected shape \(any, 3\), got \(8, 2\)",
        ),
        (lambda v, t: dynamorph.TetMesh(v, t), r"tets: expected shape \(any, 4\), got \(12, 3\)"),
        (lambda v, t: dynamorph.TetMesh(v[:4], [[0, 1, 2, 9]]), "tets: expected node indices from 0 to 3"),
        (lambda v, t: dynamorph.TetMesh(v[:4], [[0, 1, 2, 3]]), "tets: tet 0 is flat"),
        (lambda v, t: dynamorph.TetMesh(v[:6], [[0, 1, 2, 4]]), "nodes: node 3 belongs to no tet"),
    ],
)
def test_callers_mistakes_name_the_parameter(call, message):
    with pytest.raises(ValueError, match=message):
        call(*box())


@pytest.mark.fault("M07")
def test_self_intersecting_cage_is_refused_with_advice(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(dynamorph.Error, match="intersects itself.*Remove"):
        _mesher.tetrahedralize(*join(box(), box(center=(0.4, 0.3, 0.2))), 300)
    assert not list(tmp_path.iterdir())  # TetGen likes to leave files


def test_open_cage_is_refused_with_advice():
    with pytest.raises(dynamorph.Error, match="closed"):
        _mesher.tetrahedralize(box()[0], BOX_TRIANGLES[:-2], 300)


# --- The child process -----------------------------------------------------------------------------------------------


def test_only_the_mesher_has_tetgen():
    """Whose license is not that of the module that Blender loads."""
    core, mesher = (Path(module.__file__).read_bytes().lower() for module in (dynamorph._core, _mesher))
    assert b"tetgen" in mesher and b"tetgen" not in core


MESHES_A_TET = """
import sys, dynamorph, numpy as np
dynamorph.mesh_body(np.vstack([np.zeros(3), np.eye(3)]), [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], 300)
print(sorted(name for name in sys.modules if name.startswith("dynamorph._")))
"""


def test_only_the_child_loads_tetgen():
    run = subprocess.run([sys.executable, "-c", MESHES_A_TET], stdout=subprocess.PIPE, text=True, check=True)
    assert run.stdout == "['dynamorph._core']\n"


@pytest.mark.fault("C03", "C07", "C08")
@pytest.mark.parametrize(
    ("fault", "message"),
    [("crash", "crashed.*SIGSEGV.*resolution"), ("hang", "too long"), ("memory", "more than 1 GB.*Lower")],
)
def test_a_failing_mesher_becomes_an_error(monkeypatch, children, fault, message):
    monkeypatch.setenv("DYNAMORPH_MESHER_FAULT", fault)
    with pytest.raises(dynamorph.Error, match=message):
        dynamorph.mesh_body(*box(), 300, time_limit=1 if fault == "hang" else 60, memory_limit_gb=1)
    assert len(children) == (1 if fault == "memory" else len(meshing.RESOLUTIONS))
    assert all(child.returncode is not None for child in children)  # none is left running


@pytest.mark.fault("F12")
@pytest.mark.parametrize(("room", "message"), [(4096, "File too large"), (0, "No space left on device")])
def test_a_full_disk_is_no_fault_of_the_mesh(monkeypatch, children, tmp_path, room, message):
    """Where the temporary files are. Files of limited size stand in for it: what fits is a part of the answer, or not
    even the report of what was wrong.
    """
    opened = []

    def limited():
        opened.append((tmp_path / f"{len(opened)}").open("w+b"))
        return opened[-1]

    class Child(subprocess.Popen):
        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options, preexec_fn=limit)

    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))

    monkeypatch.setattr(subprocess, "Popen", Child)
    monkeypatch.setattr(meshing.tempfile, "TemporaryFile", limited)
    with pytest.raises(OSError, match=message):
        dynamorph.mesh_body(*box(), 300)
    assert len(children) == 1  # no other resolution is tried
    assert all(child.returncode is not None for child in children)


@pytest.mark.fault("C03", "C07")
@pytest.mark.parametrize("fault", ["crash once", "hang once"])
def test_another_cage_is_tried(monkeypatch, fault):
    monkeypatch.setenv("DYNAMORPH_MESHER_FAULT", fault)
    *_, mesh = dynamorph.mesh_body(*box(), 300, time_limit=6)
    assert abs(len(mesh.nodes) / 300 - 1) < 0.2


@pytest.mark.skipif(os.name == "nt", reason="POSIX")
def test_a_busy_machine_does_not_end_the_mesher(monkeypatch):
    """The limit counts what it computes: here it waits for longer than that."""

    class Waits(subprocess.Popen):
        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            self.send_signal(signal.SIGSTOP)
            threading.Timer(3.5, self.send_signal, [signal.SIGCONT]).start()

    monkeypatch.setattr(subprocess, "Popen", Waits)
    dynamorph.dismiss_mesher()
    *_, mesh = dynamorph.mesh_body(*box(), 300, time_limit=3.0)
    assert abs(len(mesh.nodes) / 300 - 1) < 0.2


def test_a_mesher_that_waits_is_used_once(children):
    dynamorph.prepare_mesher()
    dynamorph.prepare_mesher()
    assert len(children) == 1
    waited = dynamorph.mesh_body(*box(), 300)[2]
    assert len(children) == 1 and children[0].returncode == 0
    started = dynamorph.mesh_body(*box(), 300)[2]
    assert len(children) == 2
    np.testing.assert_array_equal(waited.nodes, started.nodes)


def test_a_mesher_that_died_while_it_waited_is_replaced(children):
    dynamorph.prepare_mesher()
    children[0].kill()
    children[0].wait()
    dynamorph.mesh_body(*box(), 300)
    assert len(children) == 2


def test_a_mesher_that_gets_no_work_ends_by_itself(monkeypatch, children):
    """In its own process a minute is another constant: it is started with a shorter one."""
    code = "import dynamorph.meshing as m; m.IDLE = 0.5; "
    popen = subprocess.Popen

    def sooner(command, **options):
        return popen(
            [*command[:-1], command[-1].replace("from dynamorph.meshing", code + "from dynamorph.meshing")], **options
        )

    monkeypatch.setattr(subprocess, "Popen", sooner)
    dynamorph.prepare_mesher()
    assert children[0].wait(60) == meshing.EXIT_IDLE
    dynamorph.dismiss_mesher()


LEAVES_A_MESHER = """
import os, subprocess, dynamorph
class Child(subprocess.Popen):
    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        print(self.pid, flush=True)
subprocess.Popen = Child
dynamorph.prepare_mesher()
os._exit(0)
"""


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs /proc")
def test_a_mesher_that_waits_ends_with_its_parent():
    parent = subprocess.run([sys.executable, "-c", LEAVES_A_MESHER], stdout=subprocess.PIPE, text=True, check=True)
    child = Path("/proc") / parent.stdout.strip()
    end = time.monotonic() + 30
    while child.exists() and time.monotonic() < end:
        time.sleep(0.05)
    assert not child.exists()


MESHES_FOR_LONG = """
import subprocess, dynamorph, test_meshing
class Child(subprocess.Popen):
    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        print(self.pid, flush=True)
subprocess.Popen = Child
dynamorph.mesh_body(*test_meshing.box(), 20000, cage=test_meshing.box())
"""


@pytest.mark.parametrize("fault", ["", "hang"])
@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs /proc")
def test_a_mesher_that_works_ends_with_its_parent(fault):
    """Also while TetGen computes, for several seconds here, and whatever ends the parent."""
    path = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    environment = os.environ | {"PYTHONPATH": path, "DYNAMORPH_MESHER_FAULT": fault}
    command = [sys.executable, "-c", MESHES_FOR_LONG]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as parent:
        child = Path("/proc") / parent.stdout.readline().strip() / "stat"
        try:
            while computed(child) < 2.0:
                time.sleep(0.05)
        finally:
            parent.kill()
    time.sleep(0.5)
    assert not child.exists() or child.read_text().rpartition(")")[2].split()[0] == "Z"


def computed(stat: Path) -> float:
    """Seconds for which a process has computed."""
    return sum(map(int, stat.read_text().rpartition(")")[2].split()[11:13])) / os.sysconf("SC_CLK_TCK")


WRITES_TO_A_DEAD_MESHER = """
import signal, subprocess, dynamorph, numpy as np
signal.signal(signal.SIGPIPE, signal.SIG_DFL)
popen = subprocess.Popen
subprocess.Popen = lambda command, **options: popen([command[0], "-c", "import os; os._exit(10)"], **options)
try:
    dynamorph.mesh_body(np.zeros((100000, 3)), np.zeros((1, 3), int), 300)
except dynamorph.Error:
    print("it goes on", signal.pthread_sigmask(signal.SIG_BLOCK, ()), signal.sigpending())
"""


@pytest.mark.fault("C03")
@pytest.mark.skipif(os.name == "nt", reason="POSIX")
def test_a_mesher_that_died_takes_nobody_along():
    """Not even a program that started Python without its signal handlers; these stay as they are."""
    run = subprocess.run([sys.executable, "-c", WRITES_TO_A_DEAD_MESHER], stdout=subprocess.PIPE, text=True)
    assert (run.returncode, run.stdout) == (0, "it goes on set() set()\n")


def test_it_meshes_while_the_caller_does_something_else(children):
    with dynamorph.Meshing(*sphere(), 300) as meshing:
        assert children[0].wait(60) == 0  # nobody asks for the result yet
        *cage, mesh = meshing.result()
    *expected_cage, expected = dynamorph.mesh_body(*sphere(), 300)
    for found, other in zip(
        (*cage, mesh.nodes, mesh.tets), (*expected_cage, expected.nodes, expected.tets), strict=True
    ):
        np.testing.assert_array_equal(found, other)


@pytest.mark.fault("C03")
def test_another_cage_is_tried_when_the_result_is_asked_for(monkeypatch, children):
    monkeypatch.setenv("DYNAMORPH_MESHER_FAULT", "crash once")
    with dynamorph.Meshing(*box(), 300) as meshing:
        assert children[0].wait(60) == -signal.SIGSEGV
        assert abs(len(meshing.result()[2].nodes) / 300 - 1) < 0.2
    assert len(children) == 2 and all(child.returncode is not None for child in children)


def test_meshing_ends_with_its_statement(monkeypatch, children):
    monkeypatch.setenv("DYNAMORPH_MESHER_FAULT", "hang")
    with pytest.raises(ZeroDivisionError), dynamorph.Meshing(*box(), 300):
        assert children[0].poll() is None
        _ = 1 / 0
    assert children[0].returncode is not None


def test_dismissed_meshers_are_gone(children):
    dynamorph.prepare_mesher()
    dynamorph.dismiss_mesher()
    assert children[0].returncode is not None


@pytest.mark.parametrize(
    ("code", "name"), [(-11, "SIGSEGV"), (0xC0000005, "0xc0000005"), (0xC00000FD, "0xc00000fd"), (3, "0x3")]
)
def test_a_crash_is_known_by_its_exit_code(monkeypatch, children, code, name):
    """Of POSIX and of Windows: another resolution is tried after it."""

    class Crashed(subprocess.Popen):
        def wait(self, timeout=None):
            super().wait(timeout)
            self.returncode = code
            return code

    monkeypatch.setattr(subprocess, "Popen", Crashed)
    monkeypatch.setenv("DYNAMORPH_MESHER_FAULT", "crash")
    with pytest.raises(dynamorph.Error, match=rf"crashed on this mesh \({name}\)"):
        dynamorph.mesh_body(*box(), 300)
    assert len(children) == len(meshing.RESOLUTIONS)


@pytest.mark.fault("C08")
@pytest.mark.skipif(os.name == "nt", reason="POSIX")
def test_a_mesher_that_the_system_kills_is_short_of_memory(monkeypatch):
    """The mesh is not blamed, no other resolution is tried, and a farm may try again."""

    class Killed(subprocess.Popen):
        def __init__(self, command, **options):
            super().__init__([command[0], "-c", "import os, signal; os.kill(os.getpid(), signal.SIGKILL)"], **options)

    monkeypatch.setattr(subprocess, "Popen", Killed)
    with pytest.raises(MemoryError, match="killed by the system"):
        dynamorph.mesh_body(*box(), 300)


def test_a_mesher_without_threads_may_be_tried_again(monkeypatch):
    """Where a system gives no more (ulimit -u), the mesh is not blamed."""
    code = 'import threading\nraise RuntimeError("can\'t start new thread")'

    class Limited(subprocess.Popen):
        def __init__(self, command, **options):
            super().__init__([command[0], "-c", code], **options)

    monkeypatch.setattr(subprocess, "Popen", Limited)
    with pytest.raises(BlockingIOError, match="unavailable"):
        dynamorph.mesh_body(*box(), 300)


def test_reports_of_a_windows_child_are_understood(monkeypatch):
    """Their lines end otherwise, and a message from a library may have letters of any encoding."""
    code = f"import os; os.write(2, b'0.5\\r\\nThe cage \\x81 is \\xc3\\xbc\\r\\n'); os._exit({meshing.EXIT_ERROR})"

    class Child(subprocess.Popen):
        def __init__(self, command, **options):
            super().__init__([command[0], "-c", code], **options)

    monkeypatch.setattr(subprocess, "Popen", Child)
    with pytest.raises(dynamorph.Error, match="^The cage \ufffd is ü$"):
        dynamorph.mesh_body(*box(), 300)


def test_half_a_number_is_no_progress(monkeypatch):
    """The parent may read while the child writes."""
    code = f"""if True:
        import os, time
        for part in (b"0.25\\n0.7", b"5\\n0.", b"875\\n"):
            os.write(2, part)
            time.sleep(0.3)
        os._exit({meshing.EXIT_ERROR})"""

    class Child(subprocess.Popen):
        def __init__(self, command, **options):
            super().__init__([command[0], "-c", code], **options)

    monkeypatch.setattr(subprocess, "Popen", Child)
    seen = []
    with pytest.raises(dynamorph.Error, match="^$"):
        dynamorph.mesh_body(*box(), 300, progress=lambda fraction: seen.append(fraction) or True)
    assert sorted(set(seen) - {0.0}) == [0.25, 0.75, 0.875] and seen == sorted(seen)


def test_the_child_says_everything_in_utf_8(children):
    """Whatever the language of the system."""
    dynamorph.mesh_body(*box(), 300)
    (child,) = children
    (option,) = (k for k, word in enumerate(child.args) if word == "-X")
    asked = [*child.args[: option + 2], "-c", "import sys; print(sys.stderr.encoding)"]
    environment = os.environ | {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0"}
    assert subprocess.run(asked, env=environment, capture_output=True, text=True).stdout.strip() == "utf-8"


@pytest.mark.parametrize("python", ["/nowhere/python.exe", "", None])
def test_a_python_that_does_not_start_is_named(monkeypatch, python):
    monkeypatch.setattr(sys, "executable", python)
    with pytest.raises(dynamorph.Error, match=f"not be started with '{python}'.*virus scanner.*install it again"):
        dynamorph.mesh_body(*box(), 300)


def test_windows_limits_the_child_by_a_job_object(monkeypatch):
    """The layout of JOBOBJECT_EXTENDED_LIMIT_INFORMATION on 64 bits."""
    kernel = mock.MagicMock()
    kernel.CreateJobObjectW.return_value = 0x1234
    monkeypatch.setattr(ctypes, "CDLL", {"kernel32": kernel}.get)
    monkeypatch.setattr(sys, "platform", "win32")
    meshing.limit_resources(29.5, 4.0)
    (job, kind, limits, size), _ = kernel.SetInformationJobObject.call_args
    assert (job.value, kind, size, len(limits)) == (0x1234, 9, 144, 144)
    assert int.from_bytes(limits[:8], "little") == 40 * 10**7  # 100 ns
    assert int.from_bytes(limits[16:20], "little") == 0x502
    assert int.from_bytes(limits[112:120], "little") == 4 * 2**30
    (joined, process), _ = kernel.AssignProcessToJobObject.call_args
    assert joined.value == 0x1234 and process.value == 2**64 - 1  # this one


def test_a_limit_that_the_system_refuses_is_left_out(monkeypatch):
    """macOS refuses a limit of the memory, and nobody may raise a limit that is lower already."""
    limited = {}

    def refuse_memory(kind, limits):
        if kind == resource.RLIMIT_AS:
            raise ValueError("current limit exceeds maximum limit")
        limited[kind] = limits

    monkeypatch.setattr(resource, "setrlimit", refuse_memory)
    meshing.limit_resources(29.5, 4.0)
    assert limited == {resource.RLIMIT_CORE: (0, 0), resource.RLIMIT_CPU: (40, 40)}


def test_an_own_cage_takes_the_place_of_the_wrap():
    cage = box(size=(3, 3, 3))
    vertices, triangles, mesh = dynamorph.mesh_body(*sphere(), 300, cage=(cage[0], cage[1][:, ::-1]))
    assert is_closed(triangles)
    np.testing.assert_allclose(np.abs(vertices).max(axis=1), 1.5)
    assert mesh.volumes.sum() == pytest.approx(27)
    assert abs(len(mesh.nodes) / 300 - 1) < 0.2


@pytest.mark.fault("M07")
@pytest.mark.parametrize(
    ("cage", "message"),
    [
        ((box()[0], BOX_TRIANGLES[:-2]), "cage has 1 holes.*automatic cage"),
        (join(box(), box(center=(0.4, 0.3, 0.2))), "intersects itself.*Remove"),
    ],
)
def test_an_unusable_own_cage_is_refused_with_advice(cage, message):
    with pytest.raises(dynamorph.Error, match=message):
        dynamorph.mesh_body(*sphere(), 300, cage=cage)


def test_progress_rises_and_false_cancels():
    seen = []

    def progress(fraction):
        seen.append(fraction)
        return len(seen) < 1000

    dynamorph.mesh_body(*sphere(), 2000, progress=progress)
    assert seen == sorted(seen)
    assert 0 <= seen[0] < seen[-1] <= 1
    with pytest.raises(dynamorph.Cancelled):
        dynamorph.mesh_body(*sphere(), 2000, progress=lambda fraction: False)


def test_the_caller_has_no_other_thread():
    """Blender's Python may be in the middle of anything, and a thread could outlive it."""
    before = threading.enumerate()
    assert dynamorph.mesh_body(*box(), 300, progress=lambda _: threading.enumerate() == before)


def test_an_exception_in_progress_reaches_the_caller():
    with pytest.raises(ZeroDivisionError):
        dynamorph.mesh_body(*box(), 300, progress=lambda fraction: 1 / 0)


def test_the_same_body_gives_the_same_mesh():
    first, second = (dynamorph.mesh_body(*sphere(), 300)[2] for _ in range(2))
    np.testing.assert_array_equal(first.nodes, second.nodes)
    np.testing.assert_array_equal(first.tets, second.tets)
