"""The order of rooms: a module imports from its own room and those before it, and never in a circle."""

import ast
import subprocess
import sys
from graphlib import TopologicalSorter

import pytest

import railrepro
from railrepro import paths
from railrepro.evidence.runs.sources import parsed

CORE = ("tried", "parent_death", "paths", "clock", "threads", "reads", "errors", "schema", "files")
CORE += ("compile", "vehicle", "track", "contact", "estimation", "model", "car", "control", "simulation")
EVIDENCE = ("runs", "claims", "bench", "uncertainty", "report", "score", "chain", "commands")
LISTED = (*CORE, *(f"evidence.{room}" for room in EVIDENCE))
ORDER = (*LISTED, "__main__")


def modules():
    """Text of all modules by dotted name, without `railrepro`."""
    base = paths.ROOT / "railrepro"
    files = {file.relative_to(base).with_suffix("").parts: file.read_text() for file in base.rglob("*.py")}
    return {".".join(name[:-1] if name[-1] == "__init__" else name): text for name, text in files.items()}


def room(module):
    parts = module.split(".")
    return ".".join(parts[: 2 if parts[0] == "evidence" else 1])


def used(text, known):
    """Modules that a text imports."""
    found = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "rooms are imported by their full names"
            names = [f"{node.module}.{alias.name}" for alias in node.names] + [str(node.module)]
        else:
            continue
        found |= {name.removeprefix("railrepro.") for name in names if name.startswith("railrepro.")}
    return found & set(known)


IMPORTS = {name: used(text, modules()) - {name, "", "evidence"} for name, text in modules().items()}


def test_a_module_imports_only_from_its_own_room_and_those_before_it():
    places = {name: ORDER.index(room(name)) for name in IMPORTS if name not in ("", "evidence")}
    upwards = {(name, other) for name in places for other in IMPORTS[name] if places[other] > places[name]}
    assert upwards == set()


def test_the_package_itself_imports_nothing_and_its_rooms_take_nothing_from_its_facade():
    assert IMPORTS[""] == set()
    taken = {f"railrepro.{name}" for name in railrepro.FACADE}
    short = {name for name, text in modules().items() if room(name) in CORE and taken & parsed(text)[1]}
    assert short == set(), "a stored graph and an order of rooms need the full names"


def test_modules_import_in_no_circle():
    assert len(list(TopologicalSorter(IMPORTS).static_order())) >= len(IMPORTS)


def test_contributing_lists_the_rooms_in_this_order():
    text = (paths.ROOT / "CONTRIBUTING.md").read_text()
    listed = text.split("circular imports are refused:")[1].split("The physics")[0].splitlines()
    rooms = [line.split()[0].replace("/", ".") for line in listed if line.strip()]
    first = listed[2].strip().split(", ")
    assert (*first, *rooms[1:]) == LISTED


def test_the_names_of_the_package_are_there_and_are_loaded_when_used():
    for name, home in railrepro.FACADE.items():
        found = getattr(railrepro, name)
        assert home in (f"{found.__module__}.{found.__qualname__}" if name != "metrics" else found.__name__)
    assert set(railrepro.FACADE) <= set(dir(railrepro))
    with pytest.raises(AttributeError, match="no attribute 'simulation_of'"):
        railrepro.simulation_of  # noqa: B018
    code = "import sys, railrepro; print(sorted({'casadi', 'numpy', 'pandas', 'scipy'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


@pytest.mark.parametrize(
    "code", ["from railrepro import simulate", "import railrepro", "import railrepro.paths", "from railrepro import *"]
)
def test_a_chapter_that_uses_a_name_of_the_package_depends_on_where_it_lives(code):
    assert "railrepro.simulation.simulate" in parsed(code)[1]
    assert "railrepro.simulation.simulate" not in parsed("from railrepro import paths, InputError")[1]
