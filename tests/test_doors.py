"""Ways to an environment: a clone by Git for Windows, make setup for any user and settings, the container, Binder."""

import json
import os
import re
import shutil
import subprocess
import tempfile
from itertools import takewhile
from pathlib import Path

import pytest

from railrepro import paths

STRANGER = 12345
"""Number of a user without a home."""
SETTINGS = {"PIP_USER": "1", "PIP_TARGET": "/nonexistent/a", "PIP_PREFIX": "/nonexistent/b", "PIP_NO_BINARY": ":all:"}
SETTINGS |= {
    "UV_REQUIRE_HASHES": "1",
    "UV_NO_BINARY": "1",
    "UV_TARGET": "/nonexistent/c",
    "UV_CONSTRAINT": "/nonexistent/d",
}
RAILREPRO = ("RAILREPRO_ROOT", "RAILREPRO_OUTPUT", "RAILREPRO_STORE", "RAILREPRO_LEADER", "MAKEFLAGS", "MAKELEVEL")
as_root = pytest.mark.skipif(os.getuid() != 0 or not shutil.which("setpriv"), reason="needs root and setpriv")
in_git = pytest.mark.skipif(not (paths.ROOT / ".git").exists(), reason="needs a git repository")


def git(*arguments, cwd=paths.ROOT):
    return subprocess.run(["git", "-C", str(cwd), *arguments], check=True, capture_output=True).stdout


@pytest.fixture
def open_folder(tmp_path):
    """A folder that other users reach, too; it is removed with its environment of 1 GB."""
    for folder in takewhile(lambda one: one != Path(tempfile.gettempdir()), (tmp_path, *tmp_path.parents)):
        folder.chmod(0o755)
    yield tmp_path
    shutil.rmtree(tmp_path)


@pytest.fixture
def clone(open_folder):
    """A copy of the checkout, without what it ignores, that belongs to the stranger."""
    folder = open_folder / "clone"
    for name in git("ls-files", "-co", "--exclude-standard").decode().splitlines():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        if (paths.ROOT / name).is_file():
            shutil.copy(paths.ROOT / name, folder / name)
    for path in (folder, *folder.rglob("*")):
        os.chown(path, STRANGER, STRANGER)
    return folder


@pytest.fixture
def home(open_folder):
    """An empty home of the stranger."""
    (open_folder / "home").mkdir()
    shutil.chown(open_folder / "home", STRANGER, STRANGER)
    return open_folder / "home"


def run(command, cwd, home, **more):
    """What a shell command of the stranger prints on both streams; it has to succeed."""
    own = ["setpriv", f"--reuid={STRANGER}", f"--regid={STRANGER}", "--clear-groups"]
    known = {
        name: value for name, value in os.environ.items() if name not in (*RAILREPRO, "UV_CACHE_DIR", "XDG_CACHE_HOME")
    }
    done = subprocess.run(
        [*own, "bash", "-c", command], cwd=cwd, env=known | {"HOME": str(home)} | more, capture_output=True, text=True
    )
    assert done.returncode == 0, f"{command}: {done.stdout[-1000:]}{done.stderr[-2000:]}"
    return done.stdout + done.stderr


@in_git
def test_a_clone_by_git_for_windows_has_the_committed_bytes(tmp_path):
    git("-c", "core.autocrlf=true", "clone", "-q", str(paths.ROOT), str(tmp_path / "clone"))
    changed = [
        name
        for name in git("ls-files", cwd=tmp_path / "clone").decode().splitlines()
        if b"\r\n" in (content := (tmp_path / "clone" / name).read_bytes()) and b"\0" not in content
    ]
    assert changed == []


def test_settings_of_a_user_for_other_packages_do_not_reach_the_environment():
    """Where packages come from is his, how others are installed is not; the recipe is tried below."""
    print_all = "include Makefile\n.PHONY: show\nshow:\n\t@env"
    around = (
        os.environ | SETTINGS | {"PIP_INDEX_URL": "kept", "UV_DEFAULT_INDEX": "kept", "UV_INDEX_LAB_PASSWORD": "kept"}
    )
    done = subprocess.run(
        ["make", "-s", "-f", "-", "show"], input=print_all, cwd=paths.ROOT, env=around, capture_output=True, text=True
    )
    seen = dict(line.partition("=")[::2] for line in done.stdout.splitlines())
    assert {name: seen[name] for name in SETTINGS if name in seen} == {"PIP_USER": "0"}
    assert [seen[name] for name in ("PIP_INDEX_URL", "UV_DEFAULT_INDEX", "UV_INDEX_LAB_PASSWORD")] == ["kept"] * 3


@pytest.mark.slow
@as_root
@in_git
def test_setup_by_a_user_without_a_home_and_with_settings_of_his_own(clone):
    run("make setup", clone, "/nonexistent", **SETTINGS)
    assert "numpy" in run(".venv/bin/python -c 'import numpy, railrepro; print(numpy.__name__)'", clone, "/nonexistent")


def steps(text, word):
    """Arguments of an instruction in a Dockerfile, in order."""
    return re.findall(rf"^{word} (.*(?:\\\n.*)*)$", text, re.M)


@pytest.mark.slow
@as_root
@in_git
def test_the_container_is_set_up_and_starts_as_its_file_says(clone, home):
    """Commands of the Dockerfile after USER, on a copy of the checkout as that user with an empty home; the last one
    with an option that ends JupyterLab. Those before it prepare a system."""
    text = (clone / "Dockerfile").read_text()
    system, own = text.split("\nUSER ")
    assert own.partition("\n")[0] not in ("root", "0")
    assert {"make", "gcc", "libc6-dev", "git"} <= set(" ".join(steps(system, "RUN")).split())
    for command in steps(own, "RUN"):
        run(command, clone, home)
    start = json.loads(steps(own, "CMD")[0])
    printed = run(" ".join([*start[:-1], f"'{start[-1]} --version'"]), clone, home)
    assert re.search(r"^\d+\.\d+\.\d+$", printed, re.M)


def test_the_dev_container_uses_the_dockerfile_and_its_user():
    text = (paths.ROOT / "Dockerfile").read_text()
    told = json.loads((paths.ROOT / ".devcontainer/devcontainer.json").read_text())
    assert (paths.ROOT / ".devcontainer" / told["build"]["dockerfile"]).samefile(paths.ROOT / "Dockerfile")
    assert told["remoteUser"] == steps(text, "USER")[-1]
    assert told["postCreateCommand"] in steps(text, "RUN")


@pytest.mark.slow
@as_root
@in_git
def test_binder_installs_the_lock_and_compiles_the_first_chapter(clone, home):
    run("python3 -m venv $HOME/python", clone, home)
    run("PATH=$HOME/python/bin:$PATH .binder/postBuild", clone, home)
    start = "PATH=$HOME/python/bin:$PATH .binder/start jupyter lab --version"
    assert re.fullmatch(r"\d+\.\d+\.\d+\n", run(start, clone, home))
    assert list(clone.glob("build/compiled/*.so"))
