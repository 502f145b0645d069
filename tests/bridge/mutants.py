"""Generated faults in `hpac_gym/bridge`, each of which the bridge's tests must notice.

    python tests/bridge/mutants.py --count 200 --seed 1

A mutant deletes a statement, flips a comparison, shifts a constant or swaps two arguments; they are drawn at random from all
that there are. Prints the share that a test noticed with its 95 % Wilson interval, and every survivor.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from math import sqrt
from pathlib import Path

ROOT = Path(__file__).parents[2]
BRIDGE = Path("hpac_gym/bridge")
LEFT_OUT = {"__init__.py", "generate.py", "protocol.py"}
"""Nothing to break, or compared with the generated files."""
TESTS = ["frame", "link", "exits", "commands", "vectors", "protocol", "bad_devices", "host_board"]
TIMEOUT = 240.0
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


def noticed(folder: Path, evidence: bool) -> str:
    """How the tests noticed the fault in this copy; empty if they did not."""
    names = ["evidence", "exits", "commands"] if evidence else [*TESTS, "evidence"]
    files = [f"tests/bridge/test_{name}.py" for name in names]
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-k", "not every_safety_claim", *files]
    environment = os.environ | {"PYTHONPATH": str(folder), "HPAC_FIRMWARE_BUILD": str(ROOT / "firmware" / "build")}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    with subprocess.Popen(command, cwd=folder, env=environment, start_new_session=True, **pipes) as process:
        try:
            said, _ = process.communicate(timeout=TIMEOUT)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, 9)
            return "timeout"
    if process.returncode == 0:
        return ""
    return next((line for line in said.splitlines() if line.startswith(("FAILED", "ERROR"))), "crash")[:100]


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
    parser.add_argument("--part", choices=("conversation", "evidence"), default="conversation", help="which modules")
    options = parser.parse_args()
    paths = [path for path in sorted((ROOT / BRIDGE).rglob("*.py")) if path.name not in LEFT_OUT]
    paths = [path for path in paths if ("evidence" in path.parts) == (options.part == "evidence")]
    texts = {path: path.read_text() for path in paths}
    everything = [(path, *site) for path, text in texts.items() for site in sites(ast.parse(text))]
    drawn = random.Random(options.seed).sample(everything, min(options.count, len(everything)))
    killed, survivors, start = 0, [], time.monotonic()
    with tempfile.TemporaryDirectory(prefix="hpac_mutants_") as name:
        folder = Path(name)
        for part in ("hpac_gym", "tests", "docs"):
            shutil.copytree(ROOT / part, folder / part, ignore=shutil.ignore_patterns("__pycache__", "images"))
        (folder / "assets").symlink_to(ROOT / "assets")
        shutil.copytree(ROOT / "firmware", folder / "firmware", ignore=shutil.ignore_patterns("build"))
        shutil.copy(ROOT / "pyproject.toml", folder)
        for path, kind, number in drawn:
            if time.monotonic() - start > 60 * options.minutes:
                break
            mutated, what = mutate(texts[path], kind, number)
            copy = folder / path.relative_to(ROOT)
            copy.write_text(mutated)
            how = noticed(folder, "evidence" in path.parts)
            copy.write_text(texts[path])
            where = f"{path.relative_to(ROOT / BRIDGE)} {what}"
            killed += bool(how)
            survivors += [] if how else [where]
            print(f"{'killed  ' if how else 'SURVIVED'} {where}  [{how}]", flush=True)
    tried = killed + len(survivors)
    low, high = interval(killed, tried)
    print(f"{killed} of {tried} mutants noticed, {len(everything)} there are: {killed / tried:.1%} [{low:.1%}, {high:.1%}]")
    return 0


if __name__ == "__main__":
    sys.exit(main())
