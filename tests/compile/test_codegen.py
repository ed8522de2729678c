"""Generated C: sets side by side equal one after the other. The hand-written C compiles without a warning."""

import ctypes
import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from railrepro import paths
from railrepro.compile import cache, codegen
from railrepro.data import InputError


def test_lanes_equal_single_evaluations():
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p", 2)
    chosen = ca.if_else(ca.logic_and(x[0] < x[1], ca.logic_not(p[0] > 1)), ca.fmin(x[0], 0.8) ** 0.3, ca.exp(-x[1]))
    wide = ca.vertcat(ca.sin(x[0]) / x[1], -ca.cos(x[1]) * p[0] - 2 * x[0] + x[1] ** 2, 1 / x[1], 3.5 + p[1], chosen)
    function = ca.Function("several", [x, p], [wide, ca.tan(p[0] * x[0])], ["x", "p"], ["first", "second"])
    headers = (paths.ROOT / "railrepro" / "compile" / "call.h").read_text() + codegen.lanes_header()
    entry = """
void run(const double *x, const double *p, double *first, double *second) {
  lanes_t in[2], out[5], last[1];
  for (int i = 0; i < LANES; ++i) for (int j = 0; j < 2; ++j) in[j][i] = x[2 * i + j];
  several_lanes(in, p, out, last);
  for (int i = 0; i < LANES; ++i) for (int j = 0; j < 5; ++j) first[5 * i + j] = out[j][i];
  for (int i = 0; i < LANES; ++i) second[i] = last[0][i];
}
int count(void) { return LANES; }
"""
    library = codegen.library([function], headers + codegen.lanes_text(function, common=["p"]) + entry)
    n = library.count()
    sets, common = np.random.default_rng(0).uniform(0.5, 1.5, (n, 2)), np.array([0.3, -0.7])
    first, second = np.zeros((n, 5)), np.zeros(n)
    library.run(*(ctypes.c_void_p(array.ctypes.data) for array in (sets, common, first, second)))
    for values, one, other in zip(sets, first, second, strict=True):
        exact = [np.array(result).ravel() for result in function(values, common)]
        np.testing.assert_allclose(one, exact[0], rtol=1e-14)
        np.testing.assert_allclose(other, exact[1][0], rtol=1e-14)


@pytest.fixture
def forgotten():
    """The compiler is looked for again afterwards."""
    yield
    cache.compiler.cache_clear()


GENERATED = """
enum { N = 6, N_THETA = 9, N_CELL = 24, N_A = 12, STATE_y_TrAx = 4, TUNING_period = 8, TUNING_lateral_bound };
static void prediction_lanes(const lanes_t *x, const lanes_t *du, const double *u_d, const lanes_t *theta,
                             const double *par, const double *period, const double *affine, lanes_t *x_next, lanes_t *a,
                             lanes_t *b) {
  for (int i = 0; i < N; ++i) x_next[i] = x[i] + *period * (*du + *u_d) + theta[i] * par[i], b[i] = lanes_all(*affine);
  for (int i = 0; i < N_A; ++i) a[i] = lanes_all(1.0);
}
"""


SOLVERS = ["control/solvers/riccati.c", "control/solvers/interior.c"]


@pytest.mark.parametrize("command", ["gcc", "clang"])
@pytest.mark.parametrize(
    "parts",
    [
        ["car/car.c"],
        ["simulation/loop.c"],
        ["compile/lanes.h", "compile/elementary.c", GENERATED, *SOLVERS],
    ],
    ids=lambda parts: parts[-1],
)
def test_hand_written_c_compiles_without_warning(tmp_path, command, parts):
    if shutil.which(command) is None:
        pytest.skip(f"there is no {command}")
    library = paths.ROOT / "railrepro"
    parts = ["compile/elementary.c", "compile/call.h", *parts]
    texts = [part if part is GENERATED else (library / part).read_text() for part in parts]
    source = tmp_path / "source.c"
    source.write_text("\n".join(texts))
    # the headers offer functions that not every file uses; vectors are passed within one file only
    strict = ["-std=gnu11", "-O2", "-Wall", "-Wextra", "-Wshadow", "-Werror", "-Wno-unused-function", "-Wno-psabi"]
    done = subprocess.run([command, *strict, "-c", source, "-o", tmp_path / "object.o"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_a_refused_source_is_kept_and_named(tmp_path, monkeypatch):
    monkeypatch.setattr(paths, "BUILD", tmp_path)
    with pytest.raises(InputError, match=r"refused the generated source .*\.failed\.c"):
        cache.build("this is no C")
    assert len(list((tmp_path / "compiled").glob("*.failed.c"))) == 1


def test_compiled_code_lies_in_a_folder_that_only_this_user_can_write(tmp_path, monkeypatch):
    """What lies in it is run: not a folder that others can write, not one that cannot be made, not a link."""
    monkeypatch.setattr(paths, "BUILD", tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    folder, home = tmp_path / "compiled", tmp_path / "home/railrepro/compiled"
    assert cache.cache_folder() == folder
    folder.chmod(0o777)
    assert cache.cache_folder() == home and home.stat().st_mode & 0o777 == 0o700
    folder.rename(tmp_path / "elsewhere")
    folder.touch()
    assert cache.cache_folder() == home
    home.chmod(0o775)
    with pytest.raises(InputError, match=r"railrepro/compiled: a folder that you alone can write is needed"):
        cache.cache_folder()
    home.chmod(0o755)
    home.rename(tmp_path / "linked")
    home.symlink_to(tmp_path / "linked")
    with pytest.raises(InputError, match="that you alone can write"):
        cache.cache_folder()


COMPILERS = {
    "refuses": "exit 1",
    "writes nothing": "exit 0",
}
TWICE = """
import casadi as ca
from railrepro import InputError
from railrepro.compile import codegen
x = ca.SX.sym("x")
try:
    codegen.compiled(ca.Function("twice", [x], [2 * x]))
except InputError as error:
    print(error)
"""


@pytest.mark.parametrize("how", [*COMPILERS, "is not executable by this system", "is silent about its version"])
def test_a_compiler_that_fails_is_told_in_one_sentence(how, tmp_path):
    broken = tmp_path / "cc"
    find = 'for a in "$@"; do test "$before" = -o && out=$a; before=$a; done'
    body = f"case $* in *--version*) echo broken 1.0; exit;; esac\n{find}\n{COMPILERS.get(how, 'exit 3')}\n"
    broken.write_text(
        ("#!/nowhere/sh\n" if "system" in how else "#!/bin/sh\n") + (body if how in COMPILERS else "exit 3\n")
    )
    broken.chmod(0o755)
    own = {"CC": str(broken), "RAILREPRO_ROOT": str(tmp_path), "PYTHONPATH": str(paths.ROOT)}
    done = subprocess.run([sys.executable, "-c", TWICE], env=os.environ | own, capture_output=True, text=True)
    assert (done.returncode, done.stderr, done.stdout.count("\n")) == (0, "", 1) and str(broken) in done.stdout
    assert not list((tmp_path / "build/compiled").glob("*.so"))


def test_where_there_is_no_compiler_the_packaged_one_is_taken(tmp_path, monkeypatch, forgotten):
    """A compiler in the path comes first. The package is played by a module that hands over to the real one."""
    package, real = tmp_path / "site/ziglang", codegen.compiler()
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    (package / "__main__.py").write_text(
        "import os, sys\nassert 'CC' not in os.environ and sys.argv[1:3] == ['cc', '-mcpu=baseline']\n"
        f"os.execv({real!r}, [{real!r}, *sys.argv[3:]])\n"
    )
    monkeypatch.setattr(paths, "BUILD", tmp_path)
    monkeypatch.syspath_prepend(package.parent)
    monkeypatch.setenv("PYTHONPATH", str(package.parent))
    monkeypatch.delenv("CC", raising=False)
    tools = tmp_path / "tools"
    tools.mkdir()
    first = tools / "cc"
    first.write_text(f'#!/bin/sh\nexec {real} "$@"\n')
    first.chmod(0o755)
    for tool in filter(None, map(shutil.which, ("sh", "env", "as", "ld"))):
        (tools / Path(tool).name).symlink_to(tool)
    monkeypatch.setenv("PATH", str(tools))
    for expected in (str(first), cache.PACKAGED):
        cache.compiler.cache_clear()
        assert cache.compiler() == expected
        first.unlink(missing_ok=True)
    assert ctypes.CDLL(str(cache.build("int number(void) { return 5; }"))).number() == 5
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)  # the true one may be installed, too
    cache.compiler.cache_clear()
    with pytest.raises(codegen.CompilerError, match="no C compiler was found"):
        cache.compiler()


def test_a_compiler_that_takes_too_long_is_ended(tmp_path, monkeypatch, forgotten):
    slow = tmp_path / "cc"
    slow.write_text("#!/bin/sh\ncase $* in *--version*) exit;; esac\nexec sleep infinity\n")
    slow.chmod(0o755)
    monkeypatch.setattr(paths, "BUILD", tmp_path)
    monkeypatch.setenv("CC", str(slow))
    monkeypatch.setattr(cache, "_SECONDS", 0.2)
    cache.compiler.cache_clear()
    with pytest.raises(codegen.CompilerError, match="cc took longer than 0.2 s"):
        cache.build("int number(void) { return 3; }")


def test_processes_that_need_the_same_object_compile_it_once(tmp_path):
    slow, log = tmp_path / "slow-cc", tmp_path / "log"
    wait = f'case "$*" in *--version*) ;; *) echo compiled >> {log}; sleep 1;; esac'
    slow.write_text(f'#!/bin/sh\n{wait}\nexec {codegen.compiler()} "$@"\n')
    slow.chmod(0o755)
    environment = os.environ | {"CC": str(slow), "RAILREPRO_ROOT": str(tmp_path), "PYTHONPATH": str(paths.ROOT)}
    script = "from railrepro.compile import cache; print(cache.build('int shared(void) { return 4; }'))"
    command = [sys.executable, "-c", script]
    both = [subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    objects = {process.communicate()[0] for process in both}
    assert len(objects) == 1
    assert log.read_text() == "compiled\n"
    assert [file.suffix for file in (tmp_path / "build/compiled").iterdir()] == [".so"]


def test_a_denominator_is_inverted_once():
    """The quotients of a sparse matrix by shared numbers: as many divisions as denominators, equal values."""
    x, y = ca.SX.sym("x", 5), ca.SX.sym("y", 2)
    before = ca.Function("f", [x, y], [x[:4] / y[0], ca.sin(x[0] / y[0]) / y[1], 1 / y[1], x[4] / x[0]])
    after = codegen.share_reciprocals(before)
    divisions = [after.instruction_id(k) for k in range(after.n_instructions())]
    assert sum(kind in (ca.OP_DIV, ca.OP_INV) for kind in divisions) == 3
    at = np.array([0.3, -1.2, 2.5, 0.7, 1.9]), np.array([1.7, -0.6])
    for found, expected in zip(after(*at), before(*at), strict=True):
        assert np.array(found) == pytest.approx(np.array(expected), rel=1e-15)
    assert (after.name(), after.name_in(), after.name_out()) == ("f", before.name_in(), before.name_out())
    a = ca.SX.sym("a")
    assert (a * (1 / y[0]) - a / y[0]).is_zero()  # simplification is on again
