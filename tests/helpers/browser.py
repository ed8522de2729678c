"""A page in headless Chromium, by its debugging protocol."""

import contextlib
import json
import shutil
import subprocess
import time
from urllib.request import urlopen

import pytest
import websocket

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
needs_browser = pytest.mark.skipif(BROWSER is None, reason="there is no Chromium on this machine")


@contextlib.contextmanager
def started(*command, **options):
    """A process that ends with the block."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, **options)
    try:
        yield process
    finally:
        process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(20)
        process.kill()


def waited(find, seconds=120.0):
    """What `find` gives once it gives anything."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        with contextlib.suppress(OSError, StopIteration):
            if found := find():
                return found
        time.sleep(0.2)
    raise TimeoutError(f"{find.__name__} gave nothing in {seconds:.0f} s")


class Page:
    """An open page."""

    def __init__(self, socket):
        self._socket, self.errors = socket, []
        self.ask("Runtime.enable")
        self.ask("Log.enable")

    def ask(self, method, **parameters):
        """Answer to a command of the protocol; errors of the page are kept."""
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
    """The page of an address, in a browser of its own in a new folder."""
    browser = [BROWSER, "--headless=new", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0"]
    browser += ["--remote-allow-origins=*", f"--user-data-dir={folder}", f"--window-size={size}", url]

    def page():
        with urlopen(f"http://127.0.0.1:{(folder / 'DevToolsActivePort').read_text().split()[0]}/json") as answer:
            return next(one["webSocketDebuggerUrl"] for one in json.load(answer) if one["type"] == "page")

    with started(*browser, stderr=subprocess.DEVNULL):
        socket = websocket.create_connection(waited(page), timeout=400)
        try:
            yield Page(socket)
        finally:
            socket.close()
