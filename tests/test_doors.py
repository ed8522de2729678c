"""Installation: a clone by Git for Windows, `make setup` for any user and settings, the container, Binder."""

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

USER = 12345
"""Number of a user without a home."""
SETTINGS = {"PIP_NO_BINARY": ":all:"} | dict.fromkeys(("PIP_USER", "UV_REQUIRE_HASHES", "UV_NO_BINARY"), "1")
SETTINGS |= dict.fromkeys(("PIP_TARGET", "PIP_PREFIX", "UV_TARGET", "UV_CONSTRAINT"), "/nonexistent/folder")
"""Settings for the installation of other packages."""
SOURCES = dict.fromkeys(("PIP_INDEX_URL", "UV_DEFAULT_INDEX", "UV_INDEX_LAB_PASSWORD"), "kept")
FOREIGN = ("RAILREPRO_ROOT", "RAILREPRO_OUTPUT", "RAILREPRO_STORE", "RAILREPRO_LEADER", "MAKEFLAGS", "MAKELEVEL")
FOREIGN += ("UV_CACHE_DIR", "XDG_CACHE_HOME")
IN_GIT = (paths.ROOT / ".git").exists()
in_git = pytest.mark.skipif(not IN_GIT, reason="needs a git repository")
as_root = pytest.mark.skipif(not (IN_GIT and os.getuid() == 0 and shutil.which("setpriv")), reason="needs root and git")


def git(*arguments, cwd=paths.ROOT):
    return subprocess.run(["git", "-C", str(cwd), *arguments], check=True, capture_output=True).stdout


@pytest.fixture
def open_folder(tmp_path):
    """A folder that other users can read. It is removed at the end, as an environment has 1 GB."""
    for folder in takewhile(lambda one: one != Path(tempfile.gettempdir()), (tmp_path, *tmp_path.parents)):
        folder.chmod(0o755)
    yield tmp_path
    shutil.rmtree(tmp_path)


@pytest.fixture
def clone(open_folder):
    """A copy of the checkout, without ignored files, that belongs to the user."""
    folder = open_folder / "clone"
    for name in git("ls-files", "-co", "--exclude-standard").decode().splitlines():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        if (paths.ROOT / name).is_file():
            shutil.copy(paths.ROOT / name, folder / name)
    for path in (folder, *folder.rglob("*")):
        os.chown(path, USER, USER)
    return folder


@pytest.fixture
def home(open_folder):
    """An empty home of the user."""
    (open_folder / "home").mkdir()
    shutil.chown(open_folder / "home", USER, USER)
    return open_folder / "home"


def run(command, cwd, home, **more):
    """Run a shell command as the user and return its output on both streams. It must succeed."""
    as_user = ["setpriv", f"--reuid={USER}", f"--regid={USER}", "--clear-groups", "bash", "-c", command]
    around = {name: value for name, value in os.environ.items() if name not in FOREIGN} | {"HOME": str(home)} | more
    done = subprocess.run(as_user, cwd=cwd, env=around, capture_output=True, text=True)
    assert done.returncode == 0, f"{command}: {done.stdout[-1000:]}{done.stderr[-2000:]}"
    return done.stdout + done.stderr


@in_git
def test_a_clone_by_git_for_windows_has_the_committed_bytes(tmp_path):
    git("-c", "core.autocrlf=true", "clone", "-q", str(paths.ROOT), str(tmp_path / "clone"))
    files = [tmp_path / "clone" / name for name in git("ls-files", cwd=tmp_path / "clone").decode().splitlines()]
    assert [file for file in files if b"\r\n" in (content := file.read_bytes()) and b"\0" not in content] == []


def test_only_settings_of_a_user_for_sources_reach_the_environment():
    """A user decides where packages come from, not how they are installed. The tests below run the recipe."""
    around = {"cwd": paths.ROOT, "env": os.environ | SETTINGS | SOURCES, "capture_output": True, "text": True}
    print_all = "include Makefile\n.PHONY: show\nshow:\n\t@env"
    done = subprocess.run(["make", "-s", "-f", "-", "show"], input=print_all, **around)
    seen = dict(line.partition("=")[::2] for line in done.stdout.splitlines())
    assert {name: seen[name] for name in SETTINGS if name in seen} == {"PIP_USER": "0"}
    assert seen.items() >= SOURCES.items()


@pytest.mark.slow
@as_root
def test_setup_by_a_user_without_a_home_and_with_other_settings(clone):
    run("make setup", clone, "/nonexistent", **SETTINGS)
    assert "numpy" in run(".venv/bin/python -c 'import numpy, railrepro; print(numpy.__name__)'", clone, "/nonexistent")


def steps(text, word):
    """Arguments of all instructions with the name `word` in a Dockerfile."""
    return re.findall(rf"^{word} (.*(?:\\\n.*)*)$", text, re.M)


@pytest.mark.slow
@as_root
def test_the_commands_of_the_dockerfile_set_up_and_start_the_container(clone, home):
    """The commands after USER run on a copy of the checkout as a user with an empty home, the last one with an option
    that ends JupyterLab. The commands before USER prepare a system."""
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
    container = json.loads((paths.ROOT / ".devcontainer/devcontainer.json").read_text())
    assert (paths.ROOT / ".devcontainer" / container["build"]["dockerfile"]).samefile(paths.ROOT / "Dockerfile")
    assert container["remoteUser"] == steps(text, "USER")[-1]
    assert container["postCreateCommand"] in steps(text, "RUN")


@pytest.mark.slow
@as_root
def test_binder_installs_the_lock_and_compiles_the_first_chapter(clone, home):
    run("python3 -m venv $HOME/python", clone, home)
    run("PATH=$HOME/python/bin:$PATH .binder/postBuild", clone, home)
    start = "PATH=$HOME/python/bin:$PATH .binder/start jupyter lab --version"
    assert re.fullmatch(r"\d+\.\d+\.\d+\n", run(start, clone, home))
    assert list(clone.glob("build/compiled/*.so"))
