"""The names of the package."""

import subprocess
import sys

import pytest

import railrepro


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
