"""The layers of docs/architecture.md hold in the code: imports are read from the syntax trees."""

from __future__ import annotations

import ast
import re
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "vppres"
ENTRY_POINTS = {"", "__main__"}  # above all layers: the package itself and `python -m vppres`
OWNERS = {"cvxpy": {"model", "solve"}, "pandapower": {"powerflow", "networks"}}


def module_name(path: Path) -> str:
    """Dotted name below the package: ``model.data``; a package counts as itself: ``model``."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


TREES = {module_name(path): ast.parse(path.read_text(encoding="utf-8"))
         for path in sorted(PACKAGE.rglob("*.py"))}


def layers() -> dict[str, int]:
    """Position of each module in the table of docs/architecture.md, counted from the top."""
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| [a-z ]+ \| ([^|]+) \|", text, flags=re.MULTILINE)
    listed = [re.findall(r"`([\w.]+)`", row) for row in rows]
    tables = [modules for modules in listed if modules]
    return {module: level for level, modules in enumerate(tables) for module in modules}


def level_of(module: str) -> int:
    """Level of a module; what the table does not name stands with the lowest of its package."""
    table = layers()
    package = module if (PACKAGE / module).is_dir() else module.rpartition(".")[0]
    inside = [level for name, level in table.items() if package and name.startswith(f"{package}.")]
    return table[module] if module in table else max(inside)


def imports(module: str, tree: ast.AST) -> set[str]:
    """Absolute names of everything a module imports, inside functions too."""
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}: write imports with the package's name"
            found.update(f"{node.module}.{alias.name}" for alias in node.names)
    return found


def own_imports(module: str, tree: ast.AST) -> set[str]:
    """The package's modules among the imports: ``vppres.model.data.Site`` is ``model.data``."""
    below = {name.removeprefix("vppres.") for name in imports(module, tree)
             if name.startswith("vppres.")}
    return {name if name in TREES else name.rpartition(".")[0] for name in below} - {module, ""}


def without_type_checking(tree: ast.Module) -> ast.Module:
    """The module without what only a type checker imports."""
    body = [node for node in tree.body
            if not (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING")]
    return ast.Module(body, [])


MODULES = sorted(name for name in TREES if name not in ENTRY_POINTS)


def test_table_is_read() -> None:
    table = layers()
    assert table["errors"] == 0
    assert table["errors"] < table["network"] < table["model.data"] < table["powerflow"]
    assert table["simulate"] < table["cli"] == max(table.values())


def test_every_module_is_in_the_table() -> None:
    packages = {name for name in MODULES if (PACKAGE / name.replace(".", "/")).is_dir()}
    assert set(MODULES) - packages - set(layers()) == set()


def test_every_module_of_the_table_exists() -> None:
    assert set(layers()) - set(MODULES) == set()


@pytest.mark.parametrize("module", MODULES)
def test_imports_point_to_the_same_layer_or_above(module: str) -> None:
    wrong = {other for other in own_imports(module, TREES[module])
             if level_of(other) > level_of(module)}
    assert wrong == set()


def test_imports_have_no_cycle() -> None:
    # A package imports its parts and is loaded before them, which is no cycle between modules.
    graph = {module: {other for other in own_imports(module, without_type_checking(TREES[module]))
                      if not other.startswith(f"{module}.")}
             for module in MODULES}
    assert set(TopologicalSorter(graph).static_order()) >= set(MODULES)


@pytest.mark.parametrize(("library", "owners"), OWNERS.items())
def test_library_has_one_home(library: str, owners: set[str]) -> None:
    importers = {module.partition(".")[0] for module, tree in TREES.items()
                 if any(name.partition(".")[0] == library for name in imports(module, tree))}
    assert importers == owners


def test_only_the_command_line_prints() -> None:
    printing = {module for module, tree in TREES.items() for node in ast.walk(tree)
                if isinstance(node, ast.Call) and ast.unparse(node.func) in ("print", "typer.echo")}
    assert printing == {"cli"}
