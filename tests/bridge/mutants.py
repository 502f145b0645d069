"""Generated faults in `hpac_gym/bridge`, each of which the bridge's tests must notice.

    python tests/bridge/mutants.py --count 200 --seed 1

A mutant deletes a statement, flips a comparison, shifts a constant or swaps two arguments; they are drawn at random from all
that there are. Prints the share that a test noticed with its 95 % Wilson interval, and every survivor. `--record FILE` lets a run
that was cut short go on: what was noticed is not tried again while its module stays as it is, a survivor is. Survivors that were
looked at and change nothing stand in `EQUIVALENT`, with the reason, and are left out of the share.
"""

from __future__ import annotations

import argparse
import ast
import faulthandler
import hashlib
import os
import random
import re
import shutil
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from importlib import import_module
from math import sqrt
from multiprocessing import Pipe, get_context
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
BRIDGE = Path("hpac_gym/bridge")
LEFT_OUT = {"__init__.py", "generate.py", "protocol.py"}
"""Nothing to break, or compared with the generated files."""
TESTS = {
    "conversation": "frame reports patience link exits commands vectors protocol bad_devices host_board evidence",
    "evidence": "evidence exits commands",
}
EQUIVALENT = {
    "commands.py swap move_duration(rest, command.servo, hand) → move_duration(command.servo, rest, hand)": "as long back",
    "commands.py swap move_duration(rest, target, hand) → move_duration(target, rest, hand)": "as long back",
    "errors.py shift 3 → 6": "the line that a warning is blamed on",
}
"""What a mutant does, without its line number, and why nothing that a user can see differs."""
FLIPPED = {
    ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip


def sites(tree: ast.Module) -> Iterator[tuple[str, int]]:
    """Every mutation of a module, as its kind and the number of its node in a walk of the tree."""
    for number, node in enumerate(ast.walk(tree)):
        call = isinstance(node, ast.Expr) and not isinstance(node.value, ast.Constant | ast.Yield | ast.YieldFrom)
        result = isinstance(node, ast.Return) and node.value is not None
        if call or result or isinstance(node, ast.Assign | ast.AugAssign | ast.Raise):
            yield "delete", number
        elif isinstance(node, ast.Compare) and type(node.ops[0]) in FLIPPED:
            yield "flip", number
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float, bool):
            yield "shift", number
        elif isinstance(node, ast.Call) and len(node.args) >= 2 and not any(isinstance(a, ast.Starred) for a in node.args[:2]):
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
        node.value = not node.value if isinstance(node.value, bool) else node.value + 1 if node.value < 1 else node.value * 2
    else:
        node.args[0], node.args[1] = node.args[1], node.args[0]
    now = "" if kind == "delete" else ast.unparse(node).split("\n")[0][:90]
    return ast.unparse(ast.fix_missing_locations(tree)), f"line {node.lineno}: {kind} {was}" + (f" → {now}" if now else "")


class Watch:
    """Pytest plugin of a child process: runs the tests in a given order and tells which one begins.

    Args:
        begins: called with the name of each test; with an empty one once all have passed.
        rank: sort key of a test's name.
        patience: longest time of a test by its name [s]; if it takes longer, the process ends.
    """

    def __init__(self, begins: Callable[[str], None], rank: Callable, patience: Callable[[str], float]) -> None:
        self.begins, self._rank, self._patience = begins, rank, patience

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items.sort(key=lambda item: self._rank(item.nodeid))

    def pytest_runtest_setup(self, item: pytest.Item) -> None:
        self.begins(item.nodeid)
        faulthandler.dump_traceback_later(self._patience(item.nodeid), exit=True)


class Judge:
    """Runs the tests on a copy of the project, each time in a fork of this process, which has imported all but the bridge."""

    def __init__(self, folder: Path, files: list[str]) -> None:
        self.folder, self._files = folder, files
        self._seconds: dict[str, float] = {}
        self._noticed: dict[Path, set[str]] = defaultdict(set)
        for part in ("hpac_gym", "tests", "docs"):
            shutil.copytree(ROOT / part, folder / part, ignore=shutil.ignore_patterns("__pycache__", "images"))
        (folder / "assets").symlink_to(ROOT / "assets")
        shutil.copytree(ROOT / "firmware", folder / "firmware", ignore=shutil.ignore_patterns("build"))
        shutil.copy(ROOT / "pyproject.toml", folder)
        os.environ |= {"PYTHONPATH": str(folder), "HPAC_FIRMWARE_BUILD": str(ROOT / "firmware" / "build")}
        os.chdir(folder)
        sys.path[0] = str(folder)
        for name in ("hypothesis", "serial", "hpac_gym.model"):
            import_module(name)
        if found := self._failure(*files):
            sys.exit(f"{found} fails without any fault")
        os.environ["PYTHONDONTWRITEBYTECODE"] = "1"  # what is compiled of one text must not stand for the next
        sys.dont_write_bytecode = True

    def _failure(self, *words: str, first: Collection[str] = ()) -> str:
        """The test that fails, hangs or crashes; empty if none does. The quicker ones run first, and before them `first`."""
        ours, theirs = Pipe(duplex=False)
        begins = time.monotonic()
        child = get_context("fork").Process(target=self._run, args=(theirs, words, first))
        child.start()
        theirs.close()
        test = "collection"
        with suppress(EOFError):
            while after := ours.recv():
                if test not in self._seconds:
                    self._seconds[test] = time.monotonic() - begins
                test, begins = after, time.monotonic()
            test = ""
        child.join()
        return test

    def _run(self, told: Connection, words: tuple[str, ...], first: Collection[str]) -> None:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.dup2(1, 2)
        seconds = self._seconds
        rank, patience = lambda test: (test not in first, seconds.get(test, 0)), lambda test: 60 + 10 * seconds.get(test, 60)
        options = ["-x", "-k", "not every_safety_claim", *(f"-pno:{name}" for name in ("cacheprovider", "faulthandler", "xdist"))]
        if pytest.main([*options, *words], plugins=[Watch(told.send, rank, patience)]) == 0:
            told.send("")

    def notices(self, module: Path, was: str, becomes: str) -> str:
        """Which test notices that a module `becomes` something else than it `was`; empty if none does.

        A test counts if it fails twice with the fault and passes without it: on a busy machine one may fail by itself.
        """
        left_out: list[str] = []
        try:
            while True:
                module.write_text(becomes)
                test = self._failure(*self._files, *left_out, first=self._noticed[module])
                if "::" not in test:  # nothing, or the tests could not even be collected
                    return test
                again = self._failure(test)
                module.write_text(was)
                if again and not self._failure(test):
                    self._noticed[module].add(test)
                    return test
                left_out += ["--deselect", test]
        finally:
            module.write_text(was)


def interval(hits: int, count: int, z: float = 1.96) -> tuple[float, float]:
    """Wilson's 95 % interval of a share."""
    share, square = hits / count, z * z / count
    middle, half = share + square / 2, z * sqrt(share * (1 - share) / count + square / (4 * count))
    return (middle - half) / (1 + square), (middle + half) / (1 + square)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=200, help="mutants (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of the draw (default: %(default)s)")
    parser.add_argument("--minutes", type=float, default=1e9, help="stop after so long, with what has been tried until then")
    parser.add_argument("--part", choices=TESTS, default="conversation", help="which modules")
    parser.add_argument("--record", type=Path, help="file of what was noticed before; grows")
    options = parser.parse_args()
    before = options.record.read_text().split() if options.record and options.record.exists() else []
    paths = [path for path in sorted((ROOT / BRIDGE).rglob("*.py")) if path.name not in LEFT_OUT]
    paths = [path for path in paths if ("evidence" in path.parts) == (options.part == "evidence")]
    texts = {path: path.read_text() for path in paths}
    everything = [(path, *site) for path, text in texts.items() for site in sites(ast.parse(text))]
    drawn = random.Random(options.seed).sample(everything, min(options.count, len(everything)))
    files = [f"tests/bridge/test_{name}.py" for name in TESTS[options.part].split()]
    killed, equivalent, survivors, start = 0, 0, [], time.monotonic()
    with tempfile.TemporaryDirectory(prefix="hpac_mutants_") as name:
        judge = Judge(Path(name), files)
        for path, kind, number in drawn:
            if time.monotonic() - start > 60 * options.minutes:
                break
            mutated, what = mutate(texts[path], kind, number)
            where = f"{path.relative_to(ROOT / BRIDGE)} {what}"
            if re.sub(r"line \d+: ", "", where) in EQUIVALENT:
                equivalent += 1
                continue
            key = hashlib.sha256((path.name + mutated).encode()).hexdigest()[:20]
            how = "before" if key in before else ""
            if not how:
                how = judge.notices(judge.folder / path.relative_to(ROOT), texts[path], mutated)
                print(f"{'killed  ' if how else 'SURVIVED'} {where}  [{how}]", flush=True)
                if how and options.record:
                    with options.record.open("a") as record:
                        record.write(key + "\n")
            killed += bool(how)
            survivors += [] if how else [where]
    for where in survivors:
        print(f"survived: {where}")
    tried = killed + len(survivors)
    low, high = interval(killed, tried)
    print(
        f"{killed} of {tried} mutants noticed, {equivalent} change nothing, {len(everything)} there are: "
        f"{killed / tried:.1%} [{low:.1%}, {high:.1%}]"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
