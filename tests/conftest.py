"""Settings of all tests: the same examples every time, one thread a process, and what runs without
PyBullet.
"""

import os
import re
import signal
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import pytest
from hypothesis import settings

ROOT = Path(__file__).resolve().parents[1]
PYBULLET = find_spec("pybullet") is not None
CHROMIUM = Path("/usr/bin/chromium")
BROWSER = CHROMIUM.exists() and find_spec("playwright") is not None
LONGEST = "test_processor.py"
"""Comes first, so that no process of pytest-xdist waits for it at the end."""
LEFT_OUT = pytest.StashKey[list[str]]()
WITHOUT_BROWSER = pytest.StashKey[list[str]]()

os.environ.setdefault("OMP_NUM_THREADS", "1")
# A shell's background job ignores Ctrl-C, and what it starts would, too.
signal.signal(signal.SIGINT, signal.default_int_handler)

if find_spec("triton"):
    # Comes with PyTorch for CUDA. It and Mesa's OpenGL each bring an LLVM: loaded after a picture,
    # it ends the process.
    import triton  # noqa: F401

settings.register_profile("default", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("default")


def _needs_pybullet(path: Path) -> bool:
    """Whether a test file cannot even be imported without PyBullet, since it or a helper that it
    imports names it.
    """
    text = path.read_text(encoding="utf-8")
    if re.search(r"^(import|from) (pybullet|hpac_gym\.physics\.pybullet)\b", text, re.M):
        return True
    helpers = re.findall(r"^from (tests\.[\w.]+) import", text, re.M)
    return any(
        _needs_pybullet(ROOT.joinpath(*name.split(".")).with_suffix(".py")) for name in helpers
    )


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """Leave out the files that need PyBullet where it is not installed."""
    if PYBULLET or collection_path.suffix != ".py":
        return None
    return _needs_pybullet(collection_path) or None


@pytest.fixture(scope="session")
def runs_here() -> Callable[[Path], bool]:
    """Whether the tests of a file run on this machine."""
    return lambda path: PYBULLET or not _needs_pybullet(path)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Begin with the longest tests; leave out those that need PyBullet, by their marker or a
    parameter, where it is missing.

    Comes after pytest has left out the slow ones, which are not counted again.
    """
    items.sort(key=lambda item: item.path.name != LONGEST)
    if not BROWSER:
        left = [item for item in items if item.get_closest_marker("browser")]
        config.stash[WITHOUT_BROWSER] = [item.nodeid for item in left]
        config.hook.pytest_deselected(items=left)
        items[:] = [item for item in items if item not in left]
    if PYBULLET:
        return
    left = [item for item in items if item.get_closest_marker("pybullet") or _is_of_pybullet(item)]
    config.stash[LEFT_OUT] = [item.nodeid for item in left]
    config.hook.pytest_deselected(items=left)
    items[:] = [item for item in items if item not in left]


def _is_of_pybullet(item: pytest.Item) -> bool:
    values = item.callspec.params.values() if hasattr(item, "callspec") else ()
    parts = [part for value in values for part in (value if isinstance(value, tuple) else (value,))]
    return any(isinstance(part, str) and part == "pybullet" for part in parts)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node) -> None:
    """Take over what a worker of pytest-xdist left out; all of them collect the same."""
    output = getattr(node, "workeroutput", {})
    node.config.stash[LEFT_OUT] = output.get("left_out", [])
    node.config.stash[WITHOUT_BROWSER] = output.get("without_browser", [])


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Hand over what this worker of pytest-xdist left out."""
    if hasattr(session.config, "workeroutput"):
        stash = session.config.stash
        session.config.workeroutput["left_out"] = stash.get(LEFT_OUT, [])
        session.config.workeroutput["without_browser"] = stash.get(WITHOUT_BROWSER, [])


def pytest_terminal_summary(terminalreporter, config: pytest.Config) -> None:
    """Name and count what was left out."""
    if pages := config.stash.get(WITHOUT_BROWSER, []):
        terminalreporter.section(
            f"left out: needs {CHROMIUM} and the extra browser, one of which is missing"
        )
        for name in pages:
            terminalreporter.line(name)
        terminalreporter.line(f"{len(pages)} tests left out")
    if PYBULLET:
        return
    files = sorted(
        str(path.relative_to(ROOT))
        for path in (ROOT / "tests").rglob("test_*.py")
        if _needs_pybullet(path)
    )
    tests = config.stash.get(LEFT_OUT, [])
    terminalreporter.section("left out: needs PyBullet, which is not installed")
    for name in (*files, *tests):
        terminalreporter.line(name)
    terminalreporter.line(f"{len(files)} files and {len(tests)} tests left out")
