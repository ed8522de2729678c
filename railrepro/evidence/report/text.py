"""REPLICATION.md: the page of data/replication_page.md with its numbers and tables filled in; nothing typed by hand."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from railrepro import paths
from railrepro.control.registry import PAPER_TRIO
from railrepro.errors import InputError
from railrepro.evidence.claims import statements
from railrepro.evidence.claims.statements import MissingEvidence
from railrepro.evidence.report.evidence import Nominal
from railrepro.evidence.report.reasons import filled, link, quantity
from railrepro.evidence.runs import tuning

_MARK = {"reproduced": "✓", "partly": "◐", "not reproduced": "✗", "not testable": "–"}
_NAMES = {"nmpc": "NMPC", "ltv_mpc_printed": "LTV-MPC (printed)", "ndi": "NDI"}
_SECTIONS = (
    "Introduction", "Test Tracks", "Nonlinear Model Predictive Control", "Adhesion Control",
    "Evaluation of Lateral Control", "Evaluation of Longitudinal Control", "Evaluation of Integrated Control",
    "Discussion", "Conclusion",
)  # fmt: skip


def render(table: pd.DataFrame, nominal: Nominal) -> str:
    """The report as Markdown.

    Parameters
    ----------
    table : DataFrame
        See `railrepro.evidence.report.claims.evaluate`.
    nominal : Nominal
        Where numbers in the prose come from.

    Returns
    -------
    str
    """
    blocks: dict[str, Callable[[], list[str]]] = {
        "counts": lambda: [f"**{counted(table)}** {without(table)}"],
        "headline": lambda: headline(nominal),
        "tied": lambda: _tied(table),
        "numbers": lambda: _numbers(nominal),
        "questions": lambda: questions(nominal),
        "statements": lambda: _statements(table, nominal),
        "matching": lambda: matched(nominal),
        "condition": lambda: condition(nominal),
        "robustness": lambda: _how_sure(nominal),
        "errata": lambda: _register(nominal),
        "rules": lambda: _rules(table),
        "elsewhere": _elsewhere,
    }
    return page("data/replication_page.md", blocks, lambda line: filled(line, nominal, linked=True))


def page(relative: str, blocks: Mapping[str, Callable[[], list[str]]], fill: Callable[[str], str]) -> str:
    """A page with its blocks, lines like [[counts]], and the placeholders of its prose filled in.

    Raises
    ------
    InputError
        With file and line, when there is no such block or number.
    """
    file, lines = paths.source(relative), []
    for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1):
        block = re.fullmatch(r"\[\[(\w+)\]\]", line)
        if block and block[1] not in blocks:
            raise InputError(f"{file.name} line {number}: {line} is no block; there are {', '.join(sorted(blocks))}")
        try:
            lines += blocks[block[1]]() if block else [fill(line)]
        except InputError as error:
            raise InputError(f"{file.name} line {number}: {error}") from error
    return "\n".join(lines) + "\n"


def rows_of(rows: list[list[str]], heads: list[str], widths: Sequence[int] = ()) -> list[str]:
    """A table in Markdown; `widths` are relative, for a page that has a width."""
    return [
        "| " + " | ".join(heads) + " |",
        "|" + "".join("-" * width + "|" for width in widths or [3] * len(heads)),
        *("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows),
    ]


def _number(value: float, unit: str = "") -> str:
    if np.isnan(value):
        return "no value"
    return "a run failed" if np.isinf(value) else f"{value:.3g}{'' if unit in ('', '-') else ' ' + unit}"


def overall(table: pd.DataFrame) -> dict[str, str]:
    """Verdict over all settings by statement."""
    from railrepro.evidence.report.claims import verdicts

    return verdicts(table)


ORDER = ("reproduced", "reproduced in some settings only", "fragile", "partly", "not reproduced", "not testable")
"""Kinds of verdict over all settings."""


def kinds(table: pd.DataFrame) -> dict[str, list[str]]:
    """Ids of the judged statements by kind of verdict, in the order of `ORDER`."""
    from railrepro.evidence.report.claims import NO_VERDICT

    found: dict[str, list[str]] = {kind: [] for kind in ORDER}
    for identity, verdict in overall(table).items():
        if verdict != NO_VERDICT:
            found[re.sub(r" in setting .*", " in some settings only", verdict)].append(identity)
    return {kind: ids for kind, ids in found.items() if ids}


def counted(table: pd.DataFrame) -> str:
    """How many statements have which verdict."""
    found = kinds(table)
    parts = [f"{len(ids)} {kind}" for kind, ids in found.items()]
    return ", ".join(parts) + f", of {sum(map(len, found.values()))} statements."


def without(table: pd.DataFrame) -> str:
    """How many statements have no verdict."""
    number = len(overall(table)) - sum(map(len, kinds(table).values()))
    return f"{number} numbers of the paper set choices of ours and get no verdict."


def _cell(nominal: Nominal, setting: str, scenario: str, controller: str, metric: str, unit: str) -> str:
    """A linked number of the headline table, without its unit."""

    def found() -> str:
        return quantity(nominal.evidence(setting)(scenario, controller, metric), unit).removesuffix(" mm")

    try:
        return link(*nominal.traced(found))
    except MissingEvidence:
        return "–"


def headline(nominal: Nominal, widths: Sequence[int] = ()) -> list[str]:
    """The paper's headline results and ours, in the three settings."""
    ranking = "NMPC < LTV-MPC < NDI"
    results = [
        ("RMSE of y in the curve entry on T3, 280 km/h (Fig. 6)", ranking, "curve_entry_T3", "rmse_y", "mm"),
        ("RMSE of y of the sine on T5, 400 km/h (Fig. 7)", ranking, "sine_tracking 400", "rmse_y", "mm"),
        ("RMSE of y on poor rail, 400 km/h (Fig. 8), R as tuned", "oscillation", "adhesion_loss", "rmse_y", "mm"),
        ("RMSE of y while braking, 160 km/h (Fig. 9), R as tuned", "NMPC < NDI", "braking", "rmse_y", "mm"),
        ("stopping distance (Fig. 9), R as tuned", "NMPC < NDI", "braking", "stopping_distance", "m"),
    ]  # fmt: skip
    rows = []
    for what, paper, scenario, metric, unit in results:
        shown = "mm" if unit == "mm" else ""
        own = [
            " / ".join(_cell(nominal, setting, scenario, name, metric, shown) for name in PAPER_TRIO)
            for setting in tuning.SETTINGS
        ]
        rows.append([f"{what} ({unit})", paper, *own])
    note = "Ours as NMPC / LTV-MPC as printed / NDI; the paper brakes without LTV-MPC."
    heads = ["result", "the paper", *(f"`{setting}`" for setting in tuning.SETTINGS)]
    return [*rows_of(rows, heads, widths), "", note]


def _tied(table: pd.DataFrame) -> list[str]:
    """Where the paper's orders hold, from the verdicts themselves."""
    found = overall(table)
    orders = {"C05": "MPC before NDI on T3", "C16": "the ranking on T1 to T4", "C20": "MPC before NDI over speed"}
    return ["Orders: " + "; ".join(f"{what} ({i}): {found[i]}" for i, what in orders.items()) + "."]


def _numbers(nominal: Nominal) -> list[str]:
    table = pd.read_csv(paths.source("data/paper_numbers.csv"), dtype=str)
    rows = [
        [
            row.what, f"{row.paper} {row.unit}".removesuffix(" -"), row.role, filled(row.here, nominal, linked=True),
            file_link(row.where),
        ]
        for row in table.itertuples()
    ]  # fmt: skip
    return rows_of(rows, ["number", "paper", "role", "here", "table"])


def file_link(name: str) -> str:
    """A link to a file of the checkout, under its bare name."""
    return f"[{Path(name).name}]({name})"


def questions(nominal: Nominal) -> list[str]:
    """Unpublished numbers, by how much knowing them would narrow the region in which the statements hold together."""
    general = [
        "Poles (or gains) of the NDI, its sampling, and whether it has integral action or set-point rates.",
        "Weights, period and horizon that the swarm found, and the tracks, speeds and rails of its cost.",
        "R and Q of Fig. 8; torque limit and both settings of R in Fig. 9.",
        "Whether the LTV model keeps its affine term, and the heading at which T1 to T4 lie.",
    ]
    found = nominal.results.optional("matching_questions")
    where = _MATCHING.format("questions")
    asked = (
        [] if found is None else [f"{row.what}: {link(row.sentence, [where])}" for row in found.head(5).itertuples()]
    )
    return [f"{i}. {text}" for i, text in enumerate([*asked, *general], 1)]


def _evidence(statement: statements.Statement, data: str) -> str:
    """Links from a statement to its figure, the notebook cell that makes it and the tables that were judged."""
    links, name = [], statement.evidence
    if name.startswith("fig"):
        links.append(f"[{name}](figures/{name}.png)")
    cell = _source(statement.notebook, Path(name).name) if name else ""
    title, anchor = (f", cell {cell}", f"#cell-id={cell}") if cell else ("", "")
    links.append(f"[{statement.notebook}{title}](notebooks/{statement.notebook}.ipynb{anchor})")
    tables = dict.fromkeys([*data.split(), *([name] if "/" in name else [])])
    return ", ".join([*links, *map(file_link, tables)])


def _source(notebook: str, product: str) -> str:
    """Id of the code cell that writes a product; empty when none names it."""
    cells = json.loads((paths.NOTEBOOKS / f"{notebook}.ipynb").read_text(encoding="utf-8"))["cells"]
    named = [cell["id"] for cell in cells if cell["cell_type"] == "code" and product in "".join(cell["source"])]
    return named[-1] if named else ""


def _statements(table: pd.DataFrame, nominal: Nominal) -> list[str]:
    known, found, lines = statements.load(), overall(table), []
    for section in _SECTIONS:
        here = table[table["paper_ref"].str.startswith(section)]
        if here.empty:
            continue
        lines += [f"### {section}", ""]
        rows, reasons = [], []
        for identity, own in here.groupby("id", sort=False):
            statement, data = known[str(identity)], " ".join(own["data"])
            shown = [_shown(row) for row in own.itertuples()]
            rule = f"{_rule(statement)}: {statement.reason}"
            rows.append(
                [
                    str(identity), statement.statement, "<br>".join(shown), f"**{found[str(identity)]}**", rule,
                    _evidence(statement, data),
                ]
            )  # fmt: skip
            reasons += _reasons(str(identity), statement, own, nominal)
        lines += [*rows_of(rows, ["id", "statement", "found", "verdict", "holds when", "evidence"]), "", *reasons]
    return lines[:-1]


def marked(row) -> str:
    """Mark of the verdict in some setting, and the share of the samples when they tell."""
    return _MARK[row.verdict] + (f" {100 * row.share:.0f} %" if np.isfinite(row.share) else "")


def _shown(row) -> str:
    """Value and verdict in some setting, with its share."""
    if row.kind == "calibrated":
        return ""
    setting, share = f"`{row.setting}` " if row.setting else "", ""
    if np.isfinite(row.share):
        around = f" ({100 * row.share_low:.0f} to {100 * row.share_high:.0f})" if np.isfinite(row.share_low) else ""
        share = f", in {100 * row.share:.0f} %{around}"
    return f"{setting}{_MARK[row.verdict]} {_number(row.measured_value, row.unit)}{share}"


def _rule(statement: statements.Statement) -> str:
    parts = [f"above {statement.above:g}"] if statement.above is not None else []
    parts += [f"below {statement.below:g}"] if statement.below is not None else []
    return " and ".join(parts) or "no rule"


def _reasons(identity: str, statement: statements.Statement, own: pd.DataFrame, nominal: Nominal) -> list[str]:
    """Why a statement is not reproduced and what would have to be true; nothing for one that is."""
    if (own["verdict"] == "reproduced").all():
        return []
    common, special = filled(statement.why, nominal), {}
    for row in own.itertuples():
        words = row.why.replace(common, "").strip() if common else row.why
        special.setdefault(words, []).append(f"`{row.setting}`" if row.setting else "")
    said = [
        ", ".join(filter(None, setting)) + (": " if any(setting) else "") + w for w, setting in special.items() if w
    ]
    if common and own["why"].str.contains(common, regex=False).any():
        said = [filled(statement.why, nominal, linked=True), *said]
    lines = [f"- **{identity}**, why: {' '.join(said)}"]
    condition = would_hold(identity, statement, own, nominal)
    return [*lines, f"  Would hold if {condition}", ""] if condition else [*lines, ""]


def would_hold(identity: str, statement: statements.Statement, own: pd.DataFrame, nominal: Nominal) -> str:
    """What would have to be true for a statement to hold; for a fragile one also what decides over the samples."""
    said = [filled(statement.holds_if, nominal, linked=True)] if statement.holds_if else []
    shaky = own[(own["nominal"] == statements.REPRODUCED) & (own["verdict"] != statements.REPRODUCED)]
    study = nominal.results.optional("robustness_claims")
    if shaky.empty or study is None:
        return " ".join(said)
    rows = study[(study["id"] == identity) & study["setting"].isin(shaky["setting"])]
    decided = [f"`{row.setting}`: {row.decided_by}" for row in rows.itertuples() if isinstance(row.decided_by, str)]
    found = "; ".join(decided) if decided else "no single parameter"
    samples = f"over the samples [decides](data/results/robustness_claims.csv) (rank correlation) {found}."
    return " ".join([*said, samples if not said else samples[0].upper() + samples[1:]])


_MATCHING = "data/results/matching_{}.csv"


def matched(nominal: Nominal) -> list[str]:
    """What the history matching found; what to run when it was not run yet."""
    waves = nominal.results.optional("matching_waves")
    if waves is None:
        return ["Not run yet: `python -m railrepro matching` (part of `make study`)."]
    last, where = waves.iloc[-1], _MATCHING.format("waves")
    share, number, probes, most = (
        link(text, [where])
        for text in (
            quantity(last["surviving_share"], "%"),
            f"{len(waves)}",
            f"{int(waves['points'].sum())}",
            f"{int(last['most_statements'])} of {int(last['statements'])}",
        )
    )
    allowed = int(last["allowed"])
    are = "statement is" if allowed == 1 else "statements are"
    there = f"no more than {link(f'{allowed}', [where])} {are}" if allowed else "no statement is"
    given_up = str(last.get("given_up", "")).replace("nan", "").split()
    mostly = f" (in most of it {', '.join(given_up)})" if given_up else ""
    lines = [
        f"Of the prior (vehicle data, poles, weights, sampling, delay, profile and experiments over their ranges) "
        f"{share} survive {number} waves and {probes} probes: there {there} implausible{mostly}. "
        f"At best {most} statements hold in one probe.{_closest(nominal)}",
        "",
    ]
    if region_figure():
        lines += [f"![region](figures/{region_figure()}.png)", ""]
    region = nominal.results.optional("matching_region")
    if region is not None:
        narrowest = region.sort_values("narrowing", ascending=False, kind="stable").head(6)
        rows = [[row.what, *_ranges(row)] for row in narrowest.itertuples()]
        lines += [
            f"Where the region is narrowest ([all]({_MATCHING.format('region')})), nine tenths of what is left:",
            "",
        ]
        lines += [*rows_of(rows, ["what", "prior", "left"]), ""]
    return [*lines, *conflicting(nominal)]


def _ranges(row) -> tuple[str, str]:
    """Prior and what is left of it."""
    second = getattr(row, "second", np.nan)
    if np.isfinite(second):
        return "both", f"the second in {100 * second:.0f} %"
    pairs = (row.prior_low, row.prior_high), (row.low, row.high)
    prior, left = (f"{_rounded(low)} to {_rounded(high)}" for low, high in pairs)
    return prior, left


def _rounded(value: float) -> str:
    """Three digits, without an exponent below a million."""
    return f"{float(f'{value:.3g}'):g}"


def _closest(nominal: Nominal) -> str:
    """Which statements fail in the closest probe, the named set `paper_like`, and what the profile does by itself."""
    if not paths.source("data/results/paper_like.json").exists():
        return ""
    closest = json.loads(nominal.results.file("data/results/paper_like.json").read_text(encoding="utf-8"))
    failing = ", ".join(closest["fails"]) or "none"
    said = (
        " Counting rewards probes in which all are bad, so the closest is that with the least sum of squared misses, "
        f"the named set [paper_like](data/results/paper_like.json); there fail: {failing}."
    )
    return said + _by_hand(nominal)


def _by_hand(nominal: Nominal) -> str:
    """What the profile does by itself to the sum of squared misses of the nominal car."""
    switched = nominal.results.optional("matching_switched")
    if switched is None:
        return ""
    choices = list(switched)[: list(switched).index("missed")]
    ours, worn = (
        switched[(switched[choices] == place).all(axis=1)]["missed"].item()
        for place in ([0] * len(choices), ["S1002" in name for name in choices])
    )
    first, second = (link(_rounded(value), [_MATCHING.format("switched")]) for value in (ours, worn))
    return f" Our car on S1002 wheels misses them by {second} (sum of squares, sets of `paper`), on cones by {first}."


def condition(nominal: Nominal) -> list[str]:
    """For the summary: where the statements hold together best."""
    region = nominal.results.optional("matching_region")
    if region is None:
        return []
    narrowest = region.sort_values("narrowing", ascending=False, kind="stable")["what"].head(2)
    directions = link(" and ".join(narrowest), [_MATCHING.format("region")])
    return [f"**What would have to be true.** They narrow the unpublished most in {directions}.{_by_hand(nominal)}"]


def region_figure() -> str:
    """Name of the figure of the region that is left, when a notebook has drawn it."""
    return next((file.stem for file in sorted(paths.source("figures").glob("fig*_region.png"))), "")


def conflicting(nominal: Nominal) -> list[str]:
    """Smallest sets of statements that contradict each other on this plant."""
    conflicts = nominal.results.optional("matching_conflicts")
    if conflicts is None:
        return []
    if conflicts.empty:
        said = "No set of up to three statements is missing from the probes more than chance explains"
        return [f"{said} ([table]({_MATCHING.format('conflicts')})).", ""]
    rows = [[row.statements, f"{row.probes}"] for row in conflicts.itertuples()]
    where = _MATCHING.format("conflicts")
    lines = [f"Smallest sets of statements that no probe has together ([table]({where})), on this plant:", ""]
    return [*lines, *rows_of(rows, ["statements", "probes in which all others of the set hold"]), ""]


def _how_sure(nominal: Nominal) -> list[str]:
    text = (
        "The paper publishes almost no vehicle data. `make study` draws the unpublished parameters and choices over "
        "their ranges, tunes each controller again from a small common set, and asks the same predicates; a failed run "
        "counts as a failure. Intervals come from scrambled replicates of the sequence; one of no width says that all "
        "replicates agree, not that the share is known to less than a sample. A parameter is named as deciding where "
        "chance among all of them gives its rank correlation in less than one of twenty studies, a further one by what "
        "the ones before it leave. Few samples cannot tell parameters apart that happen to move together. "
        "The printed control model is a study of its own in the setting `equal`."
    )
    found = nominal.results.optional("robustness_claims")
    if found is None or "setting" not in found:
        return [text, "", "Not run yet with these predicates."]
    known = statements.load()
    rows = [
        [
            str(row.id),
            known[str(row.id)].statement if row.id in known else "",
            str(row.setting),
            quantity(row.share, "%"),
            f"{quantity(row.low, '%')} to {quantity(row.high, '%')}",
            f"{quantity(row.cone, '%')} / {quantity(row.s1002, '%')}",
            quantity(row.printed, "%"),
            row.decided_by if isinstance(row.decided_by, str) else "",
        ]
        for row in found.itertuples()
    ]
    heads = [
        "id",
        "statement",
        "setting",
        "holds in",
        "95 % interval",
        "cone / S1002",
        "printed",
        "decided by (rank correlation)",
    ]
    table = file_link("data/results/robustness_claims.csv")
    return [text, "", f"Table: {table}.", "", *rows_of(rows, heads)]


def _register(nominal: Nominal) -> list[str]:
    register, effects = (
        pd.read_csv(paths.source("data/discrepancies.csv")),
        nominal.results.optional("discrepancy_effects"),
    )
    rows = []
    for row in register.itertuples():
        own = pd.DataFrame() if effects is None else effects[effects["id"] == row.id]
        rows.append([str(row.id), row.printed, row.wrong_or_open, row.decision, _effect(own)])
    effects_link = "Table: " + file_link("data/results/discrepancy_effects.csv") + "."
    heads = ["", "printed", "wrong or open", "decision", "largest effect of the printed form on NMPC (D6: LTV-MPC)"]
    return [*rows_of(rows, heads), "", effects_link, "", "![effects](figures/fig22_discrepancies.png)"]


def _effect(own: pd.DataFrame) -> str:
    if own.empty:
        return "no run depends on it"
    lost = own["lost"].fillna(False).astype(bool)
    stored, parts = own[~lost], []
    if len(stored):
        worst = stored.loc[stored["rmse_change"].abs().idxmax()]
        effort = stored.loc[stored["effort_change"].abs().idxmax()]
        parts.append(f"RMSE {100 * worst['rmse_change']:+.1f} % ({worst['scenario']})")
        parts.append(f"torque {100 * effort['effort_change']:+.1f} % ({effort['scenario']})")
    if lost.any():
        parts.append("leaves the rail or triples the error on " + ", ".join(own[lost]["scenario"]))
    return "; ".join(parts)


def _elsewhere() -> list[str]:
    """What another computer may differ by."""
    file = "notebooks/chain.toml"
    tolerance = tomllib.loads(paths.source(file).read_text(encoding="utf-8"))["verify"]
    rows = [
        [own["table"], f"`{own['column']}`" + (f" where {own['rows']}" if "rows" in own else ""),
         f"{own['relative']:g}", own["why"]] for own in tolerance["own"]
    ]  # fmt: skip
    return [
        "On one machine with the locked packages tables and figures are bit-identical. Another processor or "
        "mathematical library rounds differently; `make verify` reruns everything and compares. Numbers may be apart "
        f"by {tolerance['relative']:g} of the largest value of their column or metric, images by "
        f"{tolerance['image_rms']:g} of 255 grey levels in the root mean square (`{file}`). Some numbers amplify "
        "rounding and may be apart by more; do not read them to more digits:",
        "",
        *rows_of(rows, ["table", "numbers", "apart by at most", "because"]),
        "",
        "The computers and compilers that were tried are listed in `notebooks/book/reproducibility.md`.",
    ]


def _rules(table: pd.DataFrame) -> list[str]:
    """Rules that were changed, with the verdict under the old rule when it was replaced and under the new one today."""
    found = overall(table)
    log = pd.read_csv(paths.source("data/rule_changes.csv"), dtype=str)
    rows = [[r.id, r.old, r.old_verdict, r.new, found.get(r.id, "none"), r.why] for r in log.itertuples()]
    return rows_of(rows, ["id", "old rule", "verdict then", "new rule", "verdict now", "why"])
