"""Robustness study: samples, failures count as failures, shares by setting and profile, intervals from replicates."""

import os

import numpy as np
import pandas as pd
import pytest

from railrepro.evidence.uncertainty import robustness

T3 = "curve_entry_T3"


def test_samples_cover_the_ranges_and_are_reproducible():
    samples = robustness.draw(16, 2)
    assert samples == robustness.draw(16, 2)
    assert len(samples) == 16 * 2 * 3 and {s.setting for s in samples} == {"paper", "equal", "loop"}
    radii = [dict(s.vehicle)["wheel.radius"] for s in samples]
    assert 0.43 <= min(radii) < 0.45 and 0.48 < max(radii) <= 0.5
    assert {s.profile for s in samples} == {"cone", "s1002"}
    first, second = ([s.amplitude_mm for s in samples if s.replicate == k] for k in (0, 1))
    assert first != second, "replicates have scramblings of their own"


def sample(replicate=0, setting="equal", profile="cone", variant="corrected", ndi=2e-3, failed=0.0, number=0):
    metrics = {f"{T3}/nmpc/rmse_y": 1e-3, f"{T3}/ltv_mpc_printed/rmse_y": 1e-3, f"{T3}/ndi/rmse_y": ndi}
    if failed:
        del metrics[f"{T3}/nmpc/rmse_y"]
    head = {"number": number, "replicate": replicate, "setting": setting, "variant": variant, "profile": profile}
    return head | metrics | {f"{T3}/nmpc/failed": failed}


def shares(*rows):
    return robustness.shares(pd.DataFrame(rows)).set_index(["id", "setting"]).loc["C05"]


def test_a_failed_run_is_a_failure_and_not_missing():
    found = shares(sample(), sample(failed=1.0))
    assert found.loc["equal", "share"] == 0.5 and found.loc["equal", "samples"] == 2


def test_shares_are_split_by_terms_profile_and_model():
    found = shares(
        sample(), sample(profile="s1002", ndi=5e-4), sample(setting="loop"), sample(variant="printed", ndi=5e-4)
    )
    assert found.loc["equal", ["share", "cone", "s1002", "printed"]].tolist() == [0.5, 1.0, 0.0, 0.0]
    assert found.loc["loop", "share"] == 1.0


def test_the_interval_comes_from_the_replicates():
    rows = [sample(replicate=k, ndi=2e-3 if k % 2 else 5e-4) for k in range(4)]
    found = shares(*rows).loc["equal"]
    assert found["share"] == 0.5
    assert (found["low"], found["high"]) == (0.0, 1.0)
    same = shares(*[sample(replicate=k) for k in range(4)]).loc["equal"]
    assert (same["low"], same["high"]) == (1.0, 1.0)
    assert np.isnan(shares(sample()).loc["equal", "low"])


def test_what_decides_is_told_without_what_only_moves_with_it_and_without_chance():
    generator = np.random.default_rng(5)
    factors = pd.DataFrame(generator.random((64, 60)), columns=[f"x{i}" for i in range(60)])
    factors["profile"] = np.arange(64) % 2
    factors["alias"] = factors["profile"] + 0.5 * generator.random(64)
    held = pd.Series((factors["profile"] > 0.5).astype(float))
    assert robustness._deciding(factors, held) == "profile +1.00"
    both = held * (factors["x3"] > 0.5)
    first, second = robustness._deciding(factors, both).split(", ")[:2]
    assert first.startswith("profile +") and second.startswith("x3 +")
    for seed in range(10):
        chance = pd.Series(np.random.default_rng(seed).permutation(held))
        assert robustness._deciding(factors, chance) == ""


def test_tables_of_an_older_form_tell_nothing():
    assert robustness.shares(pd.DataFrame({"number": [0], "nmpc.curve": [1.0]})).empty
    assert robustness.shares(None).empty


@pytest.mark.slow
@pytest.mark.skipif(not os.environ.get("RAILREPRO_STUDY"), reason="a quarter of an hour; RAILREPRO_STUDY=1 runs it")
def test_a_sample_answers_the_statements():
    samples = robustness.draw(2, 1, settings=("paper",))[:1]
    table = pd.DataFrame([robustness.evaluate(s) for s in samples])
    found = robustness.verdicts(table, samples)
    assert {"C05", "C06", "C19", "C30", "C28"} <= set(found["id"])
    assert found["share"].isin([0.0, 1.0]).all()
