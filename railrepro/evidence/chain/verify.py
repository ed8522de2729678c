"""Rerun and compare: the committed products on this machine, and as another compiler or processor would make them."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from railrepro import paths
from railrepro.compile import cache
from railrepro.data import InputError
from railrepro.evidence.chain import compare
from railrepro.evidence.chain.chain import Notebook, chain, run
from railrepro.evidence.chain.files import written
from railrepro.evidence.runs import store

_NO_SIMD = "AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL AVX512_SPR AVX2 FMA3"
VARIANTS = {
    "v2": {"RAILREPRO_CFLAGS": "-O2 -march=x86-64-v2"},
    "v3": {"RAILREPRO_CFLAGS": "-O2 -march=x86-64-v3 -ffp-contract=fast"},
    "v4": {"RAILREPRO_CFLAGS": "-O2 -march=x86-64-v4 -ffp-contract=fast"},
    "native": {"RAILREPRO_CFLAGS": "-O2 -march=native -ffp-contract=fast"},
    "clang": {"CC": "clang"},
    "clang-v3": {"CC": "clang", "RAILREPRO_CFLAGS": "-O2 -march=x86-64-v3 -ffp-contract=fast"},
    "packaged": {"CC": cache.PACKAGED},
    "O0": {"RAILREPRO_CFLAGS": "-O0"},
    "old-processor": {
        "RAILREPRO_CFLAGS": "-O2 -march=x86-64",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2_Usable,-FMA_Usable,-AVX2,-FMA,-FMA4,-AVX512F",
        "NPY_DISABLE_CPU_FEATURES": _NO_SIMD,
        "OPENBLAS_CORETYPE": "Nehalem",
    },
}
"""Other ways to compute the same: name -> environment.

"old-processor" also keeps the mathematical library and NumPy from fused and wide instructions."""
_NEEDS = {"v2": "ssse3", "v3": "avx2", "v4": "avx512f", "clang-v3": "avx2"}
QUICK_MINUTES = 0.65
"""Longest stated run time of a notebook that the variants rerun (minutes)."""
MARK = ".railrepro-output"
"""File in a folder that this library made for output and may therefore empty."""


def rerun(notebooks: Sequence[Notebook], root: Path) -> tuple[compare.Comparison, list[str]]:
    """Run notebooks beside the checkout and compare all their products with the committed ones.

    Parameters
    ----------
    notebooks : sequence of Notebook
    root : Path
        Folder for the products of the rerun; emptied first, see `emptied`.

    Returns
    -------
    total : Comparison
    findings : list of str
        One line per notebook that failed and per product that differs; empty is good.
    """
    os.environ[store.FOLDER] = "off"  # a rerun computes
    emptied(root)
    tolerance, total, findings = compare.verify_tolerance(), compare.Comparison(), []
    for notebook in notebooks:
        print(f"{notebook.name}: running, about {notebook.minutes:g} min", file=sys.stderr, flush=True)
        try:
            run(notebook, notebook.parameters, root, root / "notebooks", keep_going=True)
        except InputError as error:
            findings.append(str(error))
        for product in notebook.products:
            if product.endswith(compare.SUFFIXES):
                result = compare.compare(paths.ROOT / product, root / product, tolerance)
                total += result
                print(f"{product}: {result}", flush=True)
                findings += [f"{product}: {result}"] if result.different else []
    return total, findings


def emptied(folder: Path) -> None:
    """Make a folder empty, and mark it as one that may be emptied again.

    Raises
    ------
    InputError
        When it holds anything and was not made by this function, or cannot be written; what was there is intact.
    """
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise InputError(f"{folder}: is no folder, an empty or a new one is needed")
    with written():
        if folder.is_dir() and any(folder.iterdir()):
            if not (folder / MARK).is_file():
                raise InputError(f"{folder}: holds files that no run of railrepro wrote; name an empty or a new folder")
            shutil.rmtree(folder)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / MARK).touch()


def verify(quick: bool = False, into: Path | None = None) -> int:
    """Rerun the chain and print what differs.

    Parameters
    ----------
    quick : bool
        Only the notebooks of at most `QUICK_MINUTES`.
    into : Path, optional
        Folder for the products of the rerun, empty or of an earlier one; default build/verify.

    Returns
    -------
    int
        1 when a notebook fails or a product differs by more than the tolerance, else 0.
    """
    notebooks = [notebook for notebook in chain().values() if not quick or notebook.minutes <= QUICK_MINUTES]
    total, findings = rerun(notebooks, into or paths.BUILD / "verify")
    print(f"all: {total}")
    for line in findings:
        print(f"not reproduced: {line}")
    return int(bool(findings))


def variants(names: Sequence[str]) -> int:
    """Rerun the quick notebooks in other ways, one process each.

    Parameters
    ----------
    names : sequence of str
        Keys of `VARIANTS`; empty takes all that this machine can run.

    Returns
    -------
    int
        1 when one of them does not give the committed products within the tolerance, else 0.

    Raises
    ------
    InputError
        When a name is not known, or cannot run here although it was asked for.
    """
    unknown = set(names) - set(VARIANTS)
    if unknown:
        raise InputError(f"variant {min(unknown)!r} is not known; there are {sorted(VARIANTS)}")
    failed = 0
    for name in names or VARIANTS:
        why_not = _hindrance(name)
        if why_not and names:
            raise InputError(f"variant {name!r}: {why_not}")
        if why_not:
            print(f"{name}: left out, {why_not}", flush=True)
            continue
        log = paths.BUILD / "variants" / f"{name}.log"
        with written():
            log.parent.mkdir(parents=True, exist_ok=True)
            stream = log.open("w")
        with stream:
            command = [sys.executable, "-m", "railrepro", "chain", "verify", "--quick"]
            command += ["--into", str(log.with_suffix(""))]
            code = subprocess.run(command, env=os.environ | VARIANTS[name], stdout=stream, stderr=subprocess.STDOUT)
        lines = [line for line in log.read_text().splitlines() if line.startswith(("all: ", "not reproduced: "))]
        failed += code.returncode != 0
        print("\n  ".join([f"{name}: " + ("failed" if code.returncode else "passed"), *lines]), flush=True)
    return int(failed > 0)


def _hindrance(name: str) -> str:
    """Why a variant cannot run here, or an empty text."""
    compiler = VARIANTS[name].get("CC")
    if compiler and cache.found(compiler) is None:
        return f"there is no compiler {compiler!r}"
    feature = _NEEDS.get(name)
    if feature and (platform.machine() != "x86_64" or feature not in Path("/proc/cpuinfo").read_text().split()):
        return f"this processor has no {feature}"
    return ""
