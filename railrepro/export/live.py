"""The live page: car and controllers as WebAssembly in one HTML file that needs neither network nor installation.
`python -m railrepro live` (`make live`) writes build/live/index.html. Its JavaScript (folder page) steps the C source
of the FMUs. With the committed values its results equal those of `simulate` bit for bit."""

import base64
import hashlib
import html
import json
import zlib
from dataclasses import asdict
from pathlib import Path

import numpy as np

from railrepro import data, paths
from railrepro.car import equations
from railrepro.car.component import SteppedCar
from railrepro.compile import cache, codegen
from railrepro.control import interface
from railrepro.control.lateral import Guidance, ZeroOrderHold
from railrepro.control.registry import CONTROLLERS, REPLICATED, tuned
from railrepro.export.car import car_fmu
from railrepro.export.controller import Export
from railrepro.export.fmu import Fmu
from railrepro.quantities import notes
from railrepro.simulation import simulate
from railrepro.simulation.scenarios import Scenario, Sine, load_scenario
from railrepro.track.route import COLUMNS

_HERE = Path(__file__).with_name("page")
FIGURES = {
    "Figure 6: curve entry, T3, 280 km/h": "curve_entry_T3",
    "Figure 7: sine, straight, 400 km/h": "sine_tracking",
    "Figure 8: poor rail, 400 km/h": "adhesion_loss",
    "Figure 9: braking, T2, 160 km/h": "braking",
}
SHOWN = (*REPLICATED, "ndi_swarm")
"""Controllers of the page, tuned for exact measurements (setting "paper"), as the page has no sensors."""
OWN = "own"
"""Name of the controller whose torque is that of a law that a user writes on the page."""
FACTORS = {"force": data.between(0.0, 2.0), "r": data.between(1e-3, 1e4), "faster": data.between(0.1, 5.0)}
"""Ranges of the factors on the force demand, on R of the predictive controllers and on the poles of NDI."""


def _writable(name: str, values: np.ndarray) -> str:
    """C source of an array that the page fills."""
    return f"static double {name}[{np.size(values)}];\n"


def _guidance(name: str) -> Guidance:
    """Guidance of a controller with its tuned parameters, as in the figures of the paper."""
    return ZeroOrderHold() if name == OWN else tuned(name, CONTROLLERS[name].quick)


def _packed(content: bytes | np.ndarray) -> str:
    raw = content if isinstance(content, bytes) else np.ascontiguousarray(content, dtype="<f8").tobytes()
    return base64.b64encode(zlib.compress(raw, 9)).decode()


def _module(fmu: Fmu) -> dict:
    """Compile a car or a controller to a WebAssembly module; dict with "module" and "parameters"."""
    compiled = cache.build(fmu.text + data.text(_HERE / "module.c"), webassembly=True).read_bytes()
    return {"module": _packed(compiled), "parameters": [asdict(one) for one in fmu.parameters]}


def content() -> dict:
    """Compute the data of the live page, a dict for JSON.

    Arrays (float64) and WebAssembly modules are compressed by zlib and encoded in base64. Keys:

    - "columns": names of the columns of all "cells", the rows of a route;
    - "ranges": key of a value that the page may change -> fields of its `railrepro.data.Quantity`;
    - "car": its "module", "parameters" (list of dicts: name, value, unit, low, high), names of its "outputs", as
      "front.y", and of those "measured" by controllers;
    - "controllers": name -> "label", "module", "parameters" (dicts with the keys of the car's);
    - "figures": scenario -> "title", "cells", "speed_kmh" (at first), "stop_kmh" (at its end, or None),
      "set_point" (dict of kind, amplitude_mm, period_m, …: fields of `scenarios.Sine`, `Sweep`), "end" (m), "stride"
      (ms between rows of a curve), "force" (kN, largest demand), "committed": controller -> curves "y", "p" (m),
      simulated here with the values in the repository, with which the page compares its own runs.
    """
    scenarios = {name: load_scenario(name) for name in FIGURES.values()}
    routes = {name: scenario.route() for name, scenario in scenarios.items()}
    longest = max(routes.values(), key=lambda route: len(route.cells))
    car = _module(car_fmu(SteppedCar(longest, 50.0), 50.0, _writable))
    car |= {"outputs": list(equations.car().outputs), "measured": list(interface.MEASURED)}
    looks = data.read(paths.source("data/style.toml")) | {OWN: {"label": "Law of your own"}}
    controllers = {}
    for name in (*SHOWN, OWN):
        print(f"compiling {name}", flush=True)
        controllers[name] = {"label": looks[name]["label"]} | _module(Export(_guidance(name), longest).fmu(_writable))
    figures = {}
    for title, name in FIGURES.items():
        more = len(longest.cells) - len(routes[name].cells)  # the modules have as many cells as the longest route
        cells = np.pad(routes[name].cells, ((0, more), (0, 0)), "edge")
        figures[name] = {"title": title, "cells": _packed(cells)} | _experiment(scenarios[name])
    ranges = {"speed_kmh": dict(notes(Scenario))["speed_kmh"], "amplitude_mm": dict(notes(Sine))["amplitude_mm"]}
    ranges |= FACTORS | {name: note for name, note in notes(equations.CarParameters) if isinstance(note, data.Quantity)}
    shown = {"car": car, "controllers": controllers, "figures": figures}
    return {"columns": list(COLUMNS), "ranges": {key: asdict(allowed) for key, allowed in ranges.items()}} | shown


def _experiment(scenario: Scenario) -> dict:
    """Values of a scenario and its committed runs, see "figures" in `content`."""
    values = {key: getattr(scenario, key) for key in ("speed_kmh", "stop_kmh", "set_point")}
    stride = 10 if scenario.stop_kmh is None else 50
    force = max((force for _, force in scenario.force_kN), key=abs, default=0.0)
    committed = {}
    for name in SHOWN:
        series = simulate.run(scenario, _guidance(name)).series.iloc[::stride]
        y, p = series["front.y"].to_numpy(), series["front.p"].to_numpy().round(1)
        committed[name] = {"y": _packed(y), "p": _packed(p)}
    return values | {"end": scenario.end_m, "stride": stride, "force": force, "committed": committed}


def page(embedded: dict) -> str:
    """HTML text of the live page, on which a reader simulates car and controllers in a browser with parameters of their
    own. `embedded` is the dict of `content`: the compiled car and controllers, routes, and curves to compare with. The
    page contains it as JSON. Its security policy permits only its own scripts and styles, by their hashes, and no
    network."""
    text, notice = data.text(_HERE / "page.html"), codegen.ELEMENTARY.partition("*/")[0].removeprefix("/* ")
    for name in ("uPlot.min.css", "page.css", "uPlot.iife.min.js", "car.mjs", "page.js"):
        source = data.text(_HERE / name).replace("</script", "<\\/script")
        digest = base64.b64encode(hashlib.sha256(source.encode()).digest()).decode()
        text = text.replace(f"'{name}'", f"'sha256-{digest}'").replace(f"/* {name} */", source)
    for name, licence in (("uPlot.LICENSE", data.text(_HERE / "uPlot.LICENSE")), ("FDLIBM", notice)):
        text = text.replace(f"/* {name} */", html.escape(licence, quote=False))
    return text.replace("/* content */", json.dumps(embedded).replace("</", "<\\/"))


def main() -> None:
    """Command `live`: write build/live/index.html, a page that simulates car and controllers in a browser, and in the
    same folder car.mjs and content.json, the data that the page contains (`content`)."""
    embedded, folder = content(), paths.BUILD / "live"
    data.write(folder / "index.html", page(embedded))
    data.write(folder / "car.mjs", data.text(_HERE / "car.mjs"))
    data.write(folder / "content.json", json.dumps(embedded))
    print(f"{folder / 'index.html'}: {(folder / 'index.html').stat().st_size / 1e6:.2f} MB")
