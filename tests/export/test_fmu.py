"""The car as an FMU: valid, portable, with a GUID of its content; invalid calls and values are errors."""

import ctypes
import math
import re
import subprocess
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import pytest
from units import Instance, fmi2

from railrepro.compile import cache
from railrepro.control.ndi import NDI
from railrepro.data import InputError
from railrepro.export.car import export_fmu
from railrepro.export.controller import Export
from railrepro.export.fmu import PLATFORMS
from railrepro.simulation.scenarios import load_scenario
from railrepro.vehicle.parameters import load_vehicle

TORQUE, Y = ["tau_front_le"], ["front.y"]
CALLS = ("Instantiate", "DoStep", "SetReal", "GetReal", "GetInteger", "SetFMUstate", "DeSerializeFMUstate", "Terminate")
CONE, LAG = {"contact.profile": "cone"}, {"drive.lag": 0.1}


@pytest.fixture(scope="module")
def unit(tmp_path_factory):
    """A car on T5 with conical wheels, which have no flange, compiled without optimisation."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAILREPRO_CFLAGS", "-O0 -ffp-contract=off")
        return export_fmu(tmp_path_factory.mktemp("unit") / "car.fmu", "T5", 60.0, load_vehicle(**CONE))


def description(unit):
    return ElementTree.fromstring(zipfile.ZipFile(unit).read("modelDescription.xml"))


def test_an_fmu_is_valid_and_its_source_compiles_to_the_interface(unit, tmp_path):
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(unit)) == []
    with zipfile.ZipFile(unit) as archive:
        source = archive.extract("sources/all.c", tmp_path)
    assert source.endswith(description(unit).find("CoSimulation/SourceFiles/File").get("name"))
    library = ctypes.CDLL(str(cache.build(Path(source).read_text(), portable=True)))
    assert library.fmi2DoStep and library.fmi2SetReal


def test_the_guid_follows_the_content(unit, tmp_path, monkeypatch):
    guids = [description(unit).get("guid")]
    monkeypatch.setattr(cache, "build", lambda *text, **how: unit)
    for route, speed, changes in [("T5", 60.0, {}), ("T3", 60.0, {}), ("T5", 61.0, {}), ("T5", 60.0, LAG)]:
        file = export_fmu(tmp_path / "car.fmu", route, speed, load_vehicle(**CONE | changes))
        guids.append(description(file).get("guid"))
    assert guids[0] == guids[1] and len(set(guids)) == 4


def test_no_flag_needs_a_newer_processor(monkeypatch):
    monkeypatch.delenv("RAILREPRO_CFLAGS", raising=False)
    assert not any(flag.startswith(("-march", "-mavx", "-mtune")) for flag in cache.flags(portable=True))


def test_an_unknown_variable_and_a_state_out_of_bounds_are_errors(unit):
    car = Instance(unit, parameters={"body.mass": 1e4})
    car.references["beyond"] = max(car.references.values()) + 1
    with car.refused():
        car.get(["beyond"])
    car.set(TORQUE, [1e5])
    with car.refused():
        for _ in range(400):
            car.step(0.05)


def test_calls_out_of_order_are_errors(unit):
    car = Instance(unit, begun=False)
    calls = car.slave
    for call in (car.step, calls.exitInitializationMode, calls.terminate):
        with car.refused():
            call()
    car.begin(startTime=2.0, stopTime=2.003)
    for call in (calls.setupExperiment, calls.enterInitializationMode, calls.exitInitializationMode):
        with car.refused():
            call()
    with car.refused():
        car.step()  # at 0 s
    car.time = 2.0
    car.step()
    for time, length in ((2.0, 0.001), (2.002, 0.001), (2.001, 0.003)):  # repeated, left out, beyond the stop time
        with car.refused():
            calls.doStep(time, length)
    car.step(0.002)
    calls.terminate()
    for call in (calls.terminate, car.step, lambda: car.set(TORQUE, [1.0])):
        with car.refused():
            call()
    assert math.isfinite(*car.get(Y))


def test_another_guid_or_model_exchange_gives_no_instance(unit):
    car = Instance(unit)
    for guid, kind in ((b"{0}", fmi2.fmi2CoSimulation), (car.slave.guid.encode(), fmi2.fmi2ModelExchange)):
        car.said.clear()
        assert car.slave.fmi2Instantiate(b"", kind, guid, b"", ctypes.byref(car.slave.callbacks), 0, 0) is None
        assert len(car.said) == 1


@pytest.mark.skipif(None in map(cache.found, (cache.PACKAGED, "objdump")), reason="`make test-extras` has the compiler")
def test_an_fmu_holds_libraries_of_other_platforms(tmp_path, monkeypatch):
    """The libraries are linked, not run. Their interface is complete."""
    monkeypatch.setenv("RAILREPRO_CFLAGS", "-O0 -ffp-contract=off")
    needed = {f"fmi2{call}" for call in CALLS}
    file = Export(NDI(), load_scenario("curve_entry_T3").route()).write_fmu(tmp_path / "ndi.fmu", tuple(PLATFORMS))
    with zipfile.ZipFile(file) as archive:
        archive.extractall(tmp_path)
    of_windows, of_mac, _ = sorted(tmp_path.glob("binaries/*/railrepro_controller.*"), key=lambda path: path.suffix)
    listed = subprocess.run(["objdump", "-p", of_windows], capture_output=True, text=True, check=True).stdout
    assert set(re.findall(r"\] (fmi2\w+)$", listed, re.MULTILINE)) >= needed
    mac = of_mac.read_bytes()
    assert mac[:4] == b"\xcf\xfa\xed\xfe" and all(b"_" + call.encode() + b"\0" in mac for call in needed)


def test_a_platform_without_its_compiler_is_one_sentence(monkeypatch):
    monkeypatch.setattr(cache, "found", lambda name: None)
    with pytest.raises(InputError, match="compiler"):
        cache.build("", triple="x86_64-windows-gnu")
