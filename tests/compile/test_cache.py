"""From C to objects: whose folder they lie in, which compiler makes them, what is said of one that fails."""

import ctypes
import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from railrepro import paths
from railrepro.compile import cache
from railrepro.data import InputError


@pytest.fixture
def forgotten():
    """The compiler is looked for again afterwards."""
    yield
    cache.compiler.cache_clear()


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


ANSWERS = "case $* in *--version*) echo broken 1.0; exit;; esac"


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (f"#!/bin/sh\n{ANSWERS}\nexit 1\n", "refused the generated source"),
        (f"#!/bin/sh\n{ANSWERS}\nexit 0\n", "no object"),
        ("#!/nowhere/sh\n", "does not answer to --version"),
        ("#!/bin/sh\nexit 3\n", "does not answer to --version"),
    ],
)
def test_a_compiler_that_fails_is_told_in_one_sentence(text, sentence, tmp_path, monkeypatch, forgotten):
    broken = tmp_path / "cc"
    broken.write_text(text)
    broken.chmod(0o755)
    monkeypatch.setattr(paths, "BUILD", tmp_path)
    monkeypatch.setenv("CC", str(broken))
    cache.compiler.cache_clear()
    with pytest.raises(cache.CompilerError, match=sentence) as told:
        cache.build("int number(void) { return 5; }")
    assert str(broken) in str(told.value) and "\n" not in str(told.value)
    assert not list(tmp_path.rglob("*.so"))


def test_where_there_is_no_compiler_the_packaged_one_is_taken(tmp_path, monkeypatch, forgotten):
    """A compiler in the path comes first. The package is played by a module that hands over to the real one."""
    package, real = tmp_path / "site/ziglang", cache.compiler()
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
    monkeypatch.setenv("CC", "nonexistent-cc")
    cache.compiler.cache_clear()
    with pytest.raises(cache.CompilerError, match="CC='nonexistent-cc' is no compiler that can be found; "):
        cache.compiler()
    monkeypatch.delenv("CC")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)  # the true one may be installed, too
    cache.compiler.cache_clear()
    with pytest.raises(cache.CompilerError, match="no C compiler was found"):
        cache.compiler()


def test_processes_that_need_the_same_object_compile_it_once(tmp_path):
    slow, log = tmp_path / "slow-cc", tmp_path / "log"
    wait = f'case "$*" in *--version*) ;; *) echo compiled >> {log}; sleep 1;; esac'
    slow.write_text(f'#!/bin/sh\n{wait}\nexec {cache.compiler()} "$@"\n')
    slow.chmod(0o755)
    environment = os.environ | {"CC": str(slow), "RAILREPRO_ROOT": str(tmp_path), "PYTHONPATH": str(paths.ROOT)}
    script = "from railrepro.compile import cache; print(cache.build('int shared(void) { return 4; }'))"
    command = [sys.executable, "-c", script]
    both = [subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    objects = {process.communicate()[0] for process in both}
    assert len(objects) == 1
    assert log.read_text() == "compiled\n"
    assert sorted(file.suffix for file in (tmp_path / "build/compiled").iterdir()) == [".c", ".so"]
