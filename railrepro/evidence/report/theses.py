"""Sentences of the report as predicates: each says when it is true, and what the tables refute is not said.

data/theses.toml has a sentence with its placeholders (`reasons`), the statements that it explains, and conditions:
comparisons like "paper: scenario/controller/metric > 0.71 * paper: scenario/nothing/metric" or "0.1 < name < 0.5" with
a name of `reasons.NAMED`, and verdicts like "C05 paper holds", "C05 equal fails" or "C05 calibrated holds".
"""

from __future__ import annotations

import operator
import re
from typing import Annotated, Literal

from railrepro import paths, schema
from railrepro.errors import InputError
from railrepro.evidence.claims import statements
from railrepro.evidence.claims.nominal import Nominal
from railrepro.evidence.claims.statements import REPRODUCED, MissingEvidence
from railrepro.evidence.report.reasons import NAMED, filled

FILE = "data/theses.toml"
_VERDICT = re.compile(r"(C\d\d) (\w+) (holds|fails)")
_METRIC = re.compile(r"(\w+): ([^/]+)/([^/]+)/(\w+)")
_NUMBER = re.compile(r"[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
_COMPARED = {"<": operator.lt, ">": operator.gt}


@schema.table
class Thesis:
    """Entry of data/theses.toml."""

    says: str
    true: Annotated[tuple[str, ...], schema.NOT_EMPTY]
    role: Literal["summary", "why", "holds_if"]
    of: tuple[str, ...] = ()


def load() -> dict[str, Thesis]:
    """All sentences by name, in their order."""
    file = paths.source(FILE)
    found = schema.build(dict[str, Thesis], schema.read(file), file.name)
    known = statements.load()
    for name, thesis in found.items():
        for identity in thesis.of:
            if identity not in known:
                raise InputError(f"{file.name}: [{name}] explains {identity}, which claims.toml does not have")
    return found


def holds(condition: str, nominal: Nominal) -> bool:
    """Whether a condition is true; InputError when it cannot be read, False when the results do not have it."""
    try:
        verdict = _VERDICT.fullmatch(condition)
        if verdict:
            return _reproduced(verdict[1], verdict[2], nominal) == (verdict[3] == "holds")
        parts = re.split(r" ([<>]) ", condition)
        if len(parts) < 3:
            raise InputError(f"{condition!r} is no condition; a comparison with < or > or a verdict is needed")
        terms = [_term(part, nominal) for part in parts[::2]]
    except MissingEvidence:
        return False
    return all(_COMPARED[sign](*terms[i : i + 2]) for i, sign in enumerate(parts[1::2]))


def _reproduced(identity: str, setting: str, nominal: Nominal) -> bool:
    if setting == "calibrated":
        table = nominal.results.optional("paper_like")
        return table is not None and bool(table.set_index("statement")["holds"].get(identity, False))
    finding = statements.find(identity, nominal.evidence(setting))
    return statements.load()[identity].judge(finding) == REPRODUCED


def _term(text: str, nominal: Nominal) -> float:
    """Value of a number, a metric, a named number or a product of them."""
    value = 1.0
    for part in text.split(" * "):
        metric = _METRIC.fullmatch(part)
        if metric:
            value *= nominal.evidence(metric[1])(*metric.groups()[1:])
        elif part in NAMED:
            number = _NUMBER.match(NAMED[part](nominal))
            if number is None:
                raise MissingEvidence(part)
            value *= float(number[0])
        elif _NUMBER.fullmatch(part):
            value *= float(part)
        else:
            raise InputError(f"{part!r} is no number, metric or named number; there are {', '.join(sorted(NAMED))}")
    return value


def refuted(nominal: Nominal) -> dict[str, list[str]]:
    """Sentences that the tables refute: name -> conditions that are not true."""
    found = {name: [c for c in thesis.true if not holds(c, nominal)] for name, thesis in load().items()}
    return {name: wrong for name, wrong in found.items() if wrong}


def summary(nominal: Nominal) -> list[str]:
    """The sentences of the summary that are true, with numbers linked."""
    return [
        filled(thesis.says, nominal, linked=True)
        for thesis in load().values()
        if thesis.role == "summary" and all(holds(c, nominal) for c in thesis.true)
    ]


def reasons_of(identity: str, role: str, nominal: Nominal, linked: bool = False) -> list[str]:
    """What is true of why a statement fails (`why`), or of when it would hold (`holds_if`)."""
    return [
        filled(thesis.says, nominal, linked=linked)
        for thesis in load().values()
        if identity in thesis.of and thesis.role == role and all(holds(c, nominal) for c in thesis.true)
    ]
