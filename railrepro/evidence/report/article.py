"""The article: data/article_page.md with its numbers filled in, as Markdown for the book and as PDF.

`python -m railrepro article` writes build/article.pdf with the packages of the book: pandoc resolves citations and
makes Typst of the Markdown, Typst typesets it. No number of the prose is typed: each links to the file it comes from.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

import pandas as pd
import yaml

from railrepro import __version__, paths
from railrepro.control.registry import PAPER_TRIO
from railrepro.errors import InputError
from railrepro.evidence.claims import statements
from railrepro.evidence.claims.nominal import Nominal
from railrepro.evidence.report import claims, text, theses
from railrepro.evidence.report.reasons import filled, link, quantity
from railrepro.evidence.runs import tuning

TEMPLATE = "data/article_page.md"
WORKS = paths.NOTEBOOKS / "book" / "references.bib"
"""Works that the article cites, like [@Polach1999; @Polach2005]."""
_CITED = re.compile(r"\[(@\w+(?:; @\w+)*)\]")
_FIGURE = re.compile(r"!\[(fig\d\d_\w+)\] (.*)")
_SHOWN = re.compile(r"!\[Figure \d+\]\(figures/(\w+)\.png\)\n\n\*\*Figure \d+\.\*\* ([^\n]*)")
_MATH = re.compile(r"(\$\$?[^$]+\$\$?)")
_ALLOWED = re.compile(
    r"\{[^{}]*\}|\[@[^\]]*\]|\[\[\w+\]\]|`[a-z][\w .]*`|\bFigs?\. \d|\bT\d\b|\bS1002\b|\bCC-BY-4\.0\b|\by = 0\b"
)
"""What may have digits in the template: placeholders, code, names of figures, tracks and profiles."""


def render(table: pd.DataFrame, nominal: Nominal) -> str:
    """The article as Markdown with links relative to the checkout, of a table of `claims.evaluate`.

    Raises
    ------
    InputError
        With the line of the template that asks for what is not there, or has a number of its own.
    """
    return _Article(table, nominal).text()


_REFERENCES = "::: {#refs}\n:::"
"""Where pandoc lists the works."""


class _Article:
    """One rendering: figures and tables are numbered on the way."""

    def __init__(self, table: pd.DataFrame, nominal: Nominal):
        self._table, self._nominal = table, nominal
        self._works = set(re.findall(r"^@\w+\{(\w+),", WORKS.read_text(encoding="utf-8"), re.MULTILINE))
        template = paths.source(TEMPLATE).read_text(encoding="utf-8")
        self._figures = [match[1] for match in _FIGURE.finditer(template)]
        self._verdicts = claims.verdicts(table)
        judged = sum(verdict != claims.NO_VERDICT for verdict in self._verdicts.values())
        self._own = {
            "counted": f"[{claims.counted(table)}](data/results/claims.csv)",
            "without": f"[{text.without(table)}](data/results/claims.csv)",
            "judged": f"[{judged}](data/claims.toml)",
            "calibrated": f"[{(table['kind'] == 'calibrated').sum()}](data/claims.toml)",
        }
        self._tables = 0
        self._lines: list[str] = []

    def text(self) -> str:
        blocks: dict[str, Callable[[], list[str]]] = {
            "headline": lambda: headline(self._nominal, (34, 20, 24, 24, 24)),
            "summary": lambda: [" ".join(theses.summary(self._nominal))],
            "statements": self._statements,
            "conditions": self._conditions,
            "robustness": self._robustness,
            "matching": self._matching,
            "questions": text.questions,
            "tables": self._sources,
            "references": lambda: [_REFERENCES],
        }
        return text.page(TEMPLATE, blocks, self._line)

    def _line(self, line: str) -> str:
        """A line of the template as it is shown."""
        figure = _FIGURE.fullmatch(line)
        stray = re.search(r"\S*\d\S*", _ALLOWED.sub("", figure[2] if figure else _without_formulas(line)))
        if stray:
            raise InputError(f"has the number {stray[0]!r}, typed; a number comes from a table, like {{pole_cross}}")
        if figure:
            shown = self._figure(figure[1], self._prose(figure[2]))
        elif line.startswith("Table: "):
            self._tables += 1
            shown = f"**Table {self._tables}.** {self._prose(line.removeprefix('Table: '))}"
        else:
            shown = self._prose(line)
        self._lines.append(shown)
        return shown

    def _prose(self, line: str) -> str:
        """A line with its placeholders filled in, formulas left alone."""
        parts = _MATH.split(line)
        return "".join(part if part.startswith("$") else self._words(part) for part in parts)

    def _words(self, words: str) -> str:
        words = re.sub(r"\{(\w+)\}", lambda m: self._own.get(m[1], m[0]), words)
        words = re.sub(r"\{(C\d\d)\}", lambda m: self._verdict(m[1]), words)
        words = re.sub(r"\{(fig\d\d_\w+)\}", lambda m: self._mention(m[1]), words)
        for cited in _CITED.findall(words):
            missing = sorted(set(re.findall(r"@(\w+)", cited)) - self._works)
            if missing:
                raise InputError(f"[@{missing[0]}]: references.bib has no such work; it has {sorted(self._works)}")
        return filled(words, self._nominal, linked=True, strict=True)

    def _verdict(self, identity: str) -> str:
        if identity not in self._verdicts:
            raise InputError(f"{{{identity}}}: claims.toml has no such statement")
        return f"{_claim(identity)}: {self._verdicts[identity]}"

    def _figure(self, name: str, caption: str) -> str:
        if not (paths.source(f"figures/{name}.png")).exists():
            raise InputError(f"figures has no {name}; `make figures` draws the figures of the notebooks")
        number = self._figures.index(name) + 1
        return f"![Figure {number}](figures/{name}.png)\n\n**Figure {number}.** {caption}"

    def _mention(self, name: str) -> str:
        if name not in self._figures:
            raise InputError(f"{{{name}}}: the article does not show this figure")
        return f"[Figure {self._figures.index(name) + 1}](#article-{name})"

    def _statements(self) -> list[str]:
        """Every judged statement with its mark in each setting, and on the calibrated car."""
        rows = []
        for identity, own in self._table[self._table["kind"] == "statement"].groupby("id", sort=False):
            marks = {row.setting: text.MARKS[row.judged] for row in own.itertuples()}
            cells = [marks.get(setting, "") for setting in tuning.SETTINGS]
            cells = [marks[""], "", ""] if "" in marks else cells
            rows.append(
                [_claim(str(identity)), own["statement"].iloc[0], *cells, text.CALIBRATED[own["calibrated"].iloc[0]]]
            )
        heads = ["", "statement", *(f"`{setting}`" for setting in tuning.SETTINGS), "calibrated"]
        return text.rows_of(rows, heads, (5, 65, 10, 10, 10, 10))

    def _conditions(self) -> list[str]:
        """Why statements do not hold on `paper`, and when they would."""
        rows = []
        for role, head in (("why", ""), ("holds_if", "would hold if ")):
            for of, says in text.explained(self._table, self._nominal, role):
                rows.append([", ".join(map(_claim, of)), head + says])
        return text.rows_of(rows, ["", "reason, and condition under which it would hold"], (14, 86))

    def _robustness(self) -> list[str]:
        """How many verdicts hold in most of the samples."""
        fragile = [_claim(i) for i, verdict in self._verdicts.items() if verdict == claims.FRAGILE]
        said = f" Fragile, by rule, are {', '.join(fragile)}." if fragile else ""
        return [f"**Robustness.** {text.robust(self._nominal)}{said}"]

    def _matching(self) -> list[str]:
        """Result of the history matching, with the figure of its region when a notebook has drawn it."""
        lines = [f"**History matching** [@Vernon2010]. {text.matched(self._nominal)}"]
        name = text.region_figure()
        if name and self._nominal.results.optional("matching_waves") is not None:
            self._figures.append(name)
            lines += ["", self._figure(name, "Non-implausible region in pairs of its narrowest directions.")]
            lines[0] += f" {self._mention(name)} shows the non-implausible region."
        self._lines += lines
        return lines

    def _sources(self) -> list[str]:
        """The files that numbers of the article were read from."""
        files = {f for line in self._lines for f in re.findall(r"\]\((?!figures)([\w/.]+\.\w+)\)", line)}
        files |= {f for line in headline(self._nominal) for f in re.findall(r"\]\(([\w/.]+)\)", line)}
        links = [f"[{file.removeprefix('data/results/')}]({file})" for file in sorted(files)]
        links += [""] * (-len(links) % 3)
        rows = [links[i : i + 3] for i in range(0, len(links), 3)]
        return text.rows_of(rows, ["numbers were read from", "", ""], (30, 30, 30))


def headline(nominal: Nominal, widths: Sequence[int] = ()) -> list[str]:
    """Results of the paper and ours in the three settings, as NMPC / LTV-MPC as printed / NDI."""
    ranking = "NMPC < LTV-MPC < NDI"
    results = [
        ("RMSE of y in the curve entry on T3, 280 km/h (Fig. 6)", ranking, "curve_entry_T3", "rmse_y", "mm"),
        ("RMSE of y of the sine on T5, 400 km/h (Fig. 7)", ranking, "sine_tracking 400", "rmse_y", "mm"),
        ("RMSE of y on poor rail, 400 km/h (Fig. 8)", "oscillation", "adhesion_loss", "rmse_y", "mm"),
        ("RMSE of y while braking, 160 km/h (Fig. 9)", "NMPC < NDI", "braking", "rmse_y", "mm"),
        ("stopping distance (Fig. 9)", "NMPC < NDI", "braking", "stopping_distance", "m"),
    ]
    rows = []
    for what, paper, scenario, metric, unit in results:
        cells = [[_cell(nominal, s, scenario, name, metric, unit) for name in PAPER_TRIO] for s in tuning.SETTINGS]
        rows.append([f"{what} ({unit})", paper, *map(" / ".join, cells)])
    return text.rows_of(rows, ["result", "the paper", *(f"`{setting}`" for setting in tuning.SETTINGS)], widths)


def _cell(nominal: Nominal, setting: str, scenario: str, controller: str, metric: str, unit: str) -> str:
    """A linked number without its unit."""

    def found() -> str:
        value = nominal.evidence(setting)(scenario, controller, metric)
        return quantity(value, unit if unit == "mm" else "").removesuffix(" mm")

    try:
        return link(*nominal.traced(found))
    except statements.MissingEvidence:
        return "–"


def _claim(identity: str) -> str:
    return f"[{identity}](REPLICATION.md#{identity})"


def _without_formulas(line: str) -> str:
    """A line without its formulas, in which digits are indices, exponents or arguments of a command only."""
    for formula in _MATH.findall(line):
        line = line.replace(formula, re.sub(r"[_^]\{?\d", "", formula))
    return line


def pdf(article: str) -> bytes:
    """The article typeset; equal text and figures give equal bytes.

    Raises
    ------
    InputError
        When the packages of the book are missing, or the text cannot be typeset.
    """
    try:
        import pypandoc
        import typst
    except ImportError as error:
        raise InputError("the article needs the packages of the group `book`; `make article` installs them") from error
    title, body = article.removeprefix("# ").split("\n", 1)
    source = paths.NOTEBOOKS / "book" / "article.typ"
    options = ["--shift-heading-level-by=-1", "--wrap=none"]
    options += ["--citeproc", f"--bibliography={WORKS}", "--metadata=link-citations=true"]
    content = pypandoc.convert_text(_for_print(body), "typst", format="markdown-smart", extra_args=options)
    inputs = {"title": title, "version": __version__, "original": _original()}
    try:
        return typst.compile(
            (source.read_text(encoding="utf-8") + content).encode(),
            root=str(paths.ROOT),
            ignore_system_fonts=True,
            sys_inputs=inputs,
        )
    except RuntimeError as error:
        raise InputError(f"the article cannot be typeset: {error}") from error


def _for_print(body: str) -> str:
    """Markdown for pandoc: figures drawn, with captions; tables with captions; links from build/ to the checkout."""
    body = re.sub(r"\]\((?!#|figures/)", "](../", body)
    body = _SHOWN.sub(lambda m: f"![{m[2]}](/figures/{m[1]}.pdf){{#article-{m[1]}}}", body)
    return re.sub(r"^\*\*Table \d+\.\*\* ", "Table: ", body, flags=re.MULTILINE)


def for_the_book(article: str) -> str:
    """The article as a page of the book: figures with captions, links to claims and to the PDF."""
    body = re.sub(r"\[(C\d\d)\]\(REPLICATION\.md#C\d\d\)", r'<a href="REPLICATION.html#\1">\1</a>', article)
    body = _SHOWN.sub(lambda m: _book_figure(m[1], m[2]), body)
    body = _CITED.sub(lambda m: f"{{cite:p}}`{re.sub(r'; @', ',', m[1][1:])}`", body)
    title, rest = body.replace(_REFERENCES, "See the {doc}`bibliography`.").split("\n", 1)
    return f"{title}\n\n{{download}}`As a PDF <article.pdf>`, for a journal.\n{rest}"


def _book_figure(name: str, caption: str) -> str:
    return f"(article-{name})=\n```{{figure}} figures/{name}.png\n:alt: {name[6:].replace('_', ' ')}\n\n{caption}\n```"


def _original() -> str:
    """The paper that is replicated, in a line."""
    paper = yaml.safe_load((paths.ROOT / "CITATION.cff").read_text(encoding="utf-8"))["references"][0]
    names = [f"{author['given-names']} {author['family-names']}" for author in paper["authors"]]
    return f"{', '.join(names)}. {paper['title']}. {paper['identifiers'][0]['value']}"


_MARKS = {"✓": r"$\checkmark$", "✗": r"$\times$", "◐": r"$\circ$"}
_PREAMBLE = r"""% input this in article.tex of the template, before \begin{document}
\usepackage{longtable,booktabs,array,calc,graphicx,amssymb}
\providecommand{\tightlist}{}
\providecommand{\pandocbounded}[1]{#1}
"""


def latex(article: str) -> dict[str, bytes]:
    """The article for the template of ReScience C: content by file name, to be copied over those of the template.

    Links to files of the checkout are dropped; figures are PDF files beside the text.
    """
    import pypandoc

    body = re.sub(r"(?<!!)\[([^\]]*)\]\((?!#)[^)]*\)", r"\1", article.split("\n", 1)[1])
    shown = {f"{name}.pdf": (paths.source("figures") / f"{name}.pdf").read_bytes() for name, _ in _SHOWN.findall(body)}
    body = _SHOWN.sub(lambda m: f"![{m[2]}]({m[1]}.pdf){{#article-{m[1]} width=100%}}", body).replace(_REFERENCES, "")
    body = re.sub(r"^\*\*Table \d+\.\*\* ", "Table: ", body.replace("## References", ""), flags=re.MULTILINE)
    for mark, command in _MARKS.items():
        body = body.replace(mark, command)
    options = ["--shift-heading-level-by=-1", "--wrap=none", "--natbib"]
    content = pypandoc.convert_text(body, "latex", format="markdown-smart", extra_args=options)
    own = {"content.tex": content.encode(), "preamble.tex": _PREAMBLE.encode(), "bibliography.bib": WORKS.read_bytes()}
    return own | shown


def abstract(article: str) -> str:
    """The abstract without links."""
    section = article.partition("## Abstract\n")[2].partition("\n[")[0].partition("\n## ")[0]
    return re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", re.sub(r" \[@\w+\]", "", section)).strip()
