"""Public calls under AddressSanitizer and UndefinedBehaviorSanitizer (`make sanitize`); a finding ends the process.
Invalid input is used if it is not refused, so that the sanitizers see it."""

import ctypes
import os
import tempfile
from pathlib import Path

import numpy as np

from railrepro import Export, InputError, LqgPreview, SteppedCar, load_scenario, simulate, tuned
from railrepro.car import equations
from railrepro.compile import cache
from railrepro.control.ndi import NDI
from railrepro.estimation.sensors import readings
from railrepro.track.route import Route

SCENARIO = load_scenario("curve_entry_T3").but(end_m=25.0)
ROUTE = SCENARIO.route()
CONTROLLERS = {
    "ndi": NDI(integral=0.1, rates=True),
    "nmpc": tuned("nmpc"),
    "nmpc_observer": tuned("nmpc_observer", {"solver": "rti"}),
    "ltv_mpc": tuned("ltv_mpc"),
    "lqg_preview": LqgPreview(),
}
FAR = (-1e15, -1e6, -60.1, -60.0, 20.0, 1e4, 1e15, np.inf, np.nan)
"""Track coordinates before, at and beyond the ends of the route (m)."""
DRIVE = """
int drive(void) {  /* one invalid measurement, or all of them, between valid cycles */
  static controller_t c;
  static const double invalid[] = {0.0 / 0.0, 1 / 0.0, -1 / 0.0, 1e300, -1e300, 1e15, -1e15, 1e5, -1e3, -60.1, 1e-300};
  for (int i = -1; i < N_INPUT; ++i)
    for (unsigned k = 0; k < sizeof invalid / sizeof *invalid; ++k) {
      controller_reset(&c);
      for (int cycle = 0; cycle < 24; ++cycle) {
        for (int j = 0; j < N_INPUT; ++j) {
          const double valid = j == MEASURED_FRONT_V || j == MEASURED_REAR_V ? 50 : 0;
          c.measured[j] = cycle % 12 > 5 && (i < 0 || i == j) ? invalid[k] : valid;
        }
        controller_step(&c);
      }
    }
  return 0;
}
"""


def refused(use):
    try:
        use()
    except InputError as refusal:
        print("refused:", refusal)
    else:
        raise SystemExit("used without refusal")


def drive(route):
    """Compute the outputs of a car in every cell of a route and far from it, and steps of a car."""
    car = SteppedCar(route, 50.0)
    for p in (*np.arange(-60.0, 2000.0, 0.5), *FAR):
        car.state[equations.indices("body.s", "front.s", "rear.s")] = p
        car.measure()
    SteppedCar(route, 50.0).step([500.0, -500.0, 0.0, 0.0], steps=100)


def one_for_both(factory):
    made = {}
    simulate(SCENARIO, lambda *of: made.setdefault("one", factory(*of)), sensors=readings())


def exported(controller, sensors):
    with tempfile.TemporaryDirectory() as folder:
        text = Export(controller, ROUTE, sensors=sensors).write_source(Path(folder) / "controller.c").read_text()
    ctypes.CDLL(str(cache.build(text + DRIVE))).drive()


if __name__ == "__main__":
    os.environ.pop("LD_PRELOAD")  # the compiler needs no sanitizer
    for cells in (ROUTE.cells[:, :-1].copy(), ROUTE.cells.astype("float32"), np.ones((3, 2))):
        refused(lambda cells=cells: drive(Route(cells, ROUTE.length)))
    for name in ("nmpc", "lqg_preview"):
        refused(lambda name=name: one_for_both(CONTROLLERS[name]))
    drive(ROUTE)
    for name, controller in CONTROLLERS.items():
        for sensors in (None, readings()):
            print(name, "with sensors:" if sensors else "without sensors:", end=" ", flush=True)
            print(simulate(SCENARIO, controller, sensors=sensors).ended)
            exported(controller, sensors)
    print("no finding")
