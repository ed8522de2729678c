"""A reader in JupyterLab: chapter 06 opened in a browser, a value changed, all cells run; a mark, and no error."""

import contextlib
import json
import os
import re
import shutil
import subprocess
import sys
import time
from urllib.request import urlopen

import pytest
import websocket

from railrepro import paths

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
CHAPTER = "notebooks/06_curve_entry.ipynb"
EDIT = {
    "end_m = 600.0": "end_m = 120.0",
    "ndi_poles = [10, 15, 20, 25, 30, 35, 40, 50, 60, 80]": "ndi_poles = [20, 40]",
}
RUN = """
(async (path, edits) => {
  const app = window.jupyterapp;
  await app.restored;
  const panel = await app.commands.execute('docmanager:open', {path, factory: 'Notebook'});
  await panel.context.ready;
  await panel.sessionContext.ready;
  const cells = [...panel.context.model.cells];
  const parameters = cells.find(cell => (cell.getMetadata('tags') || []).includes('parameters'));
  let source = parameters.sharedModel.getSource();
  for (const [old, given] of Object.entries(edits)) source = source.replace(old, given);
  parameters.sharedModel.setSource(source);
  panel.content.activeCellIndex = cells.length - 1;
  await app.commands.execute('notebook:run-all-cells');
  panel.content.widgets.forEach(widget => widget.node.scrollIntoView());
  const outputs = cells.filter(cell => cell.type === 'code').map(cell => cell.outputs.toJSON());
  return JSON.stringify({source, outputs, marks: panel.node.querySelectorAll('mark').length});
})
"""


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


@pytest.mark.skipif(BROWSER is None, reason="there is no Chromium on this machine")
def test_a_changed_value_is_marked_in_jupyterlab_and_stops_nothing(tmp_path):
    environment = os.environ | {"RAILREPRO_OUTPUT": str(tmp_path / "products"), "RAILREPRO_ROOT": str(paths.ROOT)}
    environment |= {f"JUPYTER_{kind}_DIR": str(tmp_path / kind) for kind in ("CONFIG", "DATA", "RUNTIME")}
    environment.pop("MPLBACKEND", None)  # that of the tests shows no figure
    lab = [sys.executable, "-m", "jupyterlab", "--no-browser", "--allow-root", "--expose-app-in-browser", "--port=0"]
    lab += [f"--notebook-dir={paths.ROOT}", "--IdentityProvider.token=", "--LanguageServerManager.autodetect=False"]
    browser = [BROWSER, "--headless=new", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0"]
    browser += ["--remote-allow-origins=*", f"--user-data-dir={tmp_path / 'browser'}", "--window-size=1440,900"]
    log, port = tmp_path / "lab.log", tmp_path / "browser/DevToolsActivePort"

    def address():
        return re.search(r"http://(localhost|127\.0\.0\.1):\d+/lab", log.read_text())

    def page():
        with urlopen(f"http://127.0.0.1:{port.read_text().split()[0]}/json") as answer:
            return next(one["webSocketDebuggerUrl"] for one in json.load(answer) if one["type"] == "page")

    with log.open("w") as said, started(*lab, env=environment, stderr=said):
        url = waited(address)[0]
        with started(*browser, url, stderr=subprocess.DEVNULL):
            socket = websocket.create_connection(waited(page), timeout=400)

            def evaluated(expression):
                question = {"expression": expression, "awaitPromise": True, "returnByValue": True}
                socket.send(json.dumps({"id": 1, "method": "Runtime.evaluate", "params": question}))
                while (answer := json.loads(socket.recv())).get("id") != 1:
                    pass
                return answer["result"]["result"].get("value")

            def ready():
                return evaluated("Boolean(window.jupyterapp)")

            waited(ready)
            found = json.loads(evaluated(f"{RUN}({json.dumps(CHAPTER)}, {json.dumps(EDIT)})"))
            socket.close()
    assert all(given in found["source"] for given in EDIT.values())
    outputs = [output for cell in found["outputs"] for output in cell]
    assert not [output["evalue"] for output in outputs if output["output_type"] == "error"]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert any(output.get("metadata", {}).get("railrepro_false") for output in outputs) and found["marks"]
