"""From a CasADi function to compiled C, cached by content.

The key of the cache is the full generated source text, the compiler with its version and flags, and the CPU where the
flags ask for this very one, so that neither a changed model nor a moved build folder can meet a stale object. Without a
C compiler `library` returns None and callers evaluate the same CasADi functions in CasADi's virtual machine.

By default nothing but 256-bit registers is asked of the processor, where it has them, and products and sums are not
fused, so that compilers and processors round alike. `RAILREPRO_CFLAGS` replaces these flags, for example by
"-O2 -march=native".
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import casadi as ca
import numpy as np

from railrepro import paths
from railrepro.errors import InputError

PORTABLE_FLAGS = "-O2 -ffp-contract=off"
_ALWAYS = ("-fPIC", "-shared", "-fno-math-errno", "-w")
_POINTER = ctypes.POINTER(ctypes.c_double)


@lru_cache(maxsize=1)
def compiler() -> str | None:
    """Path of the C compiler, or None (also when `RAILREPRO_NO_COMPILER` is set)."""
    if os.environ.get("RAILREPRO_NO_COMPILER"):
        return None
    return shutil.which(os.environ.get("CC", "cc")) or shutil.which("gcc")


@lru_cache(maxsize=1)
def _processor() -> str:
    """What the system tells of the processor: model and features, sorted lines; empty where it does not."""
    file = Path("/proc/cpuinfo")
    lines = file.read_text().splitlines() if file.exists() else []
    return "\n".join(sorted({line for line in lines if line.startswith(("flags", "model name", "Features"))}))


def flags() -> tuple[str, ...]:
    """Flags of the compiler: `RAILREPRO_CFLAGS` or the default, and what a shared object needs."""
    default = PORTABLE_FLAGS + (" -mavx2" if "avx2" in _processor().split() else "")
    return (*os.environ.get("RAILREPRO_CFLAGS", default).split(), *_ALWAYS)


@lru_cache(maxsize=1)
def _machine() -> str:
    """What an object file depends on besides its source: compiler, flags, processor where they are native to it."""
    version = subprocess.run([compiler(), "--version"], capture_output=True, text=True, check=True).stdout
    cpu = _processor() if any("native" in flag for flag in flags()) else ""
    return "\n".join((version.splitlines()[0], " ".join(flags()), platform.machine(), cpu))


def cache_folder() -> Path:
    """Folder of the compiled objects: `build/compiled`, or one below the temporary folder if that is read-only."""
    folder = paths.BUILD / "compiled"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            return folder
    except OSError:
        pass
    fallback = Path(tempfile.gettempdir()) / f"railrepro-compiled-{os.getuid()}"
    fallback.mkdir(mode=0o700, exist_ok=True)
    return fallback


def source_text(functions: Sequence[ca.Function]) -> str:
    """C source of CasADi functions, with their work-size and sparsity companions."""
    generator = ca.CodeGenerator("generated", {"with_header": False, "verbose": False})
    for function in functions:
        generator.add(function)
    return generator.dump()


_OPERATIONS = {
    **{ca.OP_ADD: "{} + {}", ca.OP_SUB: "{} - {}", ca.OP_MUL: "{} * {}", ca.OP_DIV: "{} / {}"},
    **{ca.OP_NEG: "-{}", ca.OP_SQ: "{0} * {0}", ca.OP_TWICE: "{0} + {0}", ca.OP_INV: "{one} / {}"},
    **{ca.OP_SIN: "{lanes}sin({})", ca.OP_COS: "{lanes}cos({})", ca.OP_TAN: "{lanes}tan({})"},
}


def lanes_text(function: ca.Function, common: Sequence[str] = ()) -> str:
    """C source of a function that is evaluated for LANES sets of arguments side by side, in vector registers.

    Parameters
    ----------
    function : casadi.Function
        Of scalar operations (SX).
    common : sequence of str
        Names of the inputs that all sets share; what depends on these alone is computed once.

    Returns
    -------
    str
        `static void NAME_lanes(inputs, outputs)`, pointers in CasADi's order to lanes_t (lanes.h), or to double for the
        common inputs.

    Raises
    ------
    ValueError
        When the function uses an operation that is not translated here.
    """
    inputs, outputs = function.name_in(), function.name_out()
    kinds = ["double" if name in common else "lanes_t" for name in inputs]
    signature = [f"const {kind} *in_{name}" for kind, name in zip(kinds, inputs, strict=True)]
    signature += [f"lanes_t *out_{name}" for name in outputs]
    lines, slots = [], {}
    for i in range(function.n_instructions()):
        kind, to, of = function.instruction_id(i), function.instruction_output(i), function.instruction_input(i)
        if kind == ca.OP_OUTPUT:
            value, wide = slots[of[0]]
            lines.append(f"out_{outputs[to[0]]}[{to[1]}] = {value if wide else f'lanes({value})'};")
            continue
        if kind == ca.OP_CONST:
            text, wide = repr(function.instruction_constant(i)), False
        elif kind == ca.OP_INPUT:
            text, wide = f"in_{inputs[of[0]]}[{of[1]}]", kinds[of[0]] == "lanes_t"
        elif kind in _OPERATIONS:
            operands = [slots[slot] for slot in of]
            wide = any(is_wide for _, is_wide in operands)
            values = [value if is_wide or not wide else f"lanes({value})" for value, is_wide in operands]
            names = {"lanes": "lanes_" if wide else "", "one": "lanes(1.0)" if wide else "1.0"}
            text = _OPERATIONS[kind].format(*values, **names)
        else:
            raise ValueError(f"{function.name()}: operation {kind} is not translated to lanes")
        lines.append(f"const {'lanes_t' if wide else 'double'} t{i} = {text};")
        slots[to[0]] = f"t{i}", wide
    body = "\n  ".join(lines)
    return f"static void {function.name()}_lanes({', '.join(signature)}) {{\n  {body}\n}}\n"


def build(text: str) -> Path:
    """Compile C source text to a shared object, or find it in the cache.

    Parameters
    ----------
    text : str
        Complete C source.

    Returns
    -------
    Path
        The shared object.

    Raises
    ------
    InputError
        When the compiler refuses the source; the sentence names the kept source file.
    """
    key = hashlib.sha256((text + "\0" + _machine()).encode()).hexdigest()[:24]
    folder = cache_folder()
    target = folder / f"{key}.so"
    if target.exists():
        return target
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        source, output = Path(scratch, "source.c"), Path(scratch, "object.so")
        source.write_text(text)
        command = [compiler(), *flags(), str(source), "-o", str(output), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            kept = folder / f"{key}.failed.c"
            shutil.copy(source, kept)
            raise InputError(f"{compiler()} refused the generated source {kept}: {done.stderr.strip()[:300]}")
        os.replace(output, target)
    return target


class CompiledFunction:
    """A function of a shared object with its work memory, evaluated on NumPy buffers without copies.

    `arguments` and `results` are contiguous float64 arrays in CasADi's column-major order; fill the first, call, read
    the second. Arrays may be shared between functions. `call` describes the function to callers written in C.
    """

    def __init__(self, library: ctypes.CDLL, function: ca.Function, arguments=None, results=None):
        self.name = function.name()
        self._symbol = getattr(library, self.name)
        self._symbol.restype = ctypes.c_int
        self.arguments, self.results = _buffers(function, arguments, results)
        sizes = [ctypes.c_longlong() for _ in range(4)]
        getattr(library, self.name + "_work")(*(ctypes.byref(size) for size in sizes))
        n_arg, n_res, n_iw, n_w = (size.value for size in sizes)
        self._memory = (
            pointer_array(self.arguments, n_arg),
            pointer_array(self.results, n_res),
            (ctypes.c_longlong * max(1, n_iw))(),
            (ctypes.c_double * max(1, n_w))(),
        )
        self.call = Call(ctypes.cast(self._symbol, ctypes.c_void_p), *map(_address, self._memory))

    def __call__(self) -> list[np.ndarray]:
        """Evaluate `arguments` into `results` (returned as the same arrays)."""
        if self._symbol(*self._memory, 0):
            raise ArithmeticError(f"compiled function {self.name} reported a failure")
        return self.results


class InterpretedFunction:
    """The same interface on CasADi's virtual machine, for machines without a C compiler."""

    def __init__(self, function: ca.Function, arguments=None, results=None):
        self.name = function.name()
        self.arguments, self.results = _buffers(function, arguments, results)
        self._buffer, self._trigger = function.buffer()
        for i, array in enumerate(self.arguments):
            self._buffer.set_arg(i, memoryview(array))
        for i, array in enumerate(self.results):
            self._buffer.set_res(i, memoryview(array))

    def __call__(self) -> list[np.ndarray]:
        """Evaluate `arguments` into `results` (returned as the same arrays)."""
        self._trigger()
        if self._buffer.ret():
            raise ArithmeticError(f"function {self.name} reported a failure")
        return self.results


class Call(ctypes.Structure):
    """A generated function with its memory, as C callers see it."""

    _fields_ = [(name, ctypes.c_void_p) for name in ("evaluate", "arg", "res", "iw", "w")]


def _address(block) -> int:
    return ctypes.addressof(block)


def _buffers(function: ca.Function, arguments, results) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Given buffers after a check of their sizes, or new ones."""
    arguments = arguments or [np.zeros(function.nnz_in(i)) for i in range(function.n_in())]
    results = results or [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
    sizes = [function.nnz_in(i) for i in range(function.n_in())] + [
        function.nnz_out(i) for i in range(function.n_out())
    ]
    for size, array in zip(sizes, [*arguments, *results], strict=True):
        if array.size != size or array.dtype != np.float64 or not array.flags.c_contiguous:
            raise ValueError(f"{function.name()}: a contiguous float64 buffer of {size} numbers is needed")
    return arguments, results


def pointer_array(arrays: Sequence[np.ndarray], length: int) -> ctypes.Array:
    """C array of `length` pointers to the given float64 arrays (the rest null)."""
    pointers = (_POINTER * max(1, length))()
    for i, array in enumerate(arrays):
        pointers[i] = array.ctypes.data_as(_POINTER)
    return pointers


def library(functions: Sequence[ca.Function], extra: str = "") -> ctypes.CDLL | None:
    """Load CasADi functions (and extra C source) as one shared object; None when there is no C compiler."""
    if compiler() is None:
        return None
    return ctypes.CDLL(str(build(source_text(functions) + extra)))


def compiled(function: ca.Function) -> CompiledFunction | InterpretedFunction:
    """Fastest available form of one CasADi function, with buffers of its own."""
    loaded = library([function])
    return InterpretedFunction(function) if loaded is None else CompiledFunction(loaded, function)
