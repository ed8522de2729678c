"""Symbols in formulas of LaTeX, for the comparison of the notation table with the paper."""

from __future__ import annotations

import re

GREEK = (
    *("alpha", "beta", "gamma", "delta", "epsilon", "theta", "nu", "psi", "varphi", "sigma", "tau", "omega"),
    *("Gamma", "Delta"),
)
"""Greek letters that are symbols, not commands."""
_STYLES = {r"\bi": "b:", r"\boldsymbol": "b:", r"\cali": "c:", r"\mathcal": "c:"}
_SHORT = {r"\psitrax": r"\psi_{TrAx}", r"\ytrax": r"y_{TrAx}", r"\epsilon": r"\epsilon", r"\norm": ""}
_ATOM = re.compile(
    r"(?P<style>\\(?:bi|boldsymbol|cali|mathcal)\b\s*)?\{?(?P<base>\\(?:"
    + "|".join(GREEK)
    + r")(?![a-zA-Z])|[A-Za-z])\}*"
    r"(?:_(?P<sub>\{(?:[^{}]|\{(?:[^{}]|\{[^{}]*\})*\})*\}|[A-Za-z]))?"
)
_WORDS = re.compile(
    r"\\(?:text|label|tag|begin|end|eqref|eqn|CF|ur|operatorname|mathrm|mathbb)\s*\{[^{}]*\}(?:\{[^{}]*\})?"
    r"|\^\s*(?:\{[^{}]*\}|\\ur\{[^{}]*\}|\\tr\b|.)|\\[^a-zA-Z]"
)
_INDICES = set("jkitL")


def symbols(latex: str) -> set[str]:
    """Symbols of formulas: base with its style ("b:" bold, "c:" calligraphic) and its subscript, without decoration.

    Dots, hats, bars, superscripts and running indices are left out: "\\\\dot{\\\\psi}_{Ax_k}" is "psi_Ax".

    Parameters
    ----------
    latex : str
        Formulas without their dollars.
    """
    text = re.sub(r"\\(?:bi|boldsymbol)\s*\{\s*(\\(?:cali|mathcal)\{\w\})\s*\}", r"\1", latex)
    for short, long in _SHORT.items():
        text = text.replace(short, long)
    text = re.sub(r"_\s*\\ur\{([^{}]*)\}", r"_{\1}", text)
    text = re.sub(r"(_\{[^{}]*)\\ur\{([^{}]*)\}", r"\1\2", text)
    text = re.sub(r"(_\{[^{}]*_?\{?)\\ur\{([^{}]*)\}", r"\1\2", text)
    text = re.sub(r"\\(?:dot|ddot|hat|bar|tilde|accentset)\b\s*", " ", text)
    text = _WORDS.sub(" ", text)
    known = "|".join([*GREEK, "bi", "boldsymbol", "cali", "mathcal"])
    text = re.sub(rf"\\(?!(?:{known})(?![a-zA-Z]))[a-zA-Z]+", " ", text)
    found = set()
    for match in _ATOM.finditer(text):
        style = _STYLES.get((match["style"] or "").strip(), "")
        letters = re.findall(r"[A-Za-z]+", match["sub"] or "")
        sub = "".join(word for word in letters if word not in _INDICES)
        found.add(f"{style}{match['base'].lstrip(chr(92))}{'_' + sub if sub else ''}")
    return found


def formulas(tex: str) -> str:
    """All formulas of a LaTeX source between introduction and acknowledgments, one per line."""
    body = tex[tex.index(r"\section{Introduction}") : tex.index(r"\section*{Acknowledgments}")]
    inline = re.findall(r"\$([^$]+)\$", body)
    displayed = re.findall(r"\\begin\{(align|equation|subequations)\}(.*?)\\end\{\1\}", body, re.DOTALL)
    return "\n".join([*inline, *(text for _, text in displayed)])
