"""Control of a page in headless Chromium by its debugging protocol. As a program (`make live`, then `python
tests/helpers/browser.py`) it records the animation of the front page from the live page."""

import base64
import contextlib
import io
import json
import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from urllib.parse import quote
from urllib.request import urlopen

import pytest
import websocket
from PIL import Image

from railrepro import paths

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
needs_browser = pytest.mark.skipif(BROWSER is None, reason="there is no Chromium on this machine")


class Page:
    """An open page."""

    def __init__(self, socket):
        self._socket, self.errors = socket, []
        self.ask("Runtime.enable")
        self.ask("Log.enable")

    def ask(self, method, **parameters):
        """Send a command of the protocol and return its result. Errors of the page are added to `errors`."""
        self._socket.send(json.dumps({"id": 1, "method": method, "params": parameters}))
        while (answer := json.loads(self._socket.recv())).get("id") != 1:
            if answer["method"] == "Runtime.exceptionThrown":
                self.errors.append(answer["params"]["exceptionDetails"])
            if answer["method"] == "Log.entryAdded" and answer["params"]["entry"]["level"] == "error":
                self.errors.append(answer["params"]["entry"]["text"])
        return answer["result"]

    def evaluated(self, expression):
        """Value of an expression of JavaScript."""
        found = self.ask("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")


@contextlib.contextmanager
def opened(url, folder, size="1440,900"):
    """Context manager that opens an address in a browser with a new profile in `folder`."""
    browser = [BROWSER, "--headless=new", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0"]
    browser += ["--remote-allow-origins=*", f"--user-data-dir={folder}", f"--window-size={size}", url]
    folder.mkdir(exist_ok=True)
    places = os.environ | {"TMPDIR": str(folder)}
    process, page = subprocess.Popen(browser, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=places), ""
    try:
        for _ in range(600):
            with contextlib.suppress(OSError, IndexError, StopIteration):
                port = (folder / "DevToolsActivePort").read_text().split()[0]
                with urlopen(f"http://127.0.0.1:{port}/json") as answer:
                    page = next(one["webSocketDebuggerUrl"] for one in json.load(answer) if one["type"] == "page")
                break
            time.sleep(0.2)
        socket = websocket.create_connection(page, timeout=400)
        yield Page(socket)
        socket.close()
    finally:
        process.terminate()
        process.wait(20)


SHOWN = {"figure": "braking", "shown": ["nmpc", "ndi", "ndi_integral"]}
ENDED = "(document.body?.innerText ?? '').split('The car stands').length > 3"


def record(page):
    """Pictures of the second run on a page, as many as the browser gives. By then its modules are compiled."""
    while not page.evaluated(ENDED):
        pass
    page.evaluated("document.getElementById('run').click()")
    found = []
    while not page.evaluated(ENDED):
        shot = io.BytesIO(base64.b64decode(page.ask("Page.captureScreenshot", format="png")["data"]))
        picture = Image.open(shot).convert("RGB")
        found.append(picture.resize([round(0.62 * side) for side in picture.size], Image.Resampling.LANCZOS))
    return found


if __name__ == "__main__":
    file, url = paths.ROOT / "figures/live.gif", (paths.BUILD / "live/index.html").as_uri()
    address = f"{url}#{quote(json.dumps(SHOWN))}"
    with tempfile.TemporaryDirectory() as folder, opened(address, Path(folder), "1180,900") as live:
        pictures = record(live)[::2]
    taken = [picture.quantize(64, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE) for picture in pictures]
    times = [120] * (len(taken) - 1) + [4000]
    taken[0].save(file, save_all=True, append_images=taken[1:], duration=times, loop=0, optimize=True)
