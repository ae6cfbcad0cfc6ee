# SPDX-License-Identifier: GPL-3.0-or-later
"""A page in headless Chromium by the DevTools protocol, from a server on this machine; no other host can be reached."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import http.server
import json
import shutil
import subprocess
import tempfile
import threading
import urllib.request
from collections.abc import Awaitable, Callable
from pathlib import Path

PROGRAM = shutil.which("chromium")
FLAGS = (
    "--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-first-run",
    "--disable-dev-shm-usage", "--remote-debugging-port=0", "--disable-background-networking",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
)  # fmt: skip
FAULTS = ("Runtime.exceptionThrown", "Log.entryAdded", "Network.loadingFailed")
PATIENCE = 60.0  # s


class _Files(http.server.SimpleHTTPRequestHandler):
    extensions_map = http.server.SimpleHTTPRequestHandler.extensions_map | {".mjs": "text/javascript"}

    def log_message(self, *_args: object) -> None:
        pass


class Page:
    """faults: what the browser has complained of; requests: the addresses that it has asked for."""

    def __init__(self, socket):
        self._socket, self._calls = socket, 0
        self.faults: list[str] = []
        self.requests: list[str] = []

    async def call(self, method: str, **parameters):
        self._calls += 1
        number = self._calls
        await self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            got = json.loads(await asyncio.wait_for(self._socket.recv(), PATIENCE))
            if got.get("id") == number:
                assert "error" not in got, got
                return got["result"]
            if got.get("method") in FAULTS:
                self.faults.append(json.dumps(got["params"]))
            if got.get("method") == "Network.requestWillBeSent":
                self.requests.append(got["params"]["request"]["url"])

    async def value(self, expression: str):
        """What JavaScript gives; a promise is awaited."""
        got = await self.call("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in got, got["exceptionDetails"]
        return got["result"].get("value")

    async def wait(self, expression: str):
        """The value of JavaScript once it is true."""
        for _ in range(int(PATIENCE / 0.1)):
            if found := await self.value(expression):
                return found
            await asyncio.sleep(0.1)
        raise AssertionError(f"{expression} stays false; {self.faults}")

    async def mouse(self, kind: str, x: float, y: float) -> None:
        await self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)


def run(folder: Path, work: Callable[[Page], Awaitable], before: str = "", media: dict[str, str] | None = None):
    """What `work` returns of a folder's page. before: JavaScript that runs first; media: features of the screen."""
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(_Files, directory=folder))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        return asyncio.run(_visited(f"http://127.0.0.1:{server.server_port}/", work, before, media or {}))
    finally:
        server.shutdown()
        server.server_close()


async def _visited(address: str, work: Callable[[Page], Awaitable], before: str, media: dict[str, str]):
    import websockets

    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [PROGRAM, *FLAGS, f"--user-data-dir={profile}", "--window-size=1000,800", "about:blank"]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            async with websockets.connect(await _tab(Path(profile)), max_size=None) as socket:
                page = Page(socket)
                for domain in ("Page", "Runtime", "Log", "Network"):
                    await page.call(f"{domain}.enable")
                features = [{"name": name, "value": value} for name, value in media.items()]
                await page.call("Emulation.setEmulatedMedia", features=features)
                await page.call("Page.addScriptToEvaluateOnNewDocument", source=before)
                await page.call("Page.navigate", url=address)
                return await work(page)
        finally:
            process.terminate()
            process.wait(20)


async def _tab(profile: Path) -> str:
    """The address of the page's debugger. Chromium makes its port, what answers there, and its page one by one."""
    for _ in range(int(PATIENCE / 0.1)):
        with contextlib.suppress(OSError):  # also of urllib
            port = (profile / "DevToolsActivePort").read_text().split("\n")[0]
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json", timeout=PATIENCE) as answer:
                pages = [each for each in json.load(answer) if each["type"] == "page"]
            if pages:
                return pages[0]["webSocketDebuggerUrl"]
        await asyncio.sleep(0.1)
    raise AssertionError("Chromium did not start")
