"""Robustness study: samples, failed runs, shares by setting and profile, binomial intervals."""

from itertools import product

import numpy as np
import pandas as pd
import pytest

from railrepro.evidence.claims.statements import Evidence
from railrepro.evidence.uncertainty import robustness

T3 = "curve_entry_T3"


def test_samples_cover_the_ranges_and_are_reproducible():
    samples = robustness.draw(16)
    assert samples == robustness.draw(16)
    by_setting = [[s.values for s in samples if s.setting == setting] for setting in ("paper", "swarm", "loop")]
    assert by_setting == 3 * [[s.values for s in samples[:16]]], "one sequence for all settings"
    radii = [dict(s.values)["wheel.radius"] for s in samples]
    assert 0.43 <= min(radii) < 0.45 and 0.48 < max(radii) <= 0.5
    worlds = [s.world() for s in samples]
    assert {w.plant["contact.profile"] for w in worlds} == {"cone", "s1002"}
    assert {w.ltv for w in worlds} == {"ltv_mpc", "ltv_mpc_printed"}


def test_creep_slopes_of_both_rails_reach_the_car_and_other_parameters_stay_nominal():
    for given in robustness.draw(4, settings=("paper",)):
        vehicle, sets = given.world().vehicle, given.world().car().adhesion
        for rail, key in product(("dry", "poor"), ("k_a", "k_s")):
            assert getattr(sets[rail], key) == vehicle[f"adhesion.{rail}.{key}"]
    world = robustness.Sample(0, "paper", (("r_loss", 30.0), ("adhesion.poor.k_s over k_a", 0.5))).world()
    assert (world.r_loss, world.r_brake, world.plant, world.ltv) == (30.0, 1.0, {}, "ltv_mpc_printed")
    assert world.car().adhesion["poor"].k_s == 0.5 * world.car().adhesion["poor"].k_a


def sample(setting="swarm", profile="cone", ndi=2e-3, failed=0.0, number=0):
    metrics = {f"{T3}/nmpc/rmse_y": 1e-3, f"{T3}/ltv_mpc_printed/rmse_y": 1e-3, f"{T3}/ndi/rmse_y": ndi}
    if failed:
        del metrics[f"{T3}/nmpc/rmse_y"]
    head = {"number": number, "setting": setting, "profile": profile, "ltv": "ltv_mpc_printed"}
    return head | metrics | {f"{T3}/nmpc/failed": failed}


@pytest.fixture(autouse=True)
def spread(monkeypatch):
    """Spread between seeds of the nominal car; empty, whatever the committed probes say."""
    found = {}
    monkeypatch.setattr(robustness.Nominal, "evidence", lambda *_: Evidence({}, found))
    return found


def shares(*rows):
    return robustness.shares(pd.DataFrame(rows)).set_index(["id", "setting"]).loc["C05"]


def test_shares_are_split_by_setting_and_profile_and_a_failed_run_is_a_failure():
    found = shares(sample(), sample(profile="s1002", ndi=5e-4), sample(setting="loop"), sample("loop", failed=1.0))
    assert found.loc["swarm", ["share", "cone", "s1002"]].tolist() == [0.5, 1.0, 0.0]
    assert found.loc["loop", ["share", "samples"]].tolist() == [0.5, 2]


@pytest.mark.parametrize(
    ("held", "of", "low", "high"), [(16, 32, 0.3189, 0.6811), (0, 32, 0.0, 0.1089), (3, 3, 0.2924, 1.0)]
)
def test_the_interval_is_that_of_clopper_and_pearson(held, of, low, high):
    """Limits from tables of the beta distribution."""
    found = shares(*[sample(ndi=2e-3 if i < held else 5e-4) for i in range(of)]).loc["swarm"]
    assert (found["low"], found["high"]) == pytest.approx((low, high), abs=1e-4)


def test_a_lead_within_the_spread_of_the_nominal_seeds_is_a_tie_in_samples_too(spread):
    assert shares(sample()).loc["swarm", "share"] == 1.0
    spread[T3, "nmpc", "rmse_y"] = np.log(3.0)
    assert shares(sample()).loc["swarm", "share"] == 0.0


def test_the_deciding_parameter_is_next_to_the_share_of_its_statement():
    """NDI is behind on cones, in half of the samples."""
    drawn, rows = robustness.draw(64, ("paper",)), []
    for one in drawn:
        cone = one.world().plant["contact.profile"] == "cone"
        rows.append(dict(one.values) | sample("paper", ("s1002", "cone")[cone], 2e-3 if cone else 5e-4))
    found = robustness.decided(pd.DataFrame(rows)).set_index("id").loc["C05"]
    assert found["decided_by"] == "profile (cone, S1002)" and (found["share"], found["cone"]) == (0.5, 1.0)


def test_the_deciding_parameters_exclude_correlated_ones_and_chance():
    generator = np.random.default_rng(5)
    factors = pd.DataFrame(generator.random((64, 60)), columns=[f"x{i}" for i in range(60)])
    factors["profile"] = np.arange(64) % 2
    factors["alias"] = factors["profile"] + 0.5 * generator.random(64)
    held = factors["profile"].astype(float)
    assert robustness._deciding(factors, held) == ["profile"]
    assert robustness._deciding(factors, held * (factors["x3"] > 0.5))[:2] == ["profile", "x3"]
    for seed in range(10):
        assert robustness._deciding(factors, pd.Series(np.random.default_rng(seed).permutation(held))) == []
