"""The car agrees with the same car in Exudyn, with the project's creep law and with an independent one; so do rails
and contact."""

from dataclasses import astuple

import exudyn_car
import numpy as np
import pandas as pd
import pytest
import second_opinion

from railrepro.contact.creep import polach
from railrepro.contact.table import middle_patch
from railrepro.track.alignment import Alignment, Segment, alignments
from railrepro.track.table import Track, build_table
from railrepro.vehicle.parameters import load_vehicle

MISSING = "the group `bench` is installed by `make test-extras`"


def our_creep(vehicle, _stiffness, load, nu_x, nu_y, spin, slip_speed):
    """The creep law of the project with the arguments of `exudyn_car.creep`."""
    a, b, kalker = middle_patch(vehicle)
    scale = ((load + 1) / vehicle.contact.nominal_load) ** (1 / 3)
    rail = astuple(vehicle.adhesion["dry"])
    law = (nu_x, nu_y, spin, load, scale * a, scale * b, *kalker, vehicle.contact.shear_modulus, *rail, slip_speed)
    return polach(*law)


@pytest.mark.parametrize(("law", "usual", "short"), [(our_creep, 3e-4, 1e-5), (exudyn_car.creep, 0.02, 0.02)])
def test_straight_pulse_agrees_with_exudyn(law, usual, short):
    """With the same creep law only the step errors of both integrators remain, mainly of the contact modes. The
    independent law differs in how spin enters the direction of the force."""
    pytest.importorskip("exudyn", reason=MISSING)
    case = second_opinion.CASES[0]._replace(seconds=0.5)
    table = second_opinion.compare(case.name, second_opinion.replay(case, law=law))
    table = table.set_index(["car_step_ms", "quantity"])
    assert table.loc[("1", "lateral position"), "largest"] > 1e-3
    assert (table.loc["1", "relative"] < usual).all()
    assert (table.loc["0.05", "relative"] < short).all()
    assert (table["step_error"] < 3e-4).all() and table.loc[("1", "wheel load"), "step_error"] > 1e-6


@pytest.mark.parametrize("radius", [0.43, 0.46, 0.5])
def test_contact_of_the_second_car_agrees_with_ours(radius):
    """The same ellipse from other integrals; Kalker's coefficients by another interpolation between his rows."""
    vehicle = load_vehicle(**{"wheel.radius": radius, "contact.profile": "cone"})
    (*axes, coefficients), (*known, kalker) = exudyn_car.patch(vehicle), middle_patch(vehicle)
    assert axes == pytest.approx(known, rel=1e-6) and coefficients == pytest.approx(kalker, rel=6e-3)


BENDS = (
    Segment(40.0, (1 / 600, 1 / 300), (0.02, 0.06), (0.0, 0.01)),
    Segment(55.0, (1 / 300, 1 / 500), (0.06, 0.0), (0.01, 0.02)),
)


@pytest.mark.parametrize("alignment", [*(alignments()[name] for name in ("T1", "T4")), Alignment("bends", BENDS)])
def test_rails_of_the_second_car_lie_where_ours_do(alignment):
    """Integrated curvature against the tables of the track, before, on and after it."""
    track = Track(alignment.name, build_table(alignment))
    stations = exudyn_car.Rails(alignment).at(np.arange(-20.0, track.length + 20.0, 7.3))
    columns = pd.DataFrame(stations, columns=exudyn_car._STATION)
    assert pytest.approx(track.position(columns["p"]), abs=1e-9) == columns[list("xyz")].to_numpy().T
    angles = columns[["psi", "kappa", "phi", "dphi", "eps", "deps"]].to_numpy().T
    assert angles == pytest.approx(track.interpolate(columns["p"]), abs=1e-12)
