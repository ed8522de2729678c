"""From C to objects: whose folder they lie in, which compiler makes them, what is said of one that fails."""

import os
import subprocess
import sys

import pytest

from railrepro import paths
from railrepro.compile import cache
from railrepro.data import InputError
from railrepro.studies import store


@pytest.fixture
def forgotten():
    """The compiler is looked for again afterwards."""
    yield
    cache.compiler.cache_clear()


@pytest.fixture
def places(tmp_path, monkeypatch):
    """A checkout and a user's cache of one's own: their folders of compiled objects."""
    monkeypatch.setattr(paths, "BUILD", tmp_path / "build")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    return tmp_path / "build/compiled", tmp_path / "home/railrepro/compiled"


def test_compiled_code_lies_in_a_folder_that_only_this_user_can_write(places, tmp_path, monkeypatch):
    """What lies in it is run: not a folder that others can write, not one that cannot be made, not a link."""
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
    access = os.access  # root may write all that is not on a read-only disk
    monkeypatch.setattr(
        os, "access", lambda path, mode: not str(path).startswith(str(paths.BUILD)) and access(path, mode)
    )
    assert cache.cache_folder() == places[1]
    monkeypatch.delenv("RAILREPRO_STORE")
    assert store.folder() == places[1].with_name("store")


TEXT = "static const char much[65536] = {1}; int answer(void) { return 41 + much[0] + much[65535]; }"
LOADED = f"import ctypes; from railrepro.compile import cache; print(ctypes.CDLL(str(cache.build({TEXT!r}))).answer())"


def answer(tmp_path):
    """What the object says in a process of its own, which it may crash."""
    environment = os.environ | {"RAILREPRO_ROOT": str(tmp_path), "PYTHONPATH": str(paths.ROOT)}
    done = subprocess.run([sys.executable, "-c", LOADED], env=environment, capture_output=True, text=True)
    return done.stdout or f"{done.returncode} {done.stderr}"


SPOILT = {
    "cut": lambda content: content[: len(content) // 2],
    "flipped": lambda content: bytes(byte ^ 255 if i % 97 == 96 else byte for i, byte in enumerate(content)),
    "empty": lambda content: b"",
    "text": lambda content: b"an object",
    "other": lambda content: cache.build("int other(void) { return 1; }").read_bytes(),
}


@pytest.mark.parametrize("spoil", SPOILT)
def test_a_broken_object_is_made_again_and_crashes_nobody(spoil, places, tmp_path):
    made = cache.build(TEXT)
    whole = made.read_bytes()
    made.write_bytes(SPOILT[spoil](whole))
    assert answer(tmp_path) == "42\n"
    assert made.read_bytes() == whole


def test_objects_of_a_prepared_folder_are_not_loaded(places, tmp_path, monkeypatch):
    """It brings an object with the seal and the key of who prepared it, who is believed where there is no cache."""
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
    with pytest.raises(InputError, match=sentence) as told:
        cache.build("int number(void) { return 5; }")
    assert str(broken) in str(told.value) and "\n" not in str(told.value)
    assert not list(tmp_path.rglob("*.so"))


@pytest.mark.parametrize("works", [True, False])
def test_what_is_compiled_ahead_is_waited_for(works, tmp_path, monkeypatch, forgotten, capsys):
    """The compiler runs once and is announced once; what it refuses is raised where the object is needed."""
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
        with pytest.raises(InputError, match="refused the generated source"):
            cache.build("int ahead(void) { return 6; }")
    assert capsys.readouterr().err.count("compiling, once") == 1


def test_the_first_compiler_that_is_there_is_taken(monkeypatch, forgotten):
    there = ["gcc", cache.PACKAGED]
    monkeypatch.setattr(cache, "found", lambda name: name if name in there else None)
    monkeypatch.delenv("CC", raising=False)
    for expected in [*there]:
        cache.compiler.cache_clear()
        assert cache.compiler() == expected
        there.remove(expected)
    cache.compiler.cache_clear()
    with pytest.raises(InputError, match=r"no C compiler was found \(cc, gcc\): `pip install"):
        cache.compiler()
    there.append("gcc")
    monkeypatch.setenv("CC", "nonexistent-cc")
    with pytest.raises(InputError, match=r"there is no C compiler CC='nonexistent-cc'"):
        cache.compiler()


def test_processes_that_need_the_same_object_compile_it_once(tmp_path):
    slow, log = tmp_path / "slow-cc", tmp_path / "log"
    wait = f'case "$*" in *--version*) ;; *) echo compiled >> {log}; sleep 1;; esac'
    slow.write_text(f'#!/bin/sh\n{wait}\nexec {cache.compiler()} "$@"\n')
    slow.chmod(0o755)
    environment = os.environ | {"CC": str(slow), "RAILREPRO_ROOT": str(tmp_path), "PYTHONPATH": str(paths.ROOT)}
    environment |= {"XDG_CACHE_HOME": str(tmp_path / "home")}  # the key of the user, too, is made once
    script = "from railrepro.compile import cache; print(cache.build('int shared(void) { return 4; }'))"
    command = [sys.executable, "-c", script]
    both = [subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    objects = {process.communicate()[0] for process in both}
    assert len(objects) == 1
    assert log.read_text() == "compiled\n"
    assert sorted(file.suffix for file in (tmp_path / "build/compiled").iterdir()) == [".c", ".seal", ".so"]
