"""From C to objects: the folder that they lie in, broken ones, the compiler that makes them, messages of a failure."""

import os
import subprocess
import sys
import threading

import pytest
from program import python

from railrepro import paths
from railrepro.compile import cache
from railrepro.data import InputError
from railrepro.studies import store

ANSWERS = "case $* in *--version*) echo broken 1.0; exit;; esac"


@pytest.fixture
def compiler(tmp_path, monkeypatch):
    """A function that makes a shell script the compiler, and a checkout of one's own."""
    script, usual, running = tmp_path / "cc", cache.compiler(), set(threading.enumerate())
    monkeypatch.setattr(paths, "BUILD", tmp_path / "build")

    def become(text):
        script.write_text(text.replace("USUAL", f'exec {usual} "$@"'))
        script.chmod(0o755)
        monkeypatch.setenv("CC", str(script))
        cache.compiler.cache_clear()

    yield become
    for thread in set(threading.enumerate()) - running:
        thread.join()
    cache.compiler.cache_clear()


@pytest.fixture
def places(tmp_path, monkeypatch):
    """The folders of compiled objects of a checkout and of a user's cache that are the test's own."""
    monkeypatch.setattr(paths, "BUILD", tmp_path / "build")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    return tmp_path / "build/compiled", tmp_path / "home/railrepro/compiled"


def test_compiled_code_lies_in_a_folder_that_only_this_user_can_write(places, tmp_path, monkeypatch):
    """Not a folder that others can write, not one that cannot be made, not a link."""
    folder, home = places
    assert cache.cache_folder() == folder and folder.stat().st_mode & 0o777 == 0o700
    folder.chmod(0o775)
    assert cache.cache_folder() == home and home.stat().st_mode & 0o777 == 0o700
    folder.chmod(0o755)
    folder.rename(tmp_path / "elsewhere")
    for spoil in (folder.touch, lambda: folder.symlink_to(tmp_path / "elsewhere")):
        spoil()
        assert cache.cache_folder() == home
        folder.unlink()
    monkeypatch.setattr(paths, "INSTALLED", True)
    assert cache.cache_folder() == home
    home.chmod(0o775)
    with pytest.raises(InputError, match="that you alone can write"):
        cache.cache_folder()


def test_a_checkout_that_one_may_only_read_uses_the_users_cache(places, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode: not str(path).startswith(str(paths.BUILD)))
    assert cache.cache_folder() == places[1]
    monkeypatch.delenv("RAILREPRO_STORE")
    assert store.folder() == places[1].with_name("store")


TEXT = "static const char much[65536] = {1}; int answer(void) { return 41 + much[0] + much[65535]; }"
LOADED = f"import ctypes; from railrepro.compile import cache; print(ctypes.CDLL(str(cache.build({TEXT!r}))).answer())"


def answer(tmp_path):
    """Output of the object in a process of its own, which it may crash."""
    done = python("-c", LOADED, RAILREPRO_ROOT=str(tmp_path))
    return done.stdout or f"{done.returncode} {done.stderr}"


@pytest.mark.parametrize(
    "spoil",
    [lambda whole: whole[: len(whole) // 2], lambda _: cache.build("int other(void) { return 1; }").read_bytes()],
    ids=["cut", "another object"],
)
def test_a_broken_object_is_made_again_and_crashes_nobody(spoil, places, tmp_path):
    made = cache.build(TEXT)
    whole = made.read_bytes()
    made.write_bytes(spoil(whole))
    assert answer(tmp_path) == "42\n" and made.read_bytes() == whole


def test_objects_of_a_prepared_folder_are_not_loaded(places, tmp_path, monkeypatch):
    """It has an object with seal and key of its author, who is trusted only where there is no cache of the user."""
    made = cache.build(TEXT)
    made.write_bytes(cache.build(TEXT.replace("41", "12")).read_bytes())
    made.with_suffix(".seal").write_bytes(cache.seal(made.name, made.read_bytes()))
    places[1].joinpath("key").rename(places[0] / "key")
    assert answer(tmp_path) == "42\n"
    key = places[1] / "key"
    assert key.stat().st_mode & 0o777 == 0o600 and len(key.read_bytes()) == 32
    inode = made.stat().st_ino
    assert answer(tmp_path) == "42\n" and made.stat().st_ino == inode
    monkeypatch.setenv("XDG_CACHE_HOME", "/dev/null")
    assert [answer(tmp_path) for _ in range(2)] == ["42\n"] * 2 and made.stat().st_ino != inode
    inode = made.stat().st_ino
    assert answer(tmp_path) == "42\n" and made.stat().st_ino == inode


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (f"#!/bin/sh\n{ANSWERS}\nexit 0\n", "refused the generated source .*no object"),
        ("#!/nowhere/sh\n", "does not answer to --version"),
    ],
)
def test_a_compiler_that_fails_is_reported_in_one_sentence(text, sentence, compiler, tmp_path):
    compiler(text)
    with pytest.raises(InputError, match=sentence) as raised:
        cache.build("int number(void) { return 5; }")
    assert str(tmp_path / "cc") in str(raised.value) and "\n" not in str(raised.value)
    assert not list(tmp_path.rglob("*.so"))


@pytest.mark.parametrize("works", [True, False])
def test_what_is_compiled_ahead_is_waited_for(works, compiler, tmp_path, monkeypatch, capsys):
    """The compiler runs once and is announced once; what it refuses is raised where the object is needed."""
    log, ahead = tmp_path / "log", "int ahead(void) { return 6; }"
    compiler(f"#!/bin/sh\n{ANSWERS}\necho compiled >> {log}; {'sleep 0.3; USUAL' if works else 'exit 1'}\n")
    monkeypatch.setattr(cache, "_SLOW", 0)
    cache._announce.cache_clear()
    cache.build_ahead(ahead)
    if works:
        assert cache.build(ahead).is_file() and cache.build("int other(void) { return 7; }").is_file()
        assert log.read_text() == 2 * "compiled\n"
    else:
        with pytest.raises(InputError, match="refused the generated source"):
            cache.build(ahead)
    assert capsys.readouterr().err.count("compiling, once") == 1


def test_the_first_compiler_that_is_installed_is_taken(compiler, monkeypatch):
    installed = ["gcc", cache.PACKAGED]
    monkeypatch.setattr(cache, "found", lambda name: name if name in installed else None)
    monkeypatch.delenv("CC", raising=False)
    for expected in [*installed]:
        cache.compiler.cache_clear()
        assert cache.compiler() == expected
        installed.remove(expected)
    cache.compiler.cache_clear()
    with pytest.raises(InputError, match=r"no C compiler was found \(cc, gcc\): `pip install"):
        cache.compiler()
    installed.append("gcc")
    monkeypatch.setenv("CC", "nonexistent-cc")
    with pytest.raises(InputError, match=r"there is no C compiler CC='nonexistent-cc'"):
        cache.compiler()


def test_processes_that_need_the_same_object_compile_it_once(compiler, tmp_path):
    log = tmp_path / "log"
    compiler(f'#!/bin/sh\ncase "$*" in *--version*) ;; *) echo compiled >> {log}; sleep 1;; esac\nUSUAL\n')
    environment = os.environ | {"RAILREPRO_ROOT": str(tmp_path), "PYTHONPATH": str(paths.ROOT)}
    environment |= {"XDG_CACHE_HOME": str(tmp_path / "home")}  # the key of the user, too, is made once
    script = "from railrepro.compile import cache; print(cache.build('int shared(void) { return 4; }'))"
    command = [sys.executable, "-c", script]
    both = [subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    assert len({process.communicate()[0] for process in both}) == 1
    assert log.read_text() == "compiled\n"
    assert sorted(file.suffix for file in (tmp_path / "build/compiled").iterdir()) == [".c", ".seal", ".so"]
