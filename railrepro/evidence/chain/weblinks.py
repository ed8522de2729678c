"""Links of a folder of HTML pages: inside they must lead somewhere, outside they must be well formed, and no page may
load anything from a network."""

from __future__ import annotations

import re
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

_LOADS = {**dict.fromkeys(("script", "img", "iframe", "source", "video", "audio", "embed"), "src"), "object": "data"}
_RELATIONS = {"stylesheet", "icon", "preload", "preconnect", "dns-prefetch", "modulepreload", "prefetch"}
_STYLE = re.compile(r"(?:@import\s*(?:url\()?|url\()\s*[\"']?((?:https?:)?//[^\"')\s]+)")
_SCRIPT = re.compile(r"(?:fetch|import|importScripts|WebSocket|EventSource)\(\s*[\"'`](?:https?:|wss?:)?//[^\"'`]+")


class _Page(HTMLParser):
    """Targets, links and loads of one page."""

    def __init__(self, text: str):
        super().__init__()
        self.targets: set[str] = {""}
        self.links: list[str] = []
        self.loads: list[str] = []
        self._script = self._style = False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        known = dict(attrs)
        self.targets |= {known[key] for key in ("id", "name") if known.get(key)}
        self._script, self._style = tag == "script", tag == "style"
        if tag == "a" and known.get("href") is not None:
            self.links.append(known["href"])
        loaded = known.get(_LOADS.get(tag, ""))
        if tag == "link" and _RELATIONS & set((known.get("rel") or "").split()):
            loaded = known.get("href")
        self.loads += [loaded] if loaded else []
        self.loads += [part.split()[0] for part in (known.get("srcset") or "").split(",") if part.strip()]
        self.loads += _STYLE.findall(known.get("style") or "")

    def handle_endtag(self, tag):
        self._script = self._style = False

    def handle_data(self, data):
        if self._script:
            self.loads += [found.split("(", 1)[1].strip("\"'` ") for found in _SCRIPT.findall(data)]
        if self._style:
            self.loads += _STYLE.findall(data)


def faults(folder: Path) -> list[str]:
    """One sentence per broken link, malformed address or load from a network in the HTML and CSS files of a folder."""
    pages = {file: _Page(file.read_text(encoding="utf-8")) for file in sorted(folder.rglob("*.html"))}
    found = [fault for file, page in pages.items() for fault in _page_faults(folder, file, page, pages)]
    for file in sorted(folder.rglob("*.css")):
        found += [f"{file.relative_to(folder)} loads {address}" for address in _STYLE.findall(file.read_text("utf-8"))]
    return found


def _page_faults(folder: Path, file: Path, page: _Page, pages: dict[Path, _Page]) -> Iterator[str]:
    name = file.relative_to(folder)
    for load in page.loads:
        parts = urlsplit(load)
        if parts.netloc:
            yield f"{name} loads {load} from a network"
        elif parts.scheme != "data" and not (file.parent / unquote(parts.path)).is_file():
            yield f"{name} loads {load}, which is not there"
    for link in page.links:
        fault = _link_fault(file, link, pages)
        if fault:
            yield f"{name} links to {link}, {fault}"


def _link_fault(file: Path, link: str, pages: dict[Path, _Page]) -> str | None:
    try:
        parts = urlsplit(link)
    except ValueError:
        return "which is no address"
    if parts.scheme in ("http", "https"):
        return None if re.fullmatch(r"[\w.-]+\.[a-z]{2,}(:\d+)?", parts.netloc) else "which is no address"
    if parts.scheme == "mailto":
        return None if re.fullmatch(r"[^@\s]+@[^@\s]+", parts.path) else "which is no address"
    if parts.scheme or parts.netloc:
        return "which is no address"
    target = file if not parts.path else Path(_clean(file.parent, unquote(parts.path)))
    if not target.is_file():
        return "which is not there"
    known = pages.get(target)
    if parts.fragment and known is not None and unquote(parts.fragment) not in known.targets:
        return "which has no such place"
    return None


def _clean(base: Path, relative: str) -> Path:
    """Path without "..", links of the file system kept."""
    parts: list[str] = []
    for part in (*base.parts, *Path(relative).parts):
        if part == "..":
            parts.pop()
        elif part != ".":
            parts.append(part)
    return Path(*parts)
