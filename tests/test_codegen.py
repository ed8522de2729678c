"""Generated C: several argument sets side by side equal one after the other."""

import ctypes

import casadi as ca
import numpy as np
import pytest

from railrepro import paths
from railrepro.compile import codegen

needs_compiler = pytest.mark.skipif(codegen.compiler() is None, reason="there is no C compiler")


@needs_compiler
def test_lanes_equal_single_evaluations():
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p", 2)
    wide = ca.vertcat(ca.sin(x[0]) / x[1], -ca.cos(x[1]) * p[0] - 2 * x[0] + x[1] ** 2, 1 / x[1], 3.5 + p[1])
    function = ca.Function("several", [x, p], [wide, ca.tan(p[0] * x[0])], ["x", "p"], ["first", "second"])
    headers = "".join((paths.ROOT / "railrepro" / "compile" / name).read_text() for name in ("call.h", "lanes.h"))
    entry = """
void run(const double *x, const double *p, double *first, double *second) {
  lanes_t in[2], out[4], last[1];
  for (int i = 0; i < LANES; ++i) for (int j = 0; j < 2; ++j) in[j][i] = x[2 * i + j];
  several_lanes(in, p, out, last);
  for (int i = 0; i < LANES; ++i) for (int j = 0; j < 4; ++j) first[4 * i + j] = out[j][i];
  for (int i = 0; i < LANES; ++i) second[i] = last[0][i];
}
int count(void) { return LANES; }
"""
    library = codegen.library([function], headers + codegen.lanes_text(function, common=["p"]) + entry)
    n = library.count()
    sets, common = np.random.default_rng(0).uniform(0.5, 1.5, (n, 2)), np.array([0.3, -0.7])
    first, second = np.zeros((n, 4)), np.zeros(n)
    library.run(*(ctypes.c_void_p(array.ctypes.data) for array in (sets, common, first, second)))
    for values, one, other in zip(sets, first, second, strict=True):
        exact = [np.array(result).ravel() for result in function(values, common)]
        np.testing.assert_allclose(one, exact[0], rtol=1e-14)
        np.testing.assert_allclose(other, exact[1][0], rtol=1e-14)


def test_an_operation_without_translation_is_refused():
    x = ca.SX.sym("x")
    with pytest.raises(ValueError, match="odd: operation .* is not translated"):
        codegen.lanes_text(ca.Function("odd", [x], [ca.erf(x)]))
