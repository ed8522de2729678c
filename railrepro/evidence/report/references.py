"""References of the article: those that its text cites, by number, from notebooks/book/references.bib."""

from __future__ import annotations

import re
import unicodedata

from railrepro import paths
from railrepro.errors import InputError

_ENTRY = re.compile(r"^@\w+\{(\w+),\n(.*?)^\}", re.DOTALL | re.MULTILINE)
_FIELD = re.compile(r"^\s*(\w+) = \{(.*)\},?$", re.MULTILINE)
_CITED = re.compile(r"\[(@\w+(?:; @\w+)*)\]")


class References:
    """Cited works in the order of their first mention."""

    def __init__(self) -> None:
        text = (paths.NOTEBOOKS / "book" / "references.bib").read_text(encoding="utf-8")
        self._known = {key: dict(_FIELD.findall(fields)) for key, fields in _ENTRY.findall(text)}
        self._cited: list[str] = []

    def numbered(self, text: str) -> str:
        """A text with its citations, like [@Polach1999; @Kalker1982], as links to the list.

        Raises
        ------
        InputError
            When a work is not in references.bib.
        """
        return _CITED.sub(lambda match: self._numbers(re.findall(r"@(\w+)", match[1])), text)

    def _numbers(self, keys: list[str]) -> str:
        for key in keys:
            if key not in self._known:
                raise InputError(f"[@{key}]: references.bib has no such work; it has {', '.join(sorted(self._known))}")
            if key not in self._cited:
                self._cited.append(key)
        return "\\[" + ", ".join(f"[{self._cited.index(key) + 1}](#references)" for key in keys) + "\\]"

    def listed(self) -> list[str]:
        """The cited works as a numbered list."""
        return [f"{i}. {_worded(self._known[key])}" for i, key in enumerate(self._cited, 1)]


def _worded(work: dict[str, str]) -> str:
    """Authors, title, where and when, in Markdown."""
    people = [_initials(name) for name in _plain(work["author"]).split(" and ")]
    where = _plain(work.get("journal") or work.get("booktitle") or work.get("publisher", ""))
    volume = f" {_plain(work['volume'])}" if "volume" in work else f" {work['eprint']}" if "eprint" in work else ""
    return f"{', '.join(people)}. {_plain(work['title'])}. *{where}*{volume}, {work['year']}."


def _initials(name: str) -> str:
    """Jan-Hendrik Ewering, written family name first, as J.-H. Ewering."""
    if "," not in name:
        return "et al" if name == "others" else name
    family, given = (part.strip() for part in name.split(",", 1))
    short = [re.sub(r"(\w)\w*\.?", r"\1.", word) for word in given.split()]
    return " ".join([*short, family])


def _plain(text: str) -> str:
    """Text of a BibTeX field without braces, its umlauts as letters."""
    accented = re.sub(r"\{?\\\"\{?(\w)\}?\}?", lambda m: unicodedata.normalize("NFC", m[1] + "\u0308"), text)
    return accented.replace("{", "").replace("}", "")
