"""The rule of style that ruff does not have: unrelated things are not assigned in one statement.

`a, b = x, y` is for a swap, in which the right side reads what the left side writes.
"""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path


def parallel_assignments(source: str) -> Iterator[int]:
    """Lines that assign a literal tuple to a tuple of targets of which the values read none."""
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Assign) or not isinstance(node.value, ast.Tuple):
            continue
        if not all(isinstance(target, ast.Tuple) for target in node.targets):
            continue
        if any(isinstance(value, ast.Starred) for value in node.value.elts):
            continue
        written = {ast.unparse(element) for target in node.targets for element in target.elts}
        read = {
            ast.unparse(part)
            for part in ast.walk(node.value)
            if isinstance(part, ast.Name | ast.Attribute | ast.Subscript)
        }
        if not written & read:
            yield node.lineno


def main(paths: list[str]) -> int:
    """Print the place of every violation in these files; returns 1 if there is one."""
    faults = [
        f"{path}:{line}: unrelated things are assigned in one statement"
        for path in paths
        for line in parallel_assignments(Path(path).read_text(encoding="utf-8"))
    ]
    print(*faults, sep="\n", end="\n" if faults else "")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
