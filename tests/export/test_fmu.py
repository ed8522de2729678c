"""The car as an FMU: valid, its own GUID, portable, with an answer to every input, several at a time, anywhere."""

import ctypes
import math
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import pytest
from units import Instance, fmpy

from railrepro.compile import cache
from railrepro.export.car import export_fmu
from railrepro.vehicle.parameters import load_vehicle

TORQUE, Y = ["tau_front_le"], ["front.y"]
CONE, LAG = {"contact.profile": "cone"}, {"drive.lag": 0.1}


@pytest.fixture(scope="module")
def unit(tmp_path_factory):
    """A car on T5, on cones, which have no flange, compiled without optimisation."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAILREPRO_CFLAGS", "-O0 -ffp-contract=off")
        return export_fmu(tmp_path_factory.mktemp("unit") / "car.fmu", "T5", 60.0, load_vehicle(**CONE))


def description(unit):
    return ElementTree.fromstring(zipfile.ZipFile(unit).read("modelDescription.xml"))


def test_an_fmu_is_valid_and_holds_sources_that_compile_to_the_interface(unit, tmp_path):
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(unit)) == []
    with zipfile.ZipFile(unit) as archive:
        source = archive.extract("sources/all.c", tmp_path)
    assert source.endswith(description(unit).find("CoSimulation/SourceFiles/File").get("name"))
    library = ctypes.CDLL(str(cache.build(Path(source).read_text(), portable=True)))
    assert library.fmi2DoStep and library.fmi2SetReal


def test_the_guid_follows_the_content(unit, tmp_path, monkeypatch):
    guids = [description(unit).get("guid")]
    monkeypatch.setattr(cache, "build", lambda text, portable: unit)
    for route, speed, changes in [("T5", 60.0, {}), ("T3", 60.0, {}), ("T5", 61.0, {}), ("T5", 60.0, LAG)]:
        file = export_fmu(tmp_path / "car.fmu", route, speed, load_vehicle(**CONE | changes))
        guids.append(description(file).get("guid"))
    assert guids[0] == guids[1] and len(set(guids)) == 4


def test_no_flag_asks_for_more_than_any_processor_has(monkeypatch):
    monkeypatch.delenv("RAILREPRO_CFLAGS", raising=False)
    assert not any(flag.startswith(("-march", "-mavx", "-mtune")) for flag in cache.flags(portable=True))


@pytest.mark.parametrize("value", [math.nan, math.inf, -100001.0])
def test_a_torque_out_of_range_is_refused_with_a_sentence(value, unit):
    car = Instance(unit, "car")
    with pytest.raises(fmpy.fmi1.FMICallException):
        car.set(TORQUE, [value])
    assert car.said == ["a value is out of the range that modelDescription.xml states"]
    car.step()
    assert math.isfinite(*car.get(Y))


def test_a_reset_car_begins_anew_and_an_unknown_variable_is_refused(unit):
    car = Instance(unit, "car")
    before = car.get(["front.p", *Y])
    car.step(0.05)
    assert car.get(["front.p"])[0] > before[0] + 2
    car.slave.reset()
    assert car.get(["front.p", *Y]) == before
    car.references["beyond"] = max(car.references.values()) + 1
    with pytest.raises(fmpy.fmi1.FMICallException):
        car.get(["beyond"])
    assert car.said == ["unknown value reference"]


def test_a_car_that_leaves_all_bounds_says_so(unit):
    car = Instance(unit, "car", parameters={"body.mass": 1e4})
    car.set(TORQUE, [1e5])
    with pytest.raises(fmpy.fmi1.FMICallException):
        for _ in range(400):
            car.step(0.05)
    assert car.said == ["a state of the car left all bounds, what follows means nothing"]
