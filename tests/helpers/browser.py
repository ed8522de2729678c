"""A page in headless Chromium, by its debugging protocol."""

import contextlib
import json
import os
import shutil
import subprocess
import time
from urllib.request import urlopen

import pytest
import websocket

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
