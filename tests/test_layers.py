"""The layer table of docs/architecture.md, read from the imports of every module."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "hpac_gym"
MODULES = sorted(PACKAGE.rglob("*.py"))

# What a layer may import of this package, and from outside of it beside the standard library. The package's own
# __init__.py, cli.py and its benchmark of speed stand above all of them.
LAYERS = {
    "errors": set(),
    "progress": set(),
    "output": {"errors"},
    "command_line": {"errors"},
    "model": {"errors"},
    "sim": {"errors", "model"},
    "envs": {"errors", "model", "sim"},
    "bridge": {"errors", "command_line", "model"},
    "policies": {"errors", "output", "envs"},
    "evaluation": {"errors", "output", "progress", "command_line", "model", "sim", "envs", "policies"},
    "study": {"errors", "output", "progress", "model", "sim", "envs"},
}
NEEDS = {
    "errors": set(),
    "progress": set(),
    "output": set(),
    "command_line": set(),
    "model": {"numpy"},
    "sim": {"numpy", "pybullet", "pybullet_data", "pybullet_utils"},
    "envs": {"numpy", "gymnasium"},
    "bridge": {"numpy", "serial"},
    "policies": {"numpy", "gymnasium"},
    "evaluation": {"numpy", "gymnasium", "PIL"},
    "study": {"numpy", "scipy", "matplotlib", "gymnasium"},
}


def module_name(path: Path) -> str:
    """The dotted name under which ``path`` is imported."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports_of(path: Path) -> Iterator[str]:
    """The dotted names that a module imports, relative ones resolved and submodules spelled out."""
    package = module_name(path).split(".")
    package = package if path.name == "__init__.py" else package[:-1]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parts = package[: len(package) - node.level + 1] if node.level else []
            parts += node.module.split(".") if node.module else []
            yield from (".".join([*parts, alias.name]) for alias in node.names)
        elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            if getattr(node.func, "attr", getattr(node.func, "id", "")) in {"import_module", "__import__"}:
                yield str(node.args[0].value)


def layer_of(name: str) -> str | None:
    """The layer of a dotted name of this package; None for its root and its commands."""
    parts = name.split(".")
    return parts[1] if len(parts) > 1 and parts[1] in LAYERS else None


IN_LAYERS = [path for path in MODULES if layer_of(module_name(path))]


@pytest.mark.parametrize("path", IN_LAYERS, ids=module_name)
def test_a_module_imports_only_layers_below_its_own(path):
    layer = layer_of(module_name(path))
    own = [name for name in imports_of(path) if name.split(".")[0] in {"hpac_gym", "agents", "tests"}]
    upward = [name for name in own if layer_of(name) not in LAYERS[layer] | {layer}]
    assert not upward, f"{module_name(path)} is in '{layer}' and imports {upward}"


@pytest.mark.parametrize("path", IN_LAYERS, ids=module_name)
def test_a_module_needs_only_what_its_layer_may(path):
    layer = layer_of(module_name(path))
    outside = {name.split(".")[0] for name in imports_of(path)} - {"hpac_gym"} - sys.stdlib_module_names
    assert outside <= NEEDS[layer], f"{module_name(path)} is in '{layer}' and imports {sorted(outside - NEEDS[layer])}"


def test_only_the_simulation_names_pybullet():
    modules = [*MODULES, *(ROOT / "agents").rglob("*.py")]
    named = {module_name(path) for path in modules if any("pybullet" in name for name in imports_of(path))}
    assert {layer_of(name) for name in named} <= {"sim"}, named


def test_the_package_does_not_know_the_agents():
    assert not [path for path in MODULES for name in imports_of(path) if name.split(".")[0] == "agents"]


@pytest.mark.parametrize("layer", ["model", "bridge"])
def test_model_and_bridge_import_without_pybullet(layer):
    names = [module_name(path) for path in IN_LAYERS if layer_of(module_name(path)) == layer]
    assert names, f"hpac_gym.{layer} has no modules"
    script = f"""
import importlib, sys

class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0].startswith("pybullet"):
            raise ImportError(f"{{name}} is refused")

sys.meta_path.insert(0, Refuse())
for name in {[name for name in names if not name.endswith("__main__")]!r}:
    importlib.import_module(name)
"""
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
