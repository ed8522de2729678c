"""From C to objects: whose folder they lie in, which compiler makes them, what is said of one that fails."""

import os
import subprocess
import sys

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
    folder, elsewhere = tmp_path / "compiled", tmp_path / "elsewhere"
    assert cache.cache_folder() == folder and folder.stat().st_mode & 0o777 == 0o700
    folder.chmod(0o775)
    with pytest.raises(InputError, match="that you alone can write"):
        cache.cache_folder()
    folder.chmod(0o755)
    folder.rename(elsewhere)
    for spoil in (folder.touch, lambda: folder.symlink_to(elsewhere)):
        spoil()
        with pytest.raises(InputError, match="that you alone can write"):
            cache.cache_folder()
        folder.unlink()
    monkeypatch.setattr(paths, "INSTALLED", True)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    assert cache.cache_folder() == tmp_path / "home/railrepro/compiled"


ANSWERS = "case $* in *--version*) echo broken 1.0; exit;; esac"


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (f"#!/bin/sh\n{ANSWERS}\nexit 0\n", "refused the generated source .*no object"),
        ("#!/nowhere/sh\n", "does not answer to --version"),
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


@pytest.mark.parametrize("works", [True, False])
def test_what_is_compiled_ahead_is_waited_for(works, tmp_path, monkeypatch, forgotten, capsys):
    """The compiler runs once and is announced once; what it refuses is told where the object is needed."""
    slow, log = tmp_path / "cc", tmp_path / "log"
    run = f'sleep 0.3; exec {cache.compiler()} "$@"' if works else "exit 1"
    slow.write_text(f"#!/bin/sh\n{ANSWERS}\necho compiled >> {log}; {run}\n")
    slow.chmod(0o755)
    monkeypatch.setattr(paths, "BUILD", tmp_path)
    monkeypatch.setattr(cache, "_SLOW", 0)
    monkeypatch.setenv("CC", str(slow))
    cache.compiler.cache_clear()
    cache._announce.cache_clear()
    cache.build_ahead("int ahead(void) { return 6; }")
    if works:
        assert cache.build("int ahead(void) { return 6; }").is_file()
        assert cache.build("int other(void) { return 7; }").is_file()
        assert log.read_text() == 2 * "compiled\n"
    else:
        with pytest.raises(cache.CompilerError, match="refused the generated source"):
            cache.build("int ahead(void) { return 6; }")
    assert capsys.readouterr().err.count("compiling for this machine") == 1


def test_the_first_compiler_that_is_there_is_taken(monkeypatch, forgotten):
    there = ["gcc", cache.PACKAGED]
    monkeypatch.setattr(cache, "found", lambda name: name if name in there else None)
    monkeypatch.delenv("CC", raising=False)
    for expected in [*there]:
        cache.compiler.cache_clear()
        assert cache.compiler() == expected
        there.remove(expected)
    cache.compiler.cache_clear()
    with pytest.raises(cache.CompilerError, match=r"no C compiler was found \(cc, gcc\): `pip install"):
        cache.compiler()
    there.append("gcc")
    monkeypatch.setenv("CC", "nonexistent-cc")
    with pytest.raises(cache.CompilerError, match=r"there is no C compiler CC='nonexistent-cc'"):
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
