"""Rules of the robustness study on samples made by hand; their limits are those of data/claims.toml."""

import tomllib

import pandas as pd
import pytest

from railrepro import paths
from railrepro.studies import robustness

CLAIMS = tomllib.loads((paths.ROOT / "data/claims.toml").read_text())
LIMIT = {identity: claim["tolerance"] for identity, claim in CLAIMS.items()}
DONE = {f"{name}.failed": False for name in ("nmpc", "ltv_mpc_printed", "ndi", "brake.nmpc", "brake.nmpc_soft", "loss")}
# A sample in which the paper is right throughout.
IDEAL = DONE | {
    **{"nmpc.curve": 1e-3, "ltv_mpc_printed.curve": 1.5e-3, "ndi.curve": 4e-3},
    **{"nmpc.sine160": 1e-4, "ltv_mpc_printed.sine160": 2e-4, "ndi.sine160": 4e-4},
    **{"nmpc.sine400": 2e-4, "ltv_mpc_printed.sine400": 4e-4, "ndi.sine400": 9e-4},
    **{"nmpc.delay": 0.0, "nmpc.drift": -1e-3, "loss.slip": 0.02, "loss.error": 2e-3},
    **{"brake.nmpc.rmse": 1e-3, "brake.nmpc_soft.rmse": 2e-3, "brake.ndi.rmse": 4e-3},
    **{"brake.nmpc.distance": 990.0, "brake.nmpc_soft.distance": 980.0, "brake.ndi.distance": 1000.0},
}


def holds(identity, **changes):
    return bool(robustness._holds(pd.DataFrame([IDEAL | changes]))[identity].iloc[0])


@pytest.mark.parametrize("identity", robustness._holds(pd.DataFrame([IDEAL])))
def test_every_claim_holds_in_the_ideal_sample(identity):
    assert holds(identity)


def at_limit(identity, factor, limit):
    """The change that brings a claim to `factor` times its limit."""
    return {
        "C05": {"nmpc.curve": 1e-4, "ltv_mpc_printed.curve": factor * limit * 4e-3},
        "C06": {"nmpc.curve": factor * limit * 1.5e-3},
        "C08": {"nmpc.delay": -factor * limit},
        "C11": {"nmpc.drift": factor * limit * 1e-3},
        "C19": {"ndi.sine400": 4e-4 + factor * limit * 2e-4},
        "C23": {"loss.slip": factor * limit},
        "C28": {"loss.error": factor * limit * 1e-3},
        "C31": {"brake.nmpc_soft.rmse": factor * limit * 4e-3},
        "C32": {"brake.nmpc.distance": 1000.0 + limit + (factor - 1)},
    }[identity]


@pytest.mark.parametrize("identity", ["C05", "C06", "C08", "C11", "C19", "C23", "C28", "C31", "C32"])
def test_limits_are_those_of_the_report(identity, tmp_path, monkeypatch):
    larger_is_better = identity in ("C11", "C19")
    moved = 5.0 if identity == "C32" else 1.25 * LIMIT[identity]
    changed = "".join(f"[{name}]\ntolerance = {value}\n" for name, value in (LIMIT | {identity: moved}).items())
    (tmp_path / "data").mkdir()
    (tmp_path / "data/claims.toml").write_text(changed)
    for limit, folder in ((LIMIT[identity], ""), (moved, str(tmp_path))):
        monkeypatch.setenv("RAILREPRO_OUTPUT", folder)
        for factor in (0.98, 1.02):
            assert holds(identity, **at_limit(identity, factor, limit)) == ((factor > 1) == larger_is_better)


@pytest.mark.parametrize(
    ("identity", "changes"),
    [
        ("C05", {"nmpc.curve": 4e-3}),
        ("C06", {"nmpc.curve": 3.95e-3, "ltv_mpc_printed.curve": 9e-3}),
        ("C07", {"ltv_mpc_printed.curve": 1.01e-3}),
        ("C08", {"nmpc.delay": 1.02 * LIMIT["C08"]}),
        ("C11", {"nmpc.drift": 0.0}),
        ("C17", {"nmpc.sine400": 5e-4}),
        ("C17", {"ltv_mpc_printed.sine400": 1e-3}),
        ("C18", {"nmpc.sine400": 0.9e-4}),
        ("C18", {"ltv_mpc_printed.sine400": 1.9e-4}),
        ("C18", {"ndi.sine400": 3.9e-4}),
        ("C19", {"nmpc.sine400": 7e-4}),
        ("C20", {"nmpc.sine400": 1e-3}),
        ("C20", {"nmpc.sine160": 5e-4}),
        ("C28", {"loss.failed": True}),
        ("C30", {"brake.nmpc_soft.distance": 991.0}),
        ("C30", {"brake.nmpc_soft.rmse": 0.9e-3}),
        ("C30", {"brake.nmpc.failed": True}),
        ("C31", {"brake.nmpc.rmse": 5e-3}),
        ("C31", {"brake.nmpc_soft.failed": True}),
        ("C32", {"brake.nmpc_soft.distance": 1001.0}),
        ("C32", {"brake.nmpc.failed": True}),
        *((identity, {"nmpc.failed": True}) for identity in ("C05", "C06", "C07", "C08", "C11", "C17", "C18", "C20")),
    ],
)
def test_one_turned_quantity_turns_the_claim(identity, changes):
    assert not holds(identity, **changes)


def test_a_failed_competitor_is_beaten():
    assert holds("C05", **{"ndi.failed": True, "ndi.curve": 1e-6})
    assert not holds("C05", **{"ltv_mpc_printed.failed": True})
