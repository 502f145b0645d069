"""Generated faults in `hpac_gym/bridge` and `tools/evidence`, each of which the bridge's tests must notice.

    python tests/bridge/mutants.py --count 200 --seed 1

A mutant deletes a statement, flips a comparison, shifts a constant or swaps two arguments; they are
drawn at random from all that there are. Prints the share that a test noticed with its 95 % Wilson
interval, and every survivor. Survivors that were looked at and change nothing stand in
`EQUIVALENT`, with the reason, and are left out of the share."""

import argparse
import ast
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from scipy.stats import binomtest

ROOT = Path(__file__).parents[2]
PLACES = (Path("hpac_gym/bridge"), Path("tools/evidence"))
LEFT_OUT = {"__init__.py", "codes.py", "programs.py", "user_programs.py"}
"""Nothing to break, compared with the generated files, or run by slow tests."""
TESTS = {
    "conversation": "protocol reports patience link exits commands host_board evidence conform",
    "evidence": "oracle evidence conform",
}
EQUIVALENT = {
    "commands.py swap move_duration(pose, command.servo, hand) → move_duration(command.servo, pose, hand)": "as long back",
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


class Judge:
    """Runs tests on a copy of the project, quick files first, each time in a process of its own.

    Args:
        folder: where the copy is made.
        files: names of the files of tests.
    """

    def __init__(self, folder: Path, files: list[str]) -> None:
        self.folder = folder
        self._files = files
        left_out = shutil.ignore_patterns("__pycache__", "images", "build")
        for part in ("hpac_gym", "agents", "tools", "tests", "docs", "assets", "firmware"):
            shutil.copytree(ROOT / part, folder / part, ignore=left_out)
        shutil.copy(ROOT / "pyproject.toml", folder)
        begun = time.monotonic()
        # Longest time of all tests, beyond which one hangs [s].
        self._patience = 3600.0
        if found := self._failure(*files):
            sys.exit(f"{found} fails without any fault")
        self._patience = 60 + 3 * (time.monotonic() - begun)

    def _failure(self, *tests: str) -> str:
        """The first test that fails, hangs or crashes; empty if none does."""
        command = [sys.executable, "-m", "pytest", "-xrfE", "-pno:cacheprovider", "-pno:xdist"]
        # A loop without end must not take all of the memory.
        limited = ["sh", "-c", 'ulimit -v 8388608; exec "$0" "$@"', *command, *tests]
        variables = {
            "PYTHONPATH": str(self.folder),
            "HPAC_FIRMWARE_BUILD": str(ROOT / "firmware" / "build"),
            # What is compiled of one text must not stand for the next.
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        try:
            done = subprocess.run(
                limited,
                cwd=self.folder,
                env=os.environ | variables,
                capture_output=True,
                text=True,
                timeout=self._patience,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return "hangs"
        named = re.findall(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", done.stdout, re.M)
        return "" if done.returncode == 0 else (*named, "crashes")[0]

    def notices(self, module: Path, becomes: str) -> str:
        """Which test notices that a module `becomes` something else; empty if none does. A test
        counts if it fails twice: on a busy machine one that waits for real time may fail by itself.
        """
        was = module.read_text()
        module.write_text(becomes)
        try:
            test = self._failure(*self._files)
            if "::" in test and not self._failure(test):
                test = self._failure(*self._files)
            return test
        finally:
            module.write_text(was)


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
            how = judge.notices(judge.folder / path.relative_to(ROOT), mutated)
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
