"""The package without its checkout: an installed wheel runs the first example of the README in an empty folder."""

import os
import re
import shutil
import subprocess
import sys
import zipfile
from contextlib import redirect_stdout
from io import StringIO

import pytest

import railrepro
from railrepro import paths
from railrepro.compile.cache import cache_folder, user_folder

PARTS = ("railrepro", "data", "pyproject.toml", "README.md", "LICENSE")


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Folder that contains only the content of the wheel, which is built from a source distribution."""
    source, built, site = (tmp_path_factory.mktemp(name) for name in ("source", "built", "site"))
    for part in PARTS:
        copy = shutil.copytree if (paths.ROOT / part).is_dir() else shutil.copy
        copy(paths.ROOT / part, source / part)
    uv = [sys.executable, "-m", "uv", "build", "-q", "--offline", "--no-build-isolation", "--python", sys.executable]
    subprocess.run([*uv, "--out-dir", str(built), str(source)], check=True)
    (wheel,) = built.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    return site


def run(site, code, folder, **more):
    """Run a program with the wheel and this environment in a folder that is also the home; return its output."""
    foreign = ("RAILREPRO_ROOT", "RAILREPRO_OUTPUT", "XDG_CACHE_HOME")
    around = {name: value for name, value in os.environ.items() if name not in foreign}
    around |= {"HOME": str(folder), "PYTHONPATH": str(site)} | more
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=folder, env=around)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_first_example_runs_without_a_checkout_and_gives_the_same(site, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    example = re.search(r"```python\n(.*?)```", (paths.ROOT / "README.md").read_text(), re.S).group(1)
    with redirect_stdout(StringIO()) as here:
        exec(example, {})
    (tmp_path / "data").mkdir()
    (tmp_path / "data/vehicle.toml").write_text("# a stray file changes nothing")
    cached = tmp_path / ".cache/railrepro/compiled"  # saves a minute of compilation
    shutil.copytree(cache_folder(), cached, ignore=shutil.ignore_patterns("*.lock", "*.scratch", ".*"))
    shutil.copy(user_folder() / "key", cached)
    cached.chmod(0o700)
    before = set(cached.glob("*.so"))
    *table, file = run(site, example + "\nimport railrepro\nprint(railrepro.__file__)", tmp_path).splitlines()
    assert file == str(site / "railrepro/__init__.py")
    assert table == here.getvalue().splitlines()
    assert set(cached.glob("*.so")) == before
    written = {path.name for path in tmp_path.iterdir()} - {".config"}  # of Matplotlib
    assert written == {"data", ".cache", "first.png"}
    assert not list(site.rglob("*.so"))


def test_the_wheel_contains_all_inputs_and_c_sources(site):
    inputs = {*paths.DATA.glob("*.toml"), *paths.DATA.glob("tuned/*/*.json"), paths.DATA / "LICENSE"}
    expected = {file.relative_to(paths.DATA): file.read_bytes() for file in inputs}
    folder = site / "railrepro/data"
    assert {f.relative_to(folder): f.read_bytes() for f in folder.rglob("*") if f.is_file()} == expected
    code = {file.relative_to(paths.ROOT) for file in (paths.ROOT / "railrepro").rglob("*.[ch]")}
    assert code == {file.relative_to(site) for file in site.rglob("*.[ch]")}


def test_products_go_to_the_working_folder_or_where_they_are_redirected(site, tmp_path):
    code = "from railrepro import paths; print(paths.product('data/results/a.csv'), paths.source('data/vehicle.toml'))"
    inputs = site / "railrepro/data/vehicle.toml"
    assert run(site, code, tmp_path) == f"{tmp_path}/data/results/a.csv {inputs}\n"
    other = tmp_path / "other"
    (other / "data").mkdir(parents=True)
    (other / "data/vehicle.toml").write_text("")
    redirected = run(site, code, tmp_path, RAILREPRO_OUTPUT=str(other)).split()
    assert redirected == [f"{other}/data/results/a.csv", f"{other}/data/vehicle.toml"]


def test_the_names_of_the_package_exist_and_are_imported_when_they_are_used(site, tmp_path):
    assert all(callable(getattr(railrepro, name)) for name in railrepro.FACADE if name != "metrics")
    assert set(railrepro.FACADE) <= set(dir(railrepro)) and not hasattr(railrepro, "simulation_of")
    code = "import sys, railrepro; print(sorted({'casadi', 'numpy', 'pandas', 'scipy'} & set(sys.modules)))"
    assert run(site, code, tmp_path) == "[]\n"
