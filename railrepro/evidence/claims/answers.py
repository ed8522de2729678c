"""The answer sheet: open questions to the authors, and what their answers do to the verdicts.

`data/answers.toml` asks in the order of what the answers decide, each question with a slot. Answers change the set-up
of the probe (`probe.ProbeSetup`) of the setting `paper`; only the parts that depend on them are driven again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from itertools import cycle
from pathlib import Path
from typing import Annotated

import pandas as pd

from railrepro import paths, schema
from railrepro.control.registry import PAPER_TRIO
from railrepro.errors import InputError
from railrepro.evidence.claims import probe, statements
from railrepro.evidence.claims.nominal import Nominal
from railrepro.evidence.claims.statements import Evidence, MissingEvidence
from railrepro.evidence.runs import tuning

SHEET = "data/answers.toml"
SETTING = "paper"
"""Setting that answers start from."""
CURVES = ("fig06", "fig07", "fig08", "fig09")
"""Figures of the paper whose digitised curves can be handed in."""


@schema.table
class Question:
    """Entry of data/answers.toml, see its head."""

    asks: str
    sets: Annotated[tuple[str, ...], schema.NOT_EMPTY]
    parts: Annotated[tuple[str, ...], schema.NOT_EMPTY]
    decides: tuple[str, ...]
    answer: tuple[schema.Free, ...] = ()
    unit: str = ""
    low: schema.Plain | None = None
    high: schema.Plain | None = None
    choices: tuple[str, ...] = ()

    def __post_init__(self):
        if self.answer and len(self.sets) % len(self.answer):
            raise ValueError(f"has {len(self.answer)} answers, 1 or {len(self.sets)} are needed")
        for value in self.answer:
            if self.choices and value not in self.choices:
                raise ValueError(f"has the answer {value!r}, allowed are {', '.join(self.choices)}")
            if not self.choices and not schema.is_number(value):
                raise ValueError(f"has the answer {value!r}, a number in {self.unit} is needed")
            low, high = self.low, self.high
            if not self.choices and not ((low is None or value >= low) and (high is None or value <= high)):
                raise ValueError(f"has the answer {value!r}, a number from {low} to {high} {self.unit} is needed")

    def given(self) -> dict[str, object]:
        """Answer by what it sets; fewer answers than targets repeat in their order."""
        return dict(zip(self.sets, cycle(self.answer), strict=False))


@dataclass(frozen=True)
class Sheet:
    """What a sheet says: questions by name, files of digitised curves by figure."""

    questions: dict[str, Question]
    curves: dict[str, Path] = field(default_factory=dict)

    @property
    def answered(self) -> dict[str, Question]:
        """The questions with an answer."""
        return {name: question for name, question in self.questions.items() if question.answer}


def read(path: Path | str | None = None) -> Sheet:
    """A sheet (default data/answers.toml); InputError with one sentence on what is wrong in it."""
    file = schema.location(path, paths.source(SHEET))
    content = schema.read(file)
    curves = content.pop("curves", {}) if isinstance(content, dict) else {}
    if not isinstance(curves, dict) or not set(curves) <= set(CURVES):
        raise InputError(f"{file.name}: [curves] has {curves}, allowed are files for {', '.join(CURVES)}")
    found = {}
    for name, given in curves.items():
        if not isinstance(given, str):
            raise InputError(f"{file.name}: [curves] {name} is {given!r}, the path of a CSV file is needed")
        if given:
            found[name] = file.parent / given
    questions = schema.build(dict[str, Question], content, file.name)
    for name, question in questions.items():
        _check(f"{file.name}: [{name}]", question)
    return Sheet(questions, found)


def load() -> dict[str, Question]:
    """The open questions by name, in their order."""
    return read().questions


def _check(where: str, question: Question) -> None:
    """Refuse parts, statements and targets that there are not."""
    known = {"parts": probe.PARTS, "decides": statements.load()}
    for key, names in known.items():
        unknown = set(getattr(question, key)) - set(names)
        if unknown:
            raise InputError(f"{where}: {key} has {min(unknown)!r}, allowed are {', '.join(names)}")
    own = {f"setup:{f.name}" for f in fields(probe.ProbeSetup)} | {"setting"}
    for target in question.sets:
        kind, _, key = target.partition(":")
        if target not in own and not (kind in ("vehicle", "brake_sweep", *PAPER_TRIO) and key):
            raise InputError(f"{where}: sets {target!r}, which is nothing that an answer can set")


def setup(answered: Mapping[str, Question]) -> probe.ProbeSetup:
    """The car, controllers and experiments that the answers describe; what is not answered stays nominal."""
    given = {target: value for question in answered.values() for target, value in question.given().items()}
    tuned_in = str(given.pop("setting", SETTING))
    parameters = {name: dict(tuning.load(name, tuned_in)["parameters"]) for name in PAPER_TRIO}
    changes: dict[str, dict] = {"vehicle": {}, "setup": {}, "brake_sweep": {}}
    for target, value in given.items():
        kind, _, key = target.partition(":")
        (parameters[kind] if kind in parameters else changes[kind])[key] = value
    world = probe.ProbeSetup(parameters, tuned_in, vehicle=changes["vehicle"], brake_sweep=changes["brake_sweep"])
    world.car()  # so that a value which the car refuses stops it before anything runs
    return replace(world, **changes["setup"])


def parts(answered: Mapping[str, Question]) -> list[str]:
    """Parts of the probe that depend on answers, in their order."""
    needed = {part for question in answered.values() for part in question.parts}
    return [part for part in probe.PARTS if part in needed]


def judged(evidence: Evidence) -> dict[str, str]:
    """Verdict of each statement that some evidence can decide."""
    found = {}
    for identity, statement in statements.load().items():
        try:
            found[identity] = statement.judge(statements.find(identity, evidence))
        except (KeyError, MissingEvidence):
            continue
    return found


def flips(answered: Mapping[str, Question], driven: probe.Rows | None = None) -> pd.DataFrame:
    """Verdicts before and after the answers by name: id, statement, before, after.

    Those of the setting `paper` that a probe can decide; the probe is driven unless its rows (scenario, controller,
    metric, value) are given.
    """
    world, needed = setup(answered), parts(answered)
    rows = probe.probe(world, needed) if driven is None else driven
    nominal = Nominal().evidence(SETTING)
    scenarios = {scenario for scenario, *_ in rows}
    metrics = {key: value for key, value in dict(nominal.metrics).items() if key[0] not in scenarios}
    # seeds of a swarm leave nothing open where the authors say what theirs found
    told = {target.partition(":")[0] for question in answered.values() for target in question.sets}
    spread = {key: value for key, value in nominal.spread.items() if key[1] not in told}
    after = judged(Evidence(metrics | {row[:3]: row[3] for row in rows}, spread))
    before, known = judged(nominal), statements.load()
    return pd.DataFrame(
        [(i, known[i].statement, before.get(i, ""), verdict) for i, verdict in after.items()],
        columns=["id", "statement", "before", "after"],
    )
