"""Elementary functions of generated C: their errors, and the same bits one by one, side by side and when optimised."""

import ctypes
import shutil
import subprocess
from functools import lru_cache

import mpmath as mp
import numpy as np
import pytest

from railrepro.car import component
from railrepro.compile import cache, codegen
from railrepro.compile.lanes import lanes_header
from railrepro.control import law
from railrepro.control.ndi import NDI
from railrepro.control.solvers import riccati
from railrepro.simulation import closed_loop
from railrepro.vehicle.parameters import load_vehicle

ONE = ("sin", "cos", "tan", "asin", "atan", "exp", "log")
RNG = np.random.default_rng(31)
N = 500
SPECIAL = [0.0, 1.0, -1.0, 0.5, np.nextafter(0.5, 0), np.nextafter(1, 0), np.pi / 4, 5e-324, 1e-310, 0.4375, 2.4375]
ENTRY = """
void {name}(const double *x, const double *y, double *one, double *wide, long n) {{
  for (long i = 0; i < n; ++i) one[i] = {one};
  for (long i = 0; i < n; i += LANES) {{
    lanes_t a, b;
    memcpy(&a, x + i, sizeof a), memcpy(&b, y + i, sizeof b);
    a = {wide};
    memcpy(wide + i, &a, sizeof a);
  }}
}}
"""


@lru_cache
def _compiled(options: str = "") -> ctypes.CDLL:
    text = codegen.ELEMENTARY + lanes_header()
    for name in ONE:
        wide = f"lanes_both(a).{name}" if name in ("sin", "cos") else f"lanes_{name}(a)"
        text += ENTRY.format(name=f"all_{name}", one=f"{name}(x[i])", wide=wide)
    for name in ("pow", "fmin", "fmax"):
        text += ENTRY.format(name=f"all_{name}", one=f"{name}(x[i], y[i])", wide=f"lanes_{name}(a, b)")
    with pytest.MonkeyPatch.context() as patch:
        if options:
            patch.setenv("RAILREPRO_CFLAGS", options)
        return ctypes.CDLL(str(cache.build(text)))


def _values(name: str, x: np.ndarray, y: np.ndarray | None = None, options: str = "") -> np.ndarray:
    """Values of a function one by one, which have the same bits side by side."""
    fill = -len(x) % 8
    x, y = (np.append(v, np.ones(fill)) for v in (x, x if y is None else y))
    one, wide = np.zeros((2, len(x)))
    arrays = (ctypes.c_void_p(array.ctypes.data) for array in (x, y, one, wide))
    getattr(_compiled(options), f"all_{name}")(*arrays, ctypes.c_long(len(x)))
    assert one[np.isfinite(one)].tobytes() == wide[np.isfinite(one)].tobytes()
    np.testing.assert_array_equal(one, wide)
    return one[: len(one) - fill]


def _arguments(name: str) -> np.ndarray:
    if name in ("sin", "cos", "tan"):
        quarters = [float(k * mp.pi / 2) for k in (*range(1, 200), 12345, 2**20 + 1, 2**25 + 1, 6 * 10**7)]
        drawn = RNG.uniform(-3, 3, N), RNG.uniform(-1e8, 1e8, N), 10 ** RNG.uniform(-300, 0, N)
        return np.concatenate([*drawn, quarters, SPECIAL])
    return np.concatenate([SPECIAL, *{
        "asin": (RNG.uniform(-1, 1, N), 1 - 10 ** RNG.uniform(-16, -1, N)),
        "atan": (RNG.uniform(-3, 3, N), 10 ** RNG.uniform(-300, 300, N)),
        "exp": (RNG.uniform(-1, 1, N), RNG.uniform(-708, 709.7, N)),
        "log": (RNG.uniform(0.5, 2, N), 10 ** RNG.uniform(-307, 308, N), 1 + 10 ** RNG.uniform(-16, -1, N)),
    }[name]])  # fmt: skip


def _errors(found: np.ndarray, exact: list) -> np.ndarray:
    """Errors in units in the last place of the exact values."""
    units = np.spacing(np.abs([float(value) for value in exact]))
    return np.array([float(abs(mp.mpf(float(f)) - e) / float(u)) for f, e, u in zip(found, exact, units, strict=True)])


@pytest.mark.parametrize("name", ONE)
def test_errors_stay_below_two_units_in_the_last_place(name):
    x = _arguments(name)
    x = x[(x > 0) | (name != "log")]
    with mp.workprec(250):
        exact = [getattr(mp, name)(mp.mpf(float(value))) for value in x]
        inside = [i for i, value in enumerate(exact) if mp.im(value) == 0]
        assert len(inside) > 0.9 * len(x)
        errors = _errors(_values(name, x)[inside], [exact[i] for i in inside])
    assert errors.max() < 2, (x[inside][errors.argmax()], errors.max())


@pytest.mark.parametrize("decades", [9, 250])
def test_powers(decades):
    x = 10 ** RNG.uniform(-decades, decades, 2 * N)
    y = RNG.choice([1 / 3, -2 / 3, 2 / 3, -5 / 3, 0.5, 8.0, -8.0] if decades < 30 else [1 / 3, -2 / 3, 0.1], len(x))
    with mp.workprec(250):
        exact = [mp.mpf(float(a)) ** mp.mpf(float(b)) for a, b in zip(x, y, strict=True)]
        assert _errors(_values("pow", x, y), exact).max() < 2


def test_ends_of_the_ranges():
    inf, nan = np.inf, np.nan
    for name, x, values in [
        ("sin", [2e8, inf, nan], [nan] * 3),
        ("asin", [1.1, -1.1, nan], [nan] * 3),
        ("atan", [inf, -inf, nan], [np.pi / 2, -np.pi / 2, nan]),
        ("exp", [1e3, -1e3, inf, -inf, nan], [inf, 0, inf, 0, nan]),
        ("log", [0, -1, inf, nan], [-inf, nan, inf, nan]),
    ]:
        np.testing.assert_array_equal(_values(name, np.array(x, dtype=float)), values, err_msg=name)
    x, y = np.array([[0, 1 / 3], [0, -1 / 3], [5, 0], [inf, 0.5], [-1, 0.5], [nan, 0.5]]).T
    np.testing.assert_array_equal(_values("pow", x, y), [0, inf, 1, inf, nan, nan])
    x, y = np.array([[1, 2], [2, 1], [nan, 1], [1, nan], [nan, nan]]).T
    np.testing.assert_array_equal(_values("fmin", x, y), [1, 1, 1, 1, nan])
    np.testing.assert_array_equal(_values("fmax", x, y), [2, 2, 1, 1, nan])


@pytest.mark.parametrize("options", ["-O0 -ffp-contract=off", "-O3 -ffp-contract=off"])
def test_bits_do_not_depend_on_the_optimisation(options):
    for name in ONE:
        x = np.abs(_arguments(name)) + 5e-324
        np.testing.assert_array_equal(_values(name, x, options=options), _values(name, x))


@pytest.mark.skipif(shutil.which("nm") is None, reason="there is no nm")
def test_generated_code_does_without_the_system_s_functions():
    loaded = [component.library(), riccati._compiled("corrected", "rk4")[0]]
    limits = {"lateral_limit": 1.0, "track_end": 1.0, "stop_speed": 0.0}
    loaded.append(closed_loop.library(law.control_law(load_vehicle(), NDI(), **limits).signature)[0])
    for library in loaded:
        listed = subprocess.check_output(["nm", "-D", "--undefined-only", library._name], text=True)
        wanted = {line.split()[1].partition("@")[0] for line in listed.splitlines() if line.split()[0] == "U"}
        assert wanted <= {"memcpy", "memset", "memmove", "sqrt", "floor", "fabs"}, wanted
