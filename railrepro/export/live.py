"""The live page: car and controllers as WebAssembly in one HTML file that needs neither network nor installation.
`python -m railrepro live` (`make live`) writes build/live/index.html. Its JavaScript (page/) steps the same C as the
FMUs, so with the committed values its curve is that of `simulate`, bit for bit."""

from __future__ import annotations

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
from railrepro.control.registry import CONTROLLERS, tuned
from railrepro.data import Quantity, between, write
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
SHOWN = {"nmpc": "NMPC", "nmpc_observer": "NMPC with offset observer", "ltv_mpc": "LTV-MPC"}
SHOWN |= {"ltv_mpc_printed": "LTV-MPC as printed", "ndi": "NDI", "ndi_swarm": "NDI, poles by swarm"}
SHOWN |= {"ndi_feedforward": "NDI with rates of the set point", "ndi_integral": "NDI with rates and integral"}
"""Controllers of the setting `paper`, as the page has no sensors."""
OWN = "own"
"""Name of the controller module that holds the torque of a user's law, written in the page."""
FACTORS = {"force": between(0.0, 2.0), "r": between(1e-3, 1e4), "faster": between(0.1, 5.0)}
"""Range of what the page multiplies: the force demand, R of the predictive controllers, the poles of NDI."""


def _writable(name: str, values: np.ndarray) -> str:
    """C table that the page fills."""
    return f"static double {name}[{np.size(values)}];\n"


def _law(name: str) -> Guidance:
    """Guidance of a controller with its tuned set, as the figures of the paper have it."""
    return ZeroOrderHold() if name == OWN else tuned(name, CONTROLLERS[name].quick)


def _packed(content: bytes | np.ndarray) -> str:
    data = content if isinstance(content, bytes) else np.ascontiguousarray(content, dtype="<f8").tobytes()
    return base64.b64encode(zlib.compress(data, 9)).decode()


def _module(of: Fmu) -> dict:
    """A module of WebAssembly as the page has it."""
    compiled = cache.build(of.text + (_HERE / "module.c").read_text(encoding="utf-8"), webassembly=True).read_bytes()
    return {"module": _packed(compiled), "parameters": [asdict(one) for one in of.parameters]}


def content() -> dict:
    """Data of the live page as a dict for JSON.

    Arrays (float64) and WebAssembly modules are compressed by zlib and then base64 text. Keys:

    - "columns": names of the columns of all "cells" (rows of a route);
    - "ranges": fields of the `railrepro.data.Quantity` of each value that the page may change, by its key in the page;
    - "car": its "module", "parameters", "outputs", and the names "measured" by controllers;
    - "controllers": by name: "label", "module", "parameters";
    - "figures": by scenario: "title", "cells", "speed_kmh", "stop_kmh", "set_point", "end" (m), "stride" (ms between
      rows of a curve), "force" (kN, largest demand), "committed" (by controller: curves "y", "p" in m).
    """
    scenarios = {name: load_scenario(name) for name in FIGURES.values()}
    routes = {name: scenario.route() for name, scenario in scenarios.items()}
    longest = max(routes.values(), key=lambda route: len(route.cells))
    car = _module(car_fmu(SteppedCar(longest, 50.0), 50.0, _writable))
    car |= {"outputs": list(equations.car().outputs), "measured": list(interface.MEASURED)}
    controllers = {}
    for name in (*SHOWN, OWN):
        print(f"compiling {name}", flush=True)
        module = _module(Export(_law(name), longest).fmu(_writable))
        controllers[name] = {"label": SHOWN.get(name, "Law of your own")} | module
    figures = {}
    for title, name in FIGURES.items():
        more = len(longest.cells) - len(routes[name].cells)  # the modules have as many cells as the longest route
        cells = np.pad(routes[name].cells, ((0, more), (0, 0)), "edge")
        figures[name] = {"title": title, "cells": _packed(cells)} | _experiment(scenarios[name])
    shown = {"car": car, "controllers": controllers, "figures": figures}
    return {"columns": list(COLUMNS), "ranges": _ranges()} | shown


def _ranges() -> dict[str, dict]:
    """Permitted range of each value that can be changed: of scenarios and vehicle as their classes state it."""
    scenario = {"speed_kmh": dict(notes(Scenario))["speed_kmh"], "amplitude_mm": dict(notes(Sine))["amplitude_mm"]}
    car = {name: note for name, note in notes(equations.CarParameters) if isinstance(note, Quantity)}
    return {key: asdict(allowed) for key, allowed in (scenario | FACTORS | car).items()}


def _experiment(scenario: Scenario) -> dict:
    """A scenario as the page has it, with its committed runs by controller."""
    found = {key: getattr(scenario, key) for key in ("speed_kmh", "stop_kmh", "set_point")}
    # milliseconds between rows of the page, more for a run to standstill
    found |= {"end": scenario.end_m, "stride": 10 if scenario.stop_kmh is None else 50}
    found["force"] = max((force for _, force in scenario.force_kN), key=abs, default=0.0)
    found["committed"] = {}
    for name in SHOWN:
        series = simulate.run(scenario, _law(name)).series.iloc[:: found["stride"]]
        path = {"y": _packed(series["front.y"].to_numpy()), "p": _packed(series["front.p"].to_numpy().round(1))}
        found["committed"][name] = path
    return found


def page(found: dict) -> str:
    """HTML text of the live page with the dict `found`, from `content`, embedded in it.

    Its content security policy names the embedded scripts and styles by their hashes. The page can reach no network.
    """
    text, notice = data.text(_HERE / "page.html"), codegen.ELEMENTARY.partition("*/")[0].removeprefix("/* ")
    for name in ("uPlot.min.css", "page.css", "uPlot.iife.min.js", "car.mjs", "page.js"):
        source = data.text(_HERE / name).replace("</script", "<\\/script")
        digest = base64.b64encode(hashlib.sha256(source.encode()).digest()).decode()
        text = text.replace(f"'{name}'", f"'sha256-{digest}'").replace(f"/* {name} */", source)
    for name, licence in (("uPlot.LICENSE", data.text(_HERE / "uPlot.LICENSE")), ("FDLIBM", notice)):
        text = text.replace(f"/* {name} */", html.escape(licence, quote=False))
    return text.replace("/* content */", json.dumps(found).replace("</", "<\\/"))


def main() -> None:
    """Write build/live/index.html, and beside it car.mjs and content.json (the dict of `content`)."""
    found, folder = content(), paths.BUILD / "live"
    write(folder / "index.html", page(found))
    write(folder / "car.mjs", (_HERE / "car.mjs").read_text(encoding="utf-8"))
    write(folder / "content.json", json.dumps(found))
    print(f"{folder / 'index.html'}: {(folder / 'index.html').stat().st_size / 1e6:.2f} MB")
