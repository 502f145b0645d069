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
import hashlib
import os
import random
import re
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
TESTS = ["frame", "reports", "patience", "link", "exits", "commands", "vectors", "protocol", "bad_devices", "host_board"]
TIMEOUT = 900.0
PATIENCE = 150
"""Processor time after which a run hangs; all tests take a third of it [s]."""
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


def noticed(folder: Path, module: Path, was: str, becomes: str) -> str:
    """Which test notices that a module of this copy `becomes` something else than it `was`; empty if none does.

    A test counts if it fails twice with the fault and passes without it: on a busy machine one may fail by itself.
    """
    evidence = "evidence" in module.parts
    names = ["evidence", "exits", "commands"] if evidence else [*TESTS, "evidence"]
    files = [f"tests/bridge/test_{name}.py" for name in names]
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-k", "not every_safety_claim"]
    environment = os.environ | {"PYTHONPATH": str(folder), "HPAC_FIRMWARE_BUILD": str(ROOT / "firmware" / "build")}
    environment["PYTHONDONTWRITEBYTECODE"] = "1"  # what is compiled of one text must not stand for the next
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}

    def failure(*words: str) -> str:
        limited = ["sh", "-c", f'ulimit -t {PATIENCE}; exec "$0" "$@"', *command, *words]
        with subprocess.Popen(limited, cwd=folder, env=environment, start_new_session=True, **pipes) as process:
            try:
                said, _ = process.communicate(timeout=TIMEOUT)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, 9)
                return "timeout"
        if process.returncode == 0:
            return ""
        return next((line for line in said.splitlines() if line.startswith(("FAILED", "ERROR"))), "crash")

    left_out: list[str] = []
    try:
        while True:
            module.write_text(becomes)
            found = failure(*files, *left_out)
            test = found.split(" - ")[0].split()[-1] if found else ""
            if "::" not in test:  # nothing, or the tests could not even be collected
                return found[:100]
            again = failure(test)
            module.write_text(was)
            if again and not failure(test):
                return found[:100]
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
    parser.add_argument("--part", choices=("conversation", "evidence"), default="conversation", help="which modules")
    parser.add_argument("--record", type=Path, help="file of what was noticed before; grows")
    options = parser.parse_args()
    before = options.record.read_text().split() if options.record and options.record.exists() else []
    paths = [path for path in sorted((ROOT / BRIDGE).rglob("*.py")) if path.name not in LEFT_OUT]
    paths = [path for path in paths if ("evidence" in path.parts) == (options.part == "evidence")]
    texts = {path: path.read_text() for path in paths}
    everything = [(path, *site) for path, text in texts.items() for site in sites(ast.parse(text))]
    drawn = random.Random(options.seed).sample(everything, min(options.count, len(everything)))
    killed, equivalent, survivors, start = 0, 0, [], time.monotonic()
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
            where = f"{path.relative_to(ROOT / BRIDGE)} {what}"
            if re.sub(r"line \d+: ", "", where) in EQUIVALENT:
                equivalent += 1
                continue
            key = hashlib.sha256((path.name + mutated).encode()).hexdigest()[:20]
            how = "before" if key in before else ""
            if not how:
                how = noticed(folder, folder / path.relative_to(ROOT), texts[path], mutated)
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
