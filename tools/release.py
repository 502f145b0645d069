"""Make a release: ``make release`` tests, builds, tries the wheel in a clean environment, and tags.

It tags only when everything before has passed, and pushes nothing. ``--dry-run`` leaves out the
commit of the changelog and the tag."""

import subprocess
import sys
import venv
from collections.abc import Callable, Sequence
from datetime import date
from pathlib import Path
from tempfile import TemporaryDirectory

from hpac_gym import __version__
from hpac_gym.command import command_parser, run
from hpac_gym.errors import HpacError

ROOT = Path(__file__).parents[1]
TRY = """
import gymnasium, hpac_gym
env = gymnasium.make("hpac_gym:HPAC-Grasp-v0", engine="mujoco")
env.reset(seed=0)
assert env.step(env.action_space.sample())
print(hpac_gym.__version__)
"""
"""What the installed wheel has to do."""


class ReleaseError(HpacError, RuntimeError):
    """Something of the release is not in order; nothing was tagged."""


def called(*words: object, cwd: Path, shown: bool = False) -> str:
    """Standard output of a command that has to succeed; shown instead of returned if `shown`.

    Raises:
        ReleaseError: It fails.
    """
    done = subprocess.run(
        [str(word) for word in words],
        cwd=cwd,
        text=True,
        stdout=None if shown else subprocess.PIPE,
        check=False,
    )
    if done.returncode:
        raise ReleaseError(f"'{' '.join(map(str, words))}' ended with status {done.returncode}")
    return done.stdout or ""


def clean_tree(root: Path) -> None:
    """Refuse uncommitted changes, and a version that was tagged before."""
    if changed := called("git", "status", "--porcelain", cwd=root).split("\n")[0]:
        raise ReleaseError(f"the working tree has changes: '{changed}'")
    if called("git", "tag", "--list", f"v{__version__}", cwd=root):
        raise ReleaseError(f"tag v{__version__} exists: raise __version__ in hpac_gym/__init__.py")


def changelog(root: Path) -> None:
    """Refuse a changelog without a section of this version that waits for its date."""
    if heading() not in (root / "CHANGELOG.md").read_text(encoding="utf-8"):
        raise ReleaseError(f"CHANGELOG.md has no line '{heading()}'")


def heading(when: str = "unreleased") -> str:
    """Heading of this version in the changelog."""
    return f"## [{__version__}] - {when}"


def tests(root: Path) -> None:
    """Pass the style and all tests, as public hosting does."""
    called(root / ".ci" / "run", cwd=root, shown=True)


def build(root: Path) -> None:
    """Write the sdist and the wheel into ``dist``."""
    for old in (root / "dist").glob("hpac_gym-*"):
        old.unlink()
    waiting = (root / "CHANGELOG.md").read_text(encoding="utf-8")
    date_changelog(root)  # as its tag will have it
    try:
        called(sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-t", "wheel", cwd=root)
    finally:
        (root / "CHANGELOG.md").write_text(waiting, encoding="utf-8")


def clean_environment(root: Path) -> None:
    """Install the wheel, with its dependencies, where nothing else is, and use it."""
    (wheel,) = (root / "dist").glob("*.whl")
    with TemporaryDirectory() as name:
        folder = Path(name)
        venv.create(folder / "env", with_pip=True)
        bin_ = folder / "env" / ("Scripts" if sys.platform == "win32" else "bin")
        called(bin_ / "python", "-m", "pip", "install", "--quiet", wheel, cwd=folder)
        for words in ((bin_ / "python", "-c", TRY), (bin_ / "hpac", "--version")):
            said = called(*words, cwd=folder).split()[-1]
            if said != __version__:
                raise ReleaseError(f"the installed wheel says version {said}, not {__version__}")


def date_changelog(root: Path) -> Path:
    """Write today's date into the heading of this version; returns the changelog."""
    path = root / "CHANGELOG.md"
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace(heading(), heading(f"{date.today()}"), 1), encoding="utf-8")
    return path


def tag(root: Path) -> None:
    """Date the changelog, commit it, and tag the commit."""
    path = date_changelog(root)
    called("git", "commit", "--quiet", "-m", f"Release {__version__}", path, cwd=root)
    called("git", "tag", "-a", f"v{__version__}", "-m", f"hpac_gym {__version__}", cwd=root)


CHECKS = (clean_tree, changelog, tests, build, clean_environment)
"""What has to pass before the tag, in order."""


def release(
    root: Path, checks: Sequence[Callable[[Path], None]] = CHECKS, dry_run: bool = False
) -> None:
    """Pass every check, then tag.

    Raises:
        ReleaseError: A check failed; nothing was committed or tagged.
    """
    for step in (*checks, *(() if dry_run else (tag,))):
        print(f"release {__version__}: {step.__name__.replace('_', ' ')}", flush=True)
        step(root)
    print("not tagged: --dry-run" if dry_run else f"tagged v{__version__}; push it with its branch")


def main(argv: list[str] | None = None) -> None:
    parser = command_parser("tools.release", __doc__ or "")
    parser.add_argument("--dry-run", action="store_true", help="check everything, tag nothing")
    release(ROOT, dry_run=parser.parse_args(argv).dry_run)


if __name__ == "__main__":
    sys.exit(run(main))
