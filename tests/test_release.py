"""A release: its metadata agree, its id is that of git's tree, its archive needs no git."""

import json
import re
import shutil
import subprocess
import sys
import tarfile

import pytest

from railrepro import __version__, paths
from railrepro.errors import InputError
from railrepro.evidence.chain import release


def test_codemeta_is_that_of_its_sources():
    stored = json.loads((paths.ROOT / "codemeta.json").read_text())
    assert stored == release.codemeta(), "`python -m railrepro codemeta` writes it"
    assert stored["version"] == __version__ == release._citation()["version"]


def test_the_changelog_is_short_and_begins_with_this_version():
    lines = (paths.ROOT / "CHANGELOG.md").read_text().splitlines()
    assert len(lines) <= 60
    heading = next(line for line in lines if line.startswith("## "))
    assert heading == f"## {__version__.partition('.dev')[0]}, {release._citation()['date-released']}"


pytestmark = pytest.mark.skipif(shutil.which("git") is None, reason="there is no git")


@pytest.fixture
def clone(tmp_path, monkeypatch):
    """A repository with one file, and the file that `git archive` fills."""
    (tmp_path / release.ARCHIVED).parent.mkdir(parents=True)
    (tmp_path / release.ARCHIVED).write_text("$Format:%T$\n")
    (tmp_path / ".gitattributes").write_text((paths.ROOT / ".gitattributes").read_text())
    git = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@example.org"]
    for command in (["init", "-q"], ["add", "-A"], ["commit", "-qm", "one"]):
        subprocess.run([*git, *command], check=True)
    monkeypatch.setattr(paths, "ROOT", tmp_path)
    monkeypatch.setattr(paths, "BUILD", tmp_path.parent / "build")
    return tmp_path


def test_an_archive_knows_the_id_of_its_tree_without_git(clone, monkeypatch, tmp_path_factory):
    identity = release.directory_id()
    assert re.fullmatch(r"swh:1:dir:[0-9a-f]{40}", identity)
    archive, elsewhere = clone.parent / "one.tar", tmp_path_factory.mktemp("elsewhere")
    release._git("archive", f"--output={archive}", "HEAD")
    with tarfile.open(archive) as content:
        content.extractall(elsewhere, filter="data")
    monkeypatch.setattr(paths, "ROOT", elsewhere)
    monkeypatch.setenv("PATH", "")
    assert release.directory_id() == identity


def test_what_is_not_committed_makes_no_archive(clone, monkeypatch):
    (clone / "two").write_text("")
    with pytest.raises(InputError, match="changes that are not committed"):
        release.dist()
    monkeypatch.setenv("PATH", "")
    with pytest.raises(InputError, match="needs git and a clone"):
        release.dist()


def test_how_to_cite_names_version_paper_and_tree(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(paths, "BUILD", tmp_path)
    monkeypatch.setattr(release, "directory_id", lambda: "swh:1:dir:" + 40 * "a")
    release.cite()
    said = capsys.readouterr().out
    for part in (__version__, "swh:1:dir:aaaa", "arXiv:2309.09769", "@softwareversion{"):
        assert part in said
    assert "swh: swh:1:dir:aaaa" in (tmp_path / "metadata.yaml").read_text()


@pytest.mark.slow
def test_the_archive_passes_tests_without_git_and_has_a_wheel_beside_it(monkeypatch, tmp_path):
    if not (paths.ROOT / ".git").exists():
        pytest.skip("this is an archive")
    clone = tmp_path / "clone"
    subprocess.run(["git", "clone", "-q", str(paths.ROOT), str(clone)], check=True)
    monkeypatch.setattr(paths, "ROOT", clone)
    monkeypatch.setattr(paths, "BUILD", tmp_path)
    archive = release.dist()
    assert [file.suffix for file in archive.parent.glob("*.whl")] == [".whl"]
    with tarfile.open(archive) as content:
        content.extractall(tmp_path, filter="data")
    monkeypatch.setenv("PATH", "")
    command = [sys.executable, "-m", "pytest", "-q", "tests/test_release.py", "tests/test_model.py", "-m", "not slow"]
    folder = tmp_path / archive.name.removesuffix(".tar.gz")
    assert subprocess.run([*command, "-p", "no:cacheprovider"], cwd=folder, check=False).returncode == 0


def test_metadata_have_the_form_of_the_template_of_rescience(monkeypatch):
    """The parser of the template merges lists of entries with one key, and wants a contact among the authors."""
    monkeypatch.setattr(release, "directory_id", lambda: "swh:1:dir:" + 40 * "a")
    found = release.rescience("An abstract.")
    wanted = {"code": {"url", "doi", "swh"}, "replication": {"cite", "bib", "url", "doi"}, "data": {"url", "doi"}}
    wanted |= {"dates": {"received", "accepted", "published"}, "journal": {"name", "issn", "volume", "issue"}}
    for key, names in wanted.items():
        assert (
            all(len(entry) == 1 for entry in found[key]) and {name for entry in found[key] for name in entry} == names
        )
    assert all(author["affiliations"] == "1,*" for author in found["authors"])
    assert found["abstract"] == "An abstract." and found["title"].startswith("[Re] ")
    works = (paths.NOTEBOOKS / "book" / "references.bib").read_text()
    assert f"{{{found['replication'][1]['bib']}," in works
