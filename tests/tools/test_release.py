"""A release is tagged only when every check has passed."""

import subprocess

import pytest

from hpac_gym import __version__
from tools import release
from tools.release import ReleaseError


def git(folder, *words) -> str:
    own = ("-c", "user.name=n", "-c", "user.email=e")
    return subprocess.run(
        ["git", *own, *words], cwd=folder, check=True, capture_output=True, text=True
    ).stdout


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    for name in ("AUTHOR", "COMMITTER"):
        monkeypatch.setenv(f"GIT_{name}_NAME", "n")
        monkeypatch.setenv(f"GIT_{name}_EMAIL", "e")
    git(tmp_path, "init", "--quiet")
    (tmp_path / "CHANGELOG.md").write_text(f"# Changelog\n\n{release.heading()}\n\n- All.\n")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "--quiet", "-m", "Begin")
    return tmp_path


FIRST = (release.clean_tree, release.changelog)


def test_when_all_has_passed_the_changelog_is_dated_and_the_commit_tagged_unless_dry(checkout):
    release.release(checkout, FIRST, dry_run=True)
    assert git(checkout, "tag") == ""
    release.release(checkout, FIRST)
    assert git(checkout, "tag") == f"v{__version__}\n"
    assert release.heading() not in (checkout / "CHANGELOG.md").read_text()
    assert git(checkout, "status", "--porcelain") == ""
    with pytest.raises(ReleaseError, match=f"tag v{__version__} exists"):
        release.release(checkout, FIRST)


def fails(root):
    raise ReleaseError("a test failed")


@pytest.mark.parametrize("place", range(3))
def test_what_fails_leaves_no_tag_and_no_commit(checkout, place):
    checks = [*FIRST]
    checks.insert(place, fails)
    with pytest.raises(ReleaseError, match="a test failed"):
        release.release(checkout, checks)
    assert git(checkout, "tag") == ""
    assert git(checkout, "rev-list", "--count", "HEAD") == "1\n"


def test_what_is_built_has_the_date_that_the_tag_gets(checkout, monkeypatch):
    text = []

    def look(*words, cwd):
        text.append((cwd / "CHANGELOG.md").read_text())
        raise ReleaseError("no hatchling")

    monkeypatch.setattr(release, "called", look)
    with pytest.raises(ReleaseError, match="no hatchling"):
        release.build(checkout)
    assert f"## [{__version__}] - 20" in text[0]
    assert git(checkout, "status", "--porcelain") == ""


def test_changes_and_a_missing_section_are_refused(checkout):
    (checkout / "CHANGELOG.md").write_text("# Changelog\n")
    with pytest.raises(ReleaseError, match=r"the working tree has changes: ' M CHANGELOG\.md'"):
        release.release(checkout, FIRST)
    git(checkout, "commit", "--quiet", "-am", "No section")
    with pytest.raises(ReleaseError, match=r"CHANGELOG\.md has no line '## \["):
        release.release(checkout, FIRST)
    assert git(checkout, "tag") == ""


def test_the_changelog_of_the_checkout_waits_for_its_version():
    release.changelog(release.ROOT)


def test_a_command_that_fails_is_told(tmp_path):
    with pytest.raises(ReleaseError, match="'false' ended with status 1"):
        release.called("false", cwd=tmp_path)
