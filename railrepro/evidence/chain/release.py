"""What a release consists of: how it is cited, metadata for CodeMeta and ReScience, an archive and a wheel.

CITATION.cff and pyproject.toml are the sources of all metadata.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import yaml

from railrepro import __version__, paths
from railrepro.errors import InputError
from railrepro.files import write

ARCHIVED = "railrepro/evidence/chain/archived.txt"
"""File that `git archive` fills with the id of the tree that it packs."""


def _citation() -> dict:
    return yaml.safe_load((paths.ROOT / "CITATION.cff").read_text(encoding="utf-8"))


def _project() -> dict:
    return tomllib.loads((paths.ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def _git(*arguments: str) -> str:
    try:
        command = ["git", "-C", str(paths.ROOT), *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError) as error:
        raise InputError("this needs git and a clone, not an archive") from error


def directory_id() -> str:
    """Software Heritage id of the committed files: that of git's tree, which an archive carries with it."""
    known = (paths.ROOT / ARCHIVED).read_text(encoding="utf-8").strip()
    tree = _git("rev-parse", "HEAD^{tree}") if known.startswith("$") else known
    return f"swh:1:dir:{tree}"


def codemeta() -> dict:
    """Content of codemeta.json."""
    citation, project = _citation(), _project()
    paper = citation["references"][0]
    return {
        "@context": "https://w3id.org/codemeta/3.0",
        "@type": "SoftwareSourceCode",
        "name": project["name"],
        "description": project["description"],
        "version": __version__,
        "datePublished": str(citation["date-released"]),
        "license": f"https://spdx.org/licenses/{project['license']}",
        "author": [{"@type": "Organization", "name": author["name"]} for author in citation["authors"]],
        "programmingLanguage": ["Python", "C"],
        "runtimePlatform": f"Python {project['requires-python']}",
        "operatingSystem": ["Linux", "macOS"],
        "softwareRequirements": project["dependencies"],
        "referencePublication": {
            "@type": "ScholarlyArticle",
            "name": paper["title"],
            "author": [_person(author) for author in paper["authors"]],
            "identifier": paper["identifiers"][0]["value"],
        },
    }


def _person(author: dict) -> dict:
    return {"@type": "Person", "givenName": author["given-names"], "familyName": author["family-names"]}


def rescience(abstract: str = "") -> dict:
    """Metadata of the article as the template of ReScience C reads them (`metadata.yaml`); what the journal or the
    authors add is empty."""
    citation, project = _citation(), _project()
    paper = citation["references"][0]
    names = [f"{author['given-names']} {author['family-names']}" for author in paper["authors"]]
    return {
        "title": f"[Re] {paper['title']}",
        "authors": [
            {"name": author["name"], "orcid": "", "email": "", "affiliations": "1,*"} for author in citation["authors"]
        ],
        "affiliations": [{"code": 1, "name": "", "address": ""}],
        "keywords": "model predictive control, independently rotating wheels, lateral guidance, wheel slide protection",
        "code": [{"url": ""}, {"doi": ""}, {"swh": directory_id()}],
        "data": [{"url": ""}, {"doi": ""}],
        "replication": [
            {"cite": f"{', '.join(names)}. {paper['title']}."},
            {"bib": "Ewering2023"},
            {"url": f"https://arxiv.org/abs/{paper['identifiers'][0]['value'].removeprefix('arXiv:')}"},
            {"doi": ""},
        ],
        "abstract": abstract or project["description"],
        "bibliography": "bibliography.bib",
        "type": "Replication",
        "domain": "Control Engineering",
        "language": "Python",
        "review": [{"url": ""}],
        "contributors": [{"name": "", "orcid": "", "role": role} for role in ("editor", "reviewer", "reviewer")],
        "dates": [{"received": ""}, {"accepted": ""}, {"published": ""}],
        "article": [{"number": ""}, {"doi": ""}, {"url": ""}],
        "journal": [{"name": "ReScience C"}, {"issn": "2430-3658"}, {"volume": ""}, {"issue": ""}],
    }


def submission() -> None:
    """Write build/article.pdf, and build/rescience: the files that the template of ReScience C asks of authors."""
    from railrepro.evidence.claims.nominal import Nominal
    from railrepro.evidence.report import article, claims

    nominal = Nominal()
    shown = article.render(claims.evaluate(nominal), nominal)
    folder = paths.BUILD / "rescience"
    write(paths.BUILD / "article.pdf", article.pdf(shown))
    for name, content in article.latex(shown).items():
        write(folder / name, content)
    _write_metadata(folder / "metadata.yaml", article.abstract(shown))
    print(f"{(paths.BUILD / 'article.pdf').relative_to(paths.ROOT)}; for ReScience C {folder.relative_to(paths.ROOT)}")


def _write_metadata(file: Path, abstract: str = "") -> None:
    write(file, yaml.safe_dump(rescience(abstract), sort_keys=False, allow_unicode=True))


def cite() -> None:
    """Print how this version is cited, with its id; write build/metadata.yaml."""
    citation, identity = _citation(), directory_id()
    authors = " and ".join(author["name"] for author in citation["authors"])
    _write_metadata(paths.BUILD / "metadata.yaml")
    print(f"{authors}. {citation['title']}. Version {__version__}. {identity}\n")
    fields = {"author": f"{{{authors}}}", "title": citation["title"], "version": __version__, "swhid": identity}
    lines = [f"  {name} = {{{value}}}," for name, value in fields.items()]
    print("\n".join(["@softwareversion{railrepro,", *lines, "}\n"]))
    paper = citation["references"][0]["identifiers"][0]["value"]
    print(f"together with the paper: {rescience()['replication'][0]['cite']} {paper}")
    print("metadata: CITATION.cff, codemeta.json; for ReScience C build/metadata.yaml, text by `make article`")


def store_codemeta() -> None:
    """Write codemeta.json."""
    write(paths.ROOT / "codemeta.json", json.dumps(codemeta(), indent=2, ensure_ascii=False) + "\n")


def dist() -> Path:
    """An archive of the committed files, which needs no git, and a wheel, in build/dist; returns the archive.

    Raises
    ------
    InputError
        Without git, or with changes that are not committed.
    """
    if _git("status", "--porcelain"):
        raise InputError("there are changes that are not committed; an archive holds what is committed")
    folder = paths.BUILD / "dist"
    folder.mkdir(parents=True, exist_ok=True)
    archive = folder / f"railrepro-{__version__}.tar.gz"
    _git("archive", "--format=tar.gz", f"--prefix=railrepro-{__version__}/", f"--output={archive}", "HEAD")
    build = [sys.executable, "-m", "uv", "build", "-q", "--wheel", "--offline", "--no-build-isolation"]
    subprocess.run([*build, "--python", sys.executable, "--out-dir", str(folder), str(paths.ROOT)], check=True)
    return archive
