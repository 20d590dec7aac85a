"""The house of docs/architecture.md holds in the code: imports are read from the syntax trees."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections import defaultdict
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "vppres"
LIBRARY_HOMES = {
    "clarabel": {"solve"},
    "cvxpy": {"model", "solve"},
    "highspy": {"solve"},
    "pandapower": {"feeders"},
    "typer": {"cli"},
    "matplotlib": {"report"},
    "resvg_py": {"report"},
    "fastapi": {"service"},
    "paho": {"service"},
    "prometheus_client": {"service"},
    "sqlalchemy": {"service"},
    "uvicorn": {"service"},
}
MOST_ENTRIES, MOST_LAYERS = 25, 12
MOST_FILES_OF_A_KIND = 6
PRONOUNS = {"What", "Who", "Whom", "Whose", "Where", "That", "Those"}
"""First words that leave a docstring without a noun."""
SOLVING = (
    "cvxpy",
    "highspy",
    "pyscipopt",
    "clarabel",
    "vppres.model",
    "vppres.solve",
    "vppres.control",
)


def module_name(path: Path) -> str:
    """Dotted name below the package: ``model.data``; a package counts as itself: ``model``."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


LAYER_OF_PART = {
    "kinds": "scenario",
    "kind": "scenario",
    "folder": "scenario",
    "table": "scenario",
    "fields": "scenario",
    "data": "scenario",
    "live_fields": "live",
    "physics": "contract",
    "plant": "plant",
    "rows": "model",
    "words": "day",
    "record": "day",
    "reasons": "explain",
    "live": "live",
    "service": "service",
}
"""Where each part of a kind stands: a kind is a column through the layers, not a layer."""


def room_of(module: str) -> str:
    """Room of a module, that of its layer for a part of a kind."""
    room, _, part = module.partition(".")
    kinds = {path.parent.name for path in PACKAGE.glob("kinds/*/__init__.py")}
    if room != "kinds":
        return room
    name = (part or room).rpartition(".")[2]
    return LAYER_OF_PART["kinds" if name in kinds else name]


FILES = {module_name(path): path for path in sorted(PACKAGE.rglob("*.py"))}
ROOMS = sorted({room_of(module) for module in FILES} - {""})


@cache
def tree_of(module: str) -> ast.Module:
    """Syntax tree of a module."""
    return ast.parse(FILES[module].read_text(encoding="utf-8"))


@cache
def imports(module: str) -> frozenset[str]:
    """Absolute names of everything a module imports, inside functions too."""
    found: set[str] = set()
    for node in ast.walk(tree_of(module)):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}: write imports with the package's name"
            found.update(f"{node.module}.{alias.name}" for alias in node.names)
    return frozenset(found)


def own_imports(module: str) -> set[str]:
    """The package's modules among the imports: ``vppres.model.data.Site`` is ``model.data``."""
    below = {name.removeprefix("vppres.") for name in imports(module) if name.startswith("vppres.")}
    return {name if name in FILES else name.rpartition(".")[0] for name in below} - {module, ""}


def rooms_entered(room: str) -> set[str]:
    """Rooms that the modules of a room import."""
    return {
        room_of(other)
        for module in FILES
        if room_of(module) == room
        for other in own_imports(module)
    } - {room}


def documented_floors() -> list[list[str]]:
    """Rooms of each row of the table in docs/architecture.md, from the ground up."""
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d+) \| `(\w+)` \|", text, flags=re.MULTILINE)
    floors: dict[int, list[str]] = {}
    for floor, room in rows:
        floors.setdefault(int(floor), []).append(room)
    return [floors[floor] for floor in sorted(floors)]


@cache
def measured_floors() -> dict[str, int]:
    """Floor of each room: one above the highest room that it enters, counted from 1."""
    graph = {room: rooms_entered(room) for room in ROOMS}
    floors: dict[str, int] = {}
    for room in TopologicalSorter(graph).static_order():  # raises where there is a circle
        floors[room] = 1 + max((floors[other] for other in graph[room]), default=0)
    return floors


def test_the_top_of_the_package_can_be_taken_in_at_a_glance() -> None:
    entries = [path for path in PACKAGE.iterdir() if path.name != "__pycache__"]
    assert len(entries) <= MOST_ENTRIES


@pytest.mark.daily
def test_rooms_stand_on_few_floors_without_a_circle() -> None:
    assert max(measured_floors().values()) <= MOST_LAYERS


def test_the_table_is_the_house() -> None:
    measured = measured_floors()
    listed = {
        room: floor for floor, rooms in enumerate(documented_floors(), start=1) for room in rooms
    }
    assert listed == {room: floor for room, floor in measured.items() if room != "__main__"}


def test_imports_lead_down() -> None:
    floors = measured_floors()
    wrong = {
        f"{room} enters {other}"
        for room in ROOMS
        for other in rooms_entered(room)
        if floors[other] >= floors[room]
    }
    assert wrong == set()


def test_folders_of_the_service_stand_in_their_order() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    folders = re.findall(r"^\| `service/(\w+)` \|", text, flags=re.MULTILINE)
    of_service = {m.split(".")[1]: m for m in FILES if m.startswith("service.")}
    assert set(folders) == {name for name in of_service if (PACKAGE / "service" / name).is_dir()}
    wrong = {
        f"{module} imports {other}"
        for module in FILES
        for other in own_imports(module)
        if module.startswith("service.") and other.startswith("service.")
        for place, below in [(module.split(".")[1], other.split(".")[1])]
        if place in folders and below in folders and folders.index(below) > folders.index(place)
    }
    assert wrong == set()


def test_modules_import_in_no_circle() -> None:
    # A package's face imports its parts and is loaded before them, which is no circle.
    graph = {
        module: {other for other in own_imports(module) if not other.startswith(f"{module}.")}
        for module in FILES
        if module
    }
    assert set(TopologicalSorter(graph).static_order()) >= set(graph)


DOORS = {
    "day.trajectory": {"report.plot"},
    "scenario.scenario": {"report.plot", "io.scenario_tables"},
}
"""Modules above its own layer that a method loads when it is called."""


def test_doors_upwards_are_few() -> None:
    found: dict[str, set[str]] = {}
    for module in FILES:
        for call in re.findall(r"import_module\(\"vppres\.([\w.]+)\"\)", FILES[module].read_text()):
            found.setdefault(module, set()).add(call)
    assert found == DOORS


BUT_THE_FRAME = r"benchmarks\.(?!frame\b)"


@pytest.mark.parametrize(("folder", "above"), [
    ("vppres", ("benchmarks", "experiments", "tests", "docs")),
    ("benchmarks", ("experiments", "tests", "docs")),
    ("benchmarks/frame", (BUT_THE_FRAME, "experiments", "tests", "docs")),
    ("experiments", (BUT_THE_FRAME, "tests", "docs")),
])  # fmt: skip
def test_what_stands_beside_the_package_imports_one_way(
    folder: str, above: tuple[str, ...]
) -> None:
    upwards = re.compile(rf"^\s*(?:from|import) (?:{'|'.join(above)})\b", re.MULTILINE)
    files = sorted((ROOT / folder).rglob("*.py"))
    assert len(files) > 5
    assert [file.name for file in files if upwards.search(file.read_text("utf-8"))] == []


def test_plant_and_control_meet_only_at_the_contract() -> None:
    assert rooms_entered("plant").isdisjoint({"control", "solve", "model"})
    assert rooms_entered("control").isdisjoint({"plant"})


KIND_FILES = sorted(PACKAGE.glob("kinds/*/*.py"))
ROWS = [m for m in FILES if re.fullmatch(r"kinds\.\w+\.rows|model\.(constraints|implied)", m)]


@pytest.mark.parametrize("module", ROWS)
def test_rows_of_a_kind_take_nothing_from_its_physics(module: str) -> None:
    """An error of the arithmetic must not hide in rows that repeat it."""
    assert not {name for name in imports(module) if ".physics" in name}


@pytest.mark.parametrize("folder", sorted({path.parent.name for path in KIND_FILES}))
def test_a_kind_is_a_few_files(folder: str) -> None:
    assert sum(path.parent.name == folder for path in KIND_FILES) <= MOST_FILES_OF_A_KIND


def loaded_by(statement: str) -> set[str]:
    """Modules that are loaded in a fresh interpreter after a statement."""
    code = f"import sys\n{statement}\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_what_is_true_loads_no_solver() -> None:
    rooms = {"plant", "contract", "physics", "scenario", "io", "forecasts"}
    assert rooms <= set(ROOMS)
    modules = [name for name in FILES if room_of(name) in rooms]
    loaded = loaded_by("\n".join(f"import vppres.{name}" for name in modules))
    assert {f"vppres.{room}" for room in rooms} <= loaded
    assert {name for name in loaded if name.startswith(SOLVING)} == set()


def test_the_package_itself_loads_no_library() -> None:
    heavy = {"cvxpy", "pandapower", "matplotlib", "plotly", "pandas", "numpy"}
    assert loaded_by("import vppres").isdisjoint(heavy)


@pytest.mark.parametrize(("library", "homes"), LIBRARY_HOMES.items())
def test_library_has_one_home(library: str, homes: set[str]) -> None:
    importers = {
        room_of(module)
        for module in FILES
        if any(name.partition(".")[0] == library for name in imports(module))
    }
    assert importers == homes


def test_only_the_command_line_prints() -> None:
    printing = {
        module.partition(".")[0]
        for module in FILES
        for node in ast.walk(tree_of(module))
        if isinstance(node, ast.Call) and ast.unparse(node.func) in ("print", "typer.echo")
    }
    assert printing == {"cli"}


def numbers_of(tree: ast.Module) -> list[tuple[str, bool]]:
    """Constants that are numbers, and whether a text stands behind them or the next of their kind."""
    found = []
    told = False
    for statement in reversed(tree.body):
        if isinstance(statement, ast.Assign):
            names = [x.id for x in statement.targets if isinstance(x, ast.Name) and x.id.isupper()]
            value = statement.value
            text = isinstance(value, ast.Constant) and isinstance(value.value, str)
            if isinstance(value, ast.Constant | ast.BinOp | ast.UnaryOp) and not text:
                found += [(name, told) for name in names]
                continue
        told = isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
    return found


def test_every_number_of_the_solver_says_what_it_is() -> None:
    found = {m: numbers_of(tree_of(m)) for m in FILES if m.partition(".")[0] == "solve"}
    silent = [f"{m}: {name}" for m, numbers in found.items() for name, told in numbers if not told]
    assert not silent
    assert sum(len(numbers) for numbers in found.values()) > 30


@pytest.mark.daily
def test_a_class_name_names_one_thing() -> None:
    homes = defaultdict(list)
    for module in FILES:
        for node in ast.walk(tree_of(module)):
            if isinstance(node, ast.ClassDef):
                homes[node.name].append(module)
    assert {name: where for name, where in homes.items() if len(where) > 1} == {}


@pytest.mark.daily
def test_docstrings_name_a_quantity_or_an_action() -> None:
    vague = [
        f"{module}: {text.splitlines()[0]}"
        for module in FILES
        for node in ast.walk(tree_of(module))
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        and (text := ast.get_docstring(node))
        and (text.split()[0] in PRONOUNS or text.startswith("The same "))
    ]
    assert vague == []
