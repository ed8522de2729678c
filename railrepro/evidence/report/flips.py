"""Verdicts that flip with the authors' answers on values that the paper does not print: `python -m railrepro probe
FILE.toml`, a filled copy of data/answers.toml. Runs are repeated with the answers, with exact measurements."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import Annotated, Literal

import pandas as pd

from railrepro import data, paths
from railrepro.control.registry import PAPER
from railrepro.evidence.claims import probe, statements
from railrepro.evidence.claims.nominal import Nominal
from railrepro.evidence.claims.setup import ProbeSetup, setup


@data.table
class Question:
    """Open question to the paper's authors about values that it does not print, one table of data/answers.toml. `asks`
    is its text. `sets` names what the answer sets: parameters, as "ndi:pole" (keys of the argument `values` of
    `setup.setup`), or "column", which has the answer "paper" (a designer set the poles of NDI) or "swarm" (a particle
    swarm found them). `parts` are the groups of runs (`probe.PARTS`) that depend on it. `answer` has a value (in
    `unit`) for each of `sets`, or fewer, used in turn; () is no answer yet. InputError if their number does not divide
    that of `sets`."""

    asks: str
    sets: Annotated[tuple[str, ...], data.NOT_EMPTY]
    parts: Annotated[tuple[Literal[probe.PARTS], ...], data.NOT_EMPTY]
    answer: tuple[data.Free, ...] = ()
    unit: str = ""

    def __post_init__(self):
        if self.answer and len(self.sets) % len(self.answer):
            raise ValueError(f"has {len(self.answer)} answers, 1 or {len(self.sets)} are needed")


def load(path: Path | str | None = None) -> dict[str, Question]:
    """Read open questions to the paper's authors: name -> `Question`. `path` is a copy of data/answers.toml with
    answers filled in, by default this file, which has none. InputError if it is wrong, or if car, controllers or
    scenarios refuse an answer."""
    file = data.location(path, paths.source("data/answers.toml"))
    questions = data.build(dict[str, Question], data.read(file), file.name)
    for name in [name for name, question in questions.items() if question.answer]:
        try:
            _setup([questions[name]])
        except data.InputError as error:
            raise data.InputError(f"{file.name}: {name}: {error}") from None
    return questions


def _setup(answered: Iterable[Question]) -> ProbeSetup:
    """Setup of the probe with answers to questions; InputError for one that car, controllers or scenarios refuse."""
    given = {key: value for each in answered for key, value in zip(each.sets, cycle(each.answer), strict=False)}
    return setup(given, given.pop("column", PAPER)).checked()


def flips(answered: Mapping[str, Question]) -> pd.DataFrame:
    """Judge the paper's statements before and after answers to open questions, with exact measurements: one row per
    statement about metrics of runs. `answered` maps names to questions with an answer. Only the runs that depend on an
    answer are simulated again. Columns id, statement (its text), before, after (verdicts, as "not reproduced")."""
    probed = _setup(answered.values())  # refuses a value before anything runs
    needed = {part for question in answered.values() for part in question.parts}
    rows = probe.probe(probed, [part for part in probe.PARTS if part in needed])
    known = Nominal().evidence(PAPER)
    scenarios = {scenario for scenario, *_ in rows}
    metrics = {key: value for key, value in dict(known.metrics).items() if key[0] not in scenarios}
    # a controller whose parameters the authors state has no scatter between swarms
    stated = {key.partition(":")[0] for question in answered.values() for key in question.sets}
    spread = {key: value for key, value in known.spread.items() if key[1] not in stated}
    before = statements.findings(known)
    after = statements.findings(statements.Evidence(metrics | rows, spread))
    rules = [(name, rule) for name, rule in statements.load().items() if name in before and name in after]
    found = [(name, rule.statement, rule.judge(before[name]), rule.judge(after[name])) for name, rule in rules]
    return pd.DataFrame(found, columns=["id", "statement", "before", "after"])


def main(settings: Sequence[str] = ()) -> None:
    """Command `probe`: simulate the nominal car and write data/results/nominal_metrics.csv, a row per metric and run,
    from which the statements are judged. `settings` (default all) are "paper" (exact measurements), "swarm" (the same,
    but poles of NDI by particle swarm) or "loop" (sensors). With the path of a filled copy of data/answers.toml
    instead, print the statements whose verdict its answers change."""
    if not settings or not settings[0].endswith(".toml"):
        probe.main(settings)
        return
    answered = {name: question for name, question in load(settings[0]).items() if question.answer}
    if not answered:
        raise data.InputError(f"{Path(settings[0]).name}: has no answer")
    verdicts = flips(answered)
    flipped = verdicts[verdicts["before"] != verdicts["after"]]
    print(f"{len(answered)} answers, {len(verdicts)} statements judged again, {len(flipped)} verdicts flip:")
    for row in flipped.itertuples():
        print(f"  {row.id}: {row.before} -> {row.after} ({row.statement})")
