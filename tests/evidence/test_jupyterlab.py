"""A reader in JupyterLab: chapter 06 opened in a browser, a value changed, all cells run; a mark, and no error."""

import json
import os
import re
import sys

from browser import needs_browser, opened, started, waited

from railrepro import paths

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


@needs_browser
def test_a_changed_value_is_marked_in_jupyterlab_and_stops_nothing(tmp_path):
    environment = os.environ | {"RAILREPRO_OUTPUT": str(tmp_path / "products"), "RAILREPRO_ROOT": str(paths.ROOT)}
    environment |= {f"JUPYTER_{kind}_DIR": str(tmp_path / kind) for kind in ("CONFIG", "DATA", "RUNTIME")}
    environment.pop("MPLBACKEND", None)  # that of the tests shows no figure
    lab = [sys.executable, "-m", "jupyterlab", "--no-browser", "--allow-root", "--expose-app-in-browser", "--port=0"]
    lab += [f"--notebook-dir={paths.ROOT}", "--IdentityProvider.token=", "--LanguageServerManager.autodetect=False"]
    log = tmp_path / "lab.log"

    def address():
        return re.search(r"http://(localhost|127\.0\.0\.1):\d+/lab", log.read_text())

    with log.open("w") as said, started(*lab, env=environment, stderr=said):
        url = waited(address)[0]
        with opened(url, tmp_path / "browser") as page:

            def ready():
                return page.evaluated("Boolean(window.jupyterapp)")

            waited(ready)
            found = json.loads(page.evaluated(f"{RUN}({json.dumps(CHAPTER)}, {json.dumps(EDIT)})"))
    assert all(given in found["source"] for given in EDIT.values())
    outputs = [output for cell in found["outputs"] for output in cell]
    assert not [output["evalue"] for output in outputs if output["output_type"] == "error"]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert any(output.get("metadata", {}).get("railrepro_false") for output in outputs) and found["marks"]
