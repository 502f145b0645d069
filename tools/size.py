"""The size of the house: files, statements and lines after formatting, by part and by folder.

``python -m tools.size`` prints them, the largest files and classes, and what capabilities of the
wheel cost. Statements count, not lines: width hides growth.
"""

import ast
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

from hpac_gym.output import markdown

ROOT = Path(__file__).parents[1]
PARTS = {
    "wheel": ("hpac_gym", "hpac.py"),
    "workshop": ("agents", "examples", "experiments", "firmware", "integrations", "tools"),
    "tests": ("tests",),
}
LARGEST = 5
PRICES = {
    "calibration of a hand from a sweep": ("calibration",),
    "deployment on a hand, and its replay": ("deploy",),
    "virtual hand, sliders in the browser": ("virtual", "view"),
    "conformance of a device to the wire": ("bridge/evidence",),
    "camera and printed tags": ("camera",),
    "a second engine": ("physics/pybullet",),
    "grasp types": tuple(
        f"tasks/{name}.py" for name in ("grasp_types", "grasp_rules", "grasp_holds")
    ),
    "objects of one's own": (
        "body/own_objects.py",
        "body/own_meshes.py",
        "physics/mujoco/resting.py",
    ),
    "data sets, ONNX, Stable-Baselines3": (
        *("evaluation/dataset.py", "evaluation/lerobot.py"),
        *("policies/export.py", "policies/onnx_model.py"),
        *("policies/sb3.py", "envs/sb3.py"),
    ),
    "the benchmark's protocol": tuple(
        f"evaluation/{name}.py" for name in ("benchmark", "results", "splits")
    ),
}
"""Parts of `hpac_gym` that would have to go with a capability, alone; what refers to them would
shrink a little too.
"""


def statements(tree: ast.AST) -> int:
    """Number of statements, nested ones included; docstrings are statements."""
    return sum(isinstance(node, ast.stmt) for node in ast.walk(tree))


def files_of(names: Iterable[str]) -> list[Path]:
    """The Python files below some names of the root."""
    paths = [ROOT / name for name in names]
    return sorted(
        file for path in paths for file in ([path] if path.suffix else path.rglob("*.py"))
    )


def price(names: Iterable[str]) -> int:
    """Statements of some parts of `hpac_gym`."""
    files = files_of(f"hpac_gym/{name}" for name in names)
    return sum(statements(ast.parse(path.read_text(encoding="utf-8"))) for path in files)


def main() -> None:
    rows = []
    lengths = {}
    classes = {}
    for part, names in PARTS.items():
        totals = defaultdict(lambda: [0, 0, 0])
        for path in files_of(names):
            text = path.read_text(encoding="utf-8")
            tree = ast.parse(text)
            name = path.relative_to(ROOT)
            folder = str(Path(*name.parts[:2]) if len(name.parts) > 2 else name.parts[0])
            counts = (1, statements(tree), len(text.splitlines()))
            for total in (totals[part], totals[f"    {folder}"]):
                total[:] = map(sum, zip(total, counts, strict=True))
            if part != "tests":
                lengths[str(name)] = counts[2]
            for node in ast.walk(tree):
                if isinstance(node, ast.ClassDef) and part != "tests":
                    classes[f"{name}: {node.name}"] = node.end_lineno - node.lineno + 1
        rows += [(name, *map(str, total)) for name, total in totals.items()]
    print(markdown(("part", "files", "statements", "lines"), rows))
    for title, sizes in (("file", lengths), ("class", classes)):
        largest = sorted(sizes.items(), key=lambda item: -item[1])[:LARGEST]
        print(f"\nLargest {title}: {', '.join(f'{name} {lines}' for name, lines in largest)}")
    prices = [(name, price(parts)) for name, parts in PRICES.items()]
    print(f"\n{markdown(('to go with', 'statements'), prices)}")


if __name__ == "__main__":
    main()
