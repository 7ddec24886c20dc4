"""The rooms of the package: who may import whom, read from one table and held against every import."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "maax_mjx"
FLOORS = (
    {"common"},
    {"worldgen", "layout", "physics"},
    {"modules"},
    {"core"},
    {"parallel"},
    {"wrappers"},
    {"tasks"},
    {"training"},
    {"viewer"},
    {"adapters"},
    {"benchmarks"},
    {"cli"},
)
"""From the ground up. A room imports from the floors below its own alone, so that rooms of one floor do not meet."""
LOOSE = {"__init__", "__main__", "testing"}
"""Files beside the rooms, which may import all of them; no room imports them."""


def imports(path):
    """The package's modules that a file imports, those for types alone and those inside functions too."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{path}: relative imports hide where they go"
            # `from room import file` imports the file, anything else what the module itself has.
            inside = {f"{node.module}.{alias.name}" for alias in node.names}
            files = {name for name in inside if is_file(name)}
            found |= files if len(files) == len(inside) else files | {node.module}
    return {name for name in found if name == "maax_mjx" or name.startswith("maax_mjx.")}


def is_file(module):
    return (PACKAGE.parent / module.replace(".", "/")).with_suffix(".py").exists()


def module_of(path):
    parts = ("maax_mjx", *path.relative_to(PACKAGE).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {module_of(path): path for path in sorted(PACKAGE.rglob("*.py"))}
EDGES = ("viewer", "benchmarks", "cli")


def room_of(module):
    return module.split(".")[1] if module.count(".") else "__init__"


def floor_of(room):
    return next(i for i, rooms in enumerate(FLOORS) if room in rooms)


def test_every_folder_is_a_room_and_no_file_is_loose():
    folders = {path.name for path in PACKAGE.iterdir() if path.is_dir() and (path / "__init__.py").exists()}
    assert folders == set().union(*FLOORS)
    assert {path.stem for path in PACKAGE.glob("*.py")} == LOOSE


@pytest.mark.parametrize("module", [name for name in FILES if room_of(name) not in LOOSE])
def test_a_room_imports_from_below_only(module):
    room = room_of(module)
    for name in imports(FILES[module]):
        # Edges take the public names of the package as users do, which come from below them.
        other = room_of(name)
        if name == "maax_mjx" or (other not in set().union(*FLOORS) and name.count(".") == 1):
            assert room in EDGES, f"{module} imports {name}"
            continue
        assert other == room or floor_of(other) < floor_of(room), f"{module} imports {name}"


def test_there_are_no_circles():
    graph = {}
    for module, path in FILES.items():
        if module != "maax_mjx":
            names = {name if name in FILES else name.rpartition(".")[0] for name in imports(path)}
            graph[module] = {name for name in names if name in FILES and name not in ("maax_mjx", module)}
    done, path = set(), []

    def visit(module):
        assert module not in path, " imports ".join([*path[path.index(module) :], module])
        if module not in done:
            path.append(module)
            for other in sorted(graph[module]):
                # A room's own files import its files, not the names that its __init__ gathers from them.
                visit(other)
            path.pop()
            done.add(module)

    for module in graph:
        visit(module)


def test_physics_knows_no_layouts():
    """Engines take fields: no file of the room names a world or a room plan."""
    for module, path in FILES.items():
        if room_of(module) == "physics":
            names = {node.id for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Name)}
            assert not names & {"World", "RoomPlan", "Layout"}, module
