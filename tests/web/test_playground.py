# SPDX-License-Identifier: GPL-3.0-or-later
"""The built playground: its motion is the native engine's, hands move it, it says what is wrong, and it stays small."""

import asyncio
import gzip
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).resolve().parents[2] / "tools")]
import browser  # noqa: E402
import playground  # noqa: E402

SAME = 1e-9  # relative, of coordinates
BUILT = playground.OUT / "models.json"
pytestmark = pytest.mark.skipif(not BUILT.exists(), reason="needs the playground: run tools/playground.py")
in_browser = pytest.mark.skipif(browser.PROGRAM is None, reason="needs chromium")
DRAWN = "globalThis.playground?.times.picture"


@pytest.fixture(scope="session")
def in_node():
    """What motion.mjs prints."""
    if not shutil.which("node"):
        pytest.skip("needs node")
    script = Path(__file__).with_name("motion.mjs")
    done = subprocess.run(["node", script, playground.OUT], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture
def page_of():
    pytest.importorskip("websockets")
    return browser.run


def test_motions_are_those_of_the_native_engine(in_node):
    assert [each["file"] for each in in_node["results"]] == ["cylinder", "shoulder", "body"]
    for each in in_node["results"]:
        assert each["off"] <= SAME, each
        assert each["hash"] == each["native"], each
        assert each["finite"], each


def test_models_have_their_targets(in_node):
    cylinder, shoulder, body = (each["about"] for each in in_node["results"])
    assert cylinder["targets"] == ["Neutral", "Half bend", "Flexed", "Back bend"]
    assert [cylinder["sets"], shoulder["sets"], body["sets"]] == [1, 2, 1]
    assert all(1 < each["frequency"] < 20 for each in (cylinder, shoulder, body))


def test_damaged_model_is_refused(in_node):
    assert in_node["refused"].startswith("The model is damaged"), in_node["refused"]


def test_unknown_target_is_refused():
    program, skin = playground.BUILD / "native/playground", playground.BUILD / "soft_skins/cylinder.dynamorph"
    if not (program.exists() and skin.exists()):
        pytest.skip("needs the native program: run tools/playground.py")
    sliders = json.dumps([{"keys": [[0, "Neutral"], [1, "Nobody"]]}])
    done = subprocess.run([program, skin, "1", sliders], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == 'The model has no target "Nobody"\n'


def test_models_are_built_again_when_the_engine_is_newer(monkeypatch, tmp_path):
    built = []
    monkeypatch.setattr(playground, "BUILD", tmp_path)
    monkeypatch.setattr(playground.subprocess, "run", lambda command, **_options: built.append(command[-1]))
    described = json.loads((playground.WEB / "models.json").read_text())["models"][0]
    path, engine = tmp_path / "soft_skins/cylinder.dynamorph", tmp_path / "cmake/python/dynamorph/core.so"
    for each in (path, engine):
        each.parent.mkdir(parents=True)
        each.touch()
    later = time.time() + 3600
    os.utime(path, (later, later))
    assert playground.model(described) == path and built == []
    os.utime(engine, (later + 1, later + 1))
    assert playground.model(described) == path and built == [path]


def test_sizes_are_within_their_budgets():
    sizes = playground.sizes()
    assert {name: sizes[name] for name, limit in playground.BUDGETS.items() if sizes[name] > limit} == {}


def test_folder_can_be_moved_anywhere():
    texts = [(playground.OUT / name).read_text() for name in playground.PAGE]
    assert not any("http" in text.replace("http://www.w3.org", "") for text in texts)
    assert not any('="/' in text or "url(/" in text for text in texts)


@in_browser
def test_page_draws_moves_and_proves_its_motion(page_of):
    async def work(page):
        await page.wait(DRAWN)
        still = await page.value("[...playground.engine.coordinates()]")
        for kind, x, y in (("mousePressed", 300, 250), ("mouseMoved", 360, 200), ("mouseMoved", 420, 300)):
            await page.mouse(kind, x, y)
        moved = await page.wait(
            f"(() => {{ const s = {json.dumps(still)}, q = [...playground.engine.coordinates()];"
            " return q.some((x, i) => Math.abs(x - s[i]) > 1e-6) && q; })()"
        )
        await page.mouse("mouseReleased", 420, 300)
        proof = await page.wait("playground.model.proof")
        return moved, proof, await page.value("document.getElementById('proof').textContent"), page

    moved, proof, text, page = page_of(playground.OUT, work, media={"prefers-reduced-motion": "reduce"})
    native = json.loads(BUILT.read_text())["models"][0]["native"]
    assert len(moved) == len(native["coordinates"])
    assert proof["off"] <= SAME
    assert proof["hash"] == native["hash"] and native["hash"] in text
    assert page.faults == []
    assert {request.split(":")[1] for request in page.requests if request.startswith("http")} == {"//127.0.0.1"}


@in_browser
def test_methods_poke_and_bounce(page_of):
    """Each changes what it should, step by step."""

    async def work(page):
        await page.wait(DRAWN)
        await page.value("playground.stop()")
        surface = "Array.from(playground.engine.surface().slice(0, 3 * playground.engine.about.vertices))"
        seen = {}
        for method in ("dynamic", "single", "plain"):
            await page.value(f"document.querySelector('[value={method}]').click()")
            await page.value("for (let i = 0; i < 90; ++i) playground.advance(); playground.show()")
            seen[method] = await page.value(surface)
        await page.value("document.querySelector('[value=dynamic]').click()")
        await page.value("for (let i = 0; i < 120; ++i) playground.advance(); playground.show()")
        seen["before"] = await page.value(surface)
        await page.value("document.getElementById('poke').click()")
        await page.value("for (let i = 0; i < 5; ++i) playground.advance(); playground.show()")
        seen["poked"] = await page.value(surface)
        bounce = "document.getElementById('bounce')"
        await page.value(f"{bounce}.value = 1; {bounce}.dispatchEvent(new Event('input'))")
        seen["hertz"] = await page.value(f"{bounce}.nextElementSibling.textContent")
        seen["frequency"] = await page.value("playground.engine.about.frequency")
        return seen, page.faults

    seen, faults = page_of(playground.OUT, work, media={"prefers-reduced-motion": "reduce"})

    def apart(one, other):
        return max(abs(a - b) for a, b in zip(seen[one], seen[other], strict=True))

    assert apart("dynamic", "before") < 1e-3
    assert min(apart("dynamic", "single"), apart("dynamic", "plain"), apart("single", "plain")) > 1e-3
    assert apart("before", "poked") > 1e-3
    assert seen["hertz"] == f"{2 * seen['frequency']:.1f} Hz"
    assert faults == []


@in_browser
def test_shake_is_the_same_on_a_slow_machine(page_of):
    """As many frames, whatever the clock says: else its hand would move ever faster than the tissue."""

    async def work(page):
        await page.wait(DRAWN)
        await page.value("playground.stop()")
        found = []
        for pause in (0.0, 1.2):
            await page.value("for (let i = 0; i < 600; ++i) playground.advance()")  # it comes to rest
            await page.value(
                "document.getElementById('shake').click(); for (let i = 0; i < 9; ++i) playground.advance()"
            )
            await asyncio.sleep(pause)
            await page.value("for (let i = 0; i < 21; ++i) playground.advance()")
            found.append(await page.value("[...playground.engine.coordinates()]"))
        return found, page.faults

    (quick, slow), faults = page_of(playground.OUT, work, media={"prefers-reduced-motion": "reduce"})
    assert max(map(abs, quick)) > 1e-4
    assert slow == pytest.approx(quick, abs=1e-6)
    assert faults == []


@in_browser
@pytest.mark.parametrize(
    ("before", "says"),
    [
        ("HTMLCanvasElement.prototype.getContext = () => null", "no WebGL 2"),
        (
            "WebAssembly.compile = async () => { throw new WebAssembly.CompileError('simd') }",
            "lacks SIMD or exceptions",
        ),
    ],
)
def test_old_browser_gets_a_message(page_of, before, says):
    async def work(page):
        return await page.wait(f"document.getElementById('message')?.textContent.includes({says!r})")

    assert page_of(playground.OUT, work, before)


@in_browser
def test_damaged_file_gets_the_engines_sentence(page_of, tmp_path):
    shutil.copytree(playground.OUT, tmp_path / "page")
    file = tmp_path / "page" / "cylinder.dynamorph.gz"
    data = bytearray(gzip.decompress(file.read_bytes()))
    data[len(data) // 2] ^= 1
    file.write_bytes(data)  # as a server sends it that has decompressed it

    async def work(page):
        return await page.wait("(document.getElementById('message')?.textContent.match(/damaged.*/) ?? [''])[0]")

    assert "Build it again." in page_of(tmp_path / "page", work)


@in_browser
@pytest.mark.parametrize("late", ["arrives", "fails"])
def test_last_character_asked_for_is_shown_whatever_arrives_later(page_of, late):
    """The first one is held back until the second is there."""
    held = f"""const real = fetch, held = new Promise((done) => {{ globalThis.release = done; }});
        globalThis.fetch = async (url) => {{
          if (!String(url).includes("cylinder")) return real(url);
          await held;
          if ({json.dumps(late)} == "fails") throw new Error("It came too late");
          return real(url);
        }};"""

    async def work(page):
        await page.wait("document.querySelectorAll('[name=model]').length == 3")
        await page.value("document.querySelectorAll('[name=model]')[1].click()")
        await page.wait(DRAWN)
        await page.value("release()")
        await page.wait("playground.model.proof")  # much later
        shown = "[playground.model.file, playground.engine.about.sets, document.getElementById('message').textContent]"
        return await page.value(shown), page.faults

    shown, faults = page_of(playground.OUT, work, held)
    assert shown == ["shoulder", 2, ""]
    assert faults == []


@in_browser
def test_proof_that_fails_says_why(page_of, tmp_path):
    shutil.copytree(playground.OUT, tmp_path / "page")
    file = tmp_path / "page" / "models.json"
    described = json.loads(file.read_text())
    del described["models"][0]["native"]
    file.write_text(json.dumps(described))

    async def work(page):
        await page.wait("document.getElementById('proof')?.textContent.includes('coordinates')")
        return await page.value("document.getElementById('message').textContent"), page.faults

    assert page_of(tmp_path / "page", work) == ("", [])
