"""Generated faults in `hpac_gym/bridge` and `tools/evidence`, each of which the bridge's tests must notice.

    python tests/bridge/mutants.py --count 200 --seed 1

A mutant deletes a statement, flips a comparison, shifts a constant or swaps two arguments; they are
drawn at random from all that there are. Prints the share that a test noticed with its 95 % Wilson
interval, and every survivor. Survivors that were looked at and change nothing stand in
`EQUIVALENT`, with the reason, and are left out of the share."""

import argparse
import ast
import faulthandler
import os
import random
import re
import resource
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from importlib import import_module
from multiprocessing import Pipe, get_context
from pathlib import Path
from types import CodeType

import pytest
from scipy.stats import binomtest

ROOT = Path(__file__).parents[2]
PLACES = (Path("hpac_gym/bridge"), Path("tools/evidence"))
LEFT_OUT = {"__init__.py", "codes.py", "programs.py", "user_programs.py"}
"""Nothing to break, compared with the generated files, or run by slow tests."""
TESTS = {
    "conversation": "protocol reports patience link exits commands host_board evidence conform",
    "evidence": "oracle evidence conform",
}
_QUICK = 0.25
"""No test that waits for real time is quicker than this [s]."""
EQUIVALENT = {
    "commands.py swap move_duration(rest, command.servo, hand) → move_duration(command.servo, rest, hand)": "as long back",
    "commands.py swap move_duration(rest, target, hand) → move_duration(target, rest, hand)": "as long back",
    "errors.py shift 3 → 6 in warnings.warn(warning, stacklevel=3)": "the line that a warning is blamed on",
    "evidence/codec.py delete self._rest = self._rest[-300:]": "bounds the memory alone",
    "evidence/oracle.py delete return None": "the end of a function, or a test goes red",
}
"""What a mutant does, without its line number, and why nothing that a user can see differs."""
FLIPPED = {
    ast.Lt: ast.GtE,
    ast.GtE: ast.Lt,
    ast.Gt: ast.LtE,
    ast.LtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}


def sites(tree: ast.Module) -> Iterator[tuple[str, int]]:
    """Every mutation of a module, as its kind and the number of its node in a walk of the tree."""
    words = [node for node in ast.walk(tree) if isinstance(node, ast.keyword)]
    without_effect = {id(word.value) for word in words if word.arg in ("strict", "slots")}
    for number, node in enumerate(ast.walk(tree)):
        call = isinstance(node, ast.Expr) and not isinstance(
            node.value, ast.Constant | ast.Yield | ast.YieldFrom
        )
        result = isinstance(node, ast.Return) and node.value is not None
        if call or result or isinstance(node, ast.Assign | ast.AugAssign | ast.Raise):
            yield "delete", number
        elif isinstance(node, ast.Compare) and type(node.ops[0]) in FLIPPED:
            yield "flip", number
        elif (
            isinstance(node, ast.Constant)
            and type(node.value) in (int, float, bool)
            and id(node) not in without_effect
        ):
            yield "shift", number
        elif (
            isinstance(node, ast.Call)
            and len(node.args) >= 2
            and not any(isinstance(a, ast.Starred) for a in node.args[:2])
        ):
            if getattr(node.func, "id", "") not in ("min", "max"):
                yield "swap", number


def mutate(text: str, kind: str, number: int) -> tuple[str, str]:
    """The mutated text, and one line that says what was done."""
    tree = ast.parse(text)
    node = list(ast.walk(tree))[number]
    was = ast.unparse(node).split("\n")[0][:90]
    if kind == "delete":
        for parent in ast.walk(tree):
            for name in ("body", "orelse", "finalbody"):
                block = getattr(parent, name, None)
                if isinstance(block, list) and node in block:
                    block[block.index(node)] = ast.copy_location(ast.Pass(), node)
    elif kind == "flip":
        node.ops[0] = FLIPPED[type(node.ops[0])]()
    elif kind == "shift":
        node.value = (
            not node.value
            if isinstance(node.value, bool)
            else node.value + 1
            if node.value < 1
            else node.value * 2
        )
    else:
        node.args[0], node.args[1] = node.args[1], node.args[0]
    now = "" if kind == "delete" else ast.unparse(node).split("\n")[0][:90]
    now += f" in {text.splitlines()[node.lineno - 1].strip()}" if kind == "shift" else ""
    return ast.unparse(ast.fix_missing_locations(tree)), f"line {node.lineno}: {kind} {was}" + (
        f" → {now}" if now else ""
    )


class Watch:
    """Pytest plugin of a child process: runs the tests in the order of `rank` and tells which one
    begins.

    Args:
        tell: called as `tell(test, called)` at the beginning of each test; `called` has the
            functions of the bridge that have been called since, as (file, first line, last line),
            if `trace` is set.
        rank: sort key of a test's name.
        patience: longest time of a test by its name [s]; if it takes longer, the process ends.
    """

    def __init__(
        self, tell: Callable, rank: Callable, patience: Callable[[str], float], trace: bool
    ) -> None:
        self._tell = tell
        self._rank = rank
        self._patience = patience
        self._trace = trace
        self._called: set[CodeType] = set()

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items.sort(key=lambda item: self._rank(item.nodeid))

    def pytest_runtest_setup(self, item: pytest.Item) -> None:
        self.tell(item.nodeid)
        faulthandler.dump_traceback_later(self._patience(item.nodeid), exit=True)
        if self._trace:
            sys.settrace(lambda frame, _event, _argument: self._called.add(frame.f_code))

    def tell(self, test: str) -> None:
        """Tell that a test begins, or by an empty name that all have passed."""
        sys.settrace(None)
        ours = [
            code for code in self._called if any(str(place) in code.co_filename for place in PLACES)
        ]
        self._tell(
            (
                test,
                [(Path(code.co_filename), code.co_firstlineno, max(_lines(code))) for code in ours],
            )
        )
        self._called.clear()


def _lines(code: CodeType) -> list[int]:
    return [line for *_, line in code.co_lines() if line]


class Judge:
    """Runs the tests on a copy of the project, each time in a fork of this process, which has
    imported all but the bridge.
    """

    def __init__(self, folder: Path, files: list[str]) -> None:
        self.folder = folder
        self._seconds: dict[str, float] = {}
        self._called: dict[str, list[tuple[Path, int, int]]] = {}
        for part in ("hpac_gym", "agents", "tools", "tests", "docs"):
            shutil.copytree(
                ROOT / part, folder / part, ignore=shutil.ignore_patterns("__pycache__", "images")
            )
        (folder / "assets").symlink_to(ROOT / "assets")
        shutil.copytree(
            ROOT / "firmware", folder / "firmware", ignore=shutil.ignore_patterns("build")
        )
        shutil.copy(ROOT / "pyproject.toml", folder)
        os.environ |= {
            "PYTHONPATH": str(folder),
            "HPAC_FIRMWARE_BUILD": str(ROOT / "firmware" / "build"),
        }
        os.chdir(folder)
        sys.path[0] = str(folder)
        for name in ("hypothesis", "serial", "hpac_gym.model"):
            import_module(name)
        if found := self._failure(*files):
            sys.exit(f"{found} fails without any fault")
        os.environ["PYTHONDONTWRITEBYTECODE"] = (
            "1"  # what is compiled of one text must not stand for the next
        )
        sys.dont_write_bytecode = True

    def _failure(self, *words: str) -> str:
        """The test that fails, hangs or crashes; empty if none does. The quicker run first."""
        known = dict(self._seconds)
        ours, theirs = Pipe(duplex=False)
        watch = Watch(
            theirs.send,
            lambda test: known.get(test, 0),
            lambda test: 60 + 10 * known.get(test, 60),
            trace=not known,
        )
        child = get_context("fork").Process(target=_run_tests, args=(watch, words))
        child.start()
        theirs.close()
        test = "collection"
        begins = time.monotonic()
        with suppress(EOFError):
            while test:
                after, called = ours.recv()
                if not known and "::" in test:
                    self._seconds[test] = time.monotonic() - begins
                    self._called[test] = called
                test = after
                begins = time.monotonic()
        child.join()
        return test

    def notices(self, module: Path, line: int, was: str, becomes: str) -> str:
        """Which test notices that a module `becomes` something else than it `was`, at a line; empty
        if none does.

        Only the tests that call the function of that line run, and those whose calls are not known:
        in processes, or traced. All of them run if the line is outside of functions. A test that
        waits for real time counts if it fails twice with the fault and passes without it: on a busy
        machine one may fail by itself."""
        calls = {
            test: any(path == module and first <= line <= last for path, first, last in called)
            for test, called in self._called.items()
        }
        near = {
            test
            for test, hit in calls.items()
            if hit or not any(calls.values()) or not self._called[test]
        }
        try:
            while True:
                module.write_text(becomes)
                test = self._failure(*sorted(near)) if near else ""
                if (
                    "::" not in test or self._seconds[test] < _QUICK
                ):  # the first: none, or they could not even be collected
                    return test
                again = self._failure(test)
                module.write_text(was)
                if again and not self._failure(test):
                    return test
                near.discard(test)
        finally:
            module.write_text(was)


def _run_tests(watch: Watch, words: tuple[str, ...]) -> None:
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    os.dup2(1, 2)
    # A loop without end must not take all of the memory.
    resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))
    faulthandler.dump_traceback_later(60, exit=True)
    options = ["-x", *(f"-pno:{name}" for name in ("cacheprovider", "faulthandler", "xdist"))]
    if pytest.main([*options, *words], plugins=[watch]) == 0:
        watch.tell("")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=200, help="mutants (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of the draw (default: %(default)s)")
    parser.add_argument("--part", choices=TESTS, default="conversation", help="which modules")
    options = parser.parse_args()
    paths = sorted(path for place in PLACES for path in (ROOT / place).rglob("*.py"))
    paths = [path for path in paths if path.name not in LEFT_OUT]
    paths = [path for path in paths if ("evidence" in path.parts) == (options.part == "evidence")]
    texts = {path: path.read_text() for path in paths}
    everything = [(path, *site) for path, text in texts.items() for site in sites(ast.parse(text))]
    drawn = random.Random(options.seed).sample(everything, min(options.count, len(everything)))
    files = [f"tests/bridge/test_{name}.py" for name in TESTS[options.part].split()]
    killed = 0
    equivalent = 0
    survivors = []
    with tempfile.TemporaryDirectory(prefix="hpac_mutants_") as name:
        judge = Judge(Path(name), files)
        for path, kind, number in drawn:
            mutated, what = mutate(texts[path], kind, number)
            bridge = ROOT / PLACES[0]
            where = (
                f"{path.relative_to(bridge if bridge in path.parents else ROOT / 'tools')} {what}"
            )
            if re.sub(r"line \d+: ", "", where) in EQUIVALENT:
                equivalent += 1
                continue
            line = int(re.search(r"line (\d+)", what)[1])
            how = judge.notices(judge.folder / path.relative_to(ROOT), line, texts[path], mutated)
            print(f"{'killed  ' if how else 'SURVIVED'} {where}  [{how}]", flush=True)
            killed += bool(how)
            survivors += [] if how else [where]
    for where in survivors:
        print(f"survived: {where}")
    tried = killed + len(survivors)
    low, high = binomtest(killed, tried).proportion_ci(method="wilson")
    print(
        f"{killed} of {tried} mutants noticed, {equivalent} change nothing, {len(everything)} there are: "
        f"{killed / tried:.1%} [{low:.1%}, {high:.1%}]"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
