"""The order of the rooms: who may import whom, that nothing goes in circles, and that every room has a door.

A folder is a room. It imports rooms above it only, through their doors (`__init__.py`, and `__init__.pyi` where names
load on first use); its files are its own. Imports inside functions and under TYPE_CHECKING count as well.
"""

import ast
import statistics
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import pytest

import btr_mjx

PACKAGE = Path(btr_mjx.__file__).parent
ORDER = (
    *("errors", "runs", "robots", "models", "engines", "lanes", "evaluation", "cluster", "optimise", "exports"),
    *("gap.data", "gap.simulate", "gap.effects", "gap.preflight", "gap.windows", "gap.results"),
    *("gap.forces", "gap.inference"),
    *(
        "backtoreality",
        "plotting",
        "replays",
        "pages",
        "health",
        "gap.report",
        "gap.fitness_only",
        "gap.experiments",
        "gap",
        "demo",
        "commands",
    ),
)
"""Rooms, each of which may import those before it."""

COMMANDS = ("", "coevolve", "scan", "diagnose", "doctor", "plots", "replay", "report")
"""Modules at the top: the package itself and its commands."""

FILES = {
    ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix("__init__").rstrip("."): path
    for path in sorted(PACKAGE.rglob("*.py"))
}
"""Modules, named from the package on: "" is the package, "runs" a door, "runs.locks" a file."""


def room_of(module: str) -> str:
    if module in COMMANDS:
        return "commands"
    return max((room for room in ORDER if module == room or module.startswith(f"{room}.")), key=len)


def tree_of(module: str) -> ast.Module:
    """Syntax tree of a module; of a door whose names load on first use that of its stub."""
    path = FILES[module]
    stub = path.with_suffix(".pyi")
    return ast.parse((stub if stub.is_file() else path).read_text(encoding="utf-8"))


def imports_of(module: str) -> list[str]:
    """Modules of this package that a module imports, anywhere in it."""
    found = []
    for node in ast.walk(tree_of(module)):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0 or FILES[module].with_suffix(".pyi").is_file(), f"{module}: relative import"
            home = str(node.module)
            if node.level:
                home = ".".join(part for part in ("btr_mjx", module, node.module) if part)
            for alias in node.names:
                full = f"{home}.{alias.name}"
                found.append(full if full.removeprefix("btr_mjx.") in FILES else home)
    own = [name.removeprefix("btr_mjx").lstrip(".") for name in found if name.split(".")[0] == "btr_mjx"]
    return [name for name in own if name != module]


IMPORTS = {module: imports_of(module) for module in FILES}


def test_rooms_import_rooms_above_them_only():
    wrong = [
        f"{module} imports {other}"
        for module, imported in IMPORTS.items()
        for other in imported
        if ORDER.index(room_of(other)) > ORDER.index(room_of(module))
    ]
    assert not wrong


TANGLED = {("gap.data.columns", "gap.data.files"), ("gap.forces.answer", "gap.forces.sets")}
"""Folders of a room that import each other; no more of them may."""


def test_folders_of_a_room_have_an_order():
    """Two folders side by side do not import each other."""
    folders = {module for module, path in FILES.items() if path.name == "__init__.py"} - {"", *ORDER}
    above = {name: name.rpartition(".")[0] for name in folders}
    pairs = {
        (one, two)
        for one in folders
        for two in folders
        if above[one] == above[two] and one != two
        for module, imported in IMPORTS.items()
        if f"{module}.".startswith(f"{one}.") and any(f"{other}.".startswith(f"{two}.") for other in imported)
    }
    assert {pair for pair in pairs if pair[::-1] in pairs and pair[0] < pair[1]} == TANGLED


def test_files_are_private_to_their_room():
    """From elsewhere a room is entered by its door, or by a module that the door names."""
    doors = {room: tree_of(room) for room in ORDER if room != "commands"}
    named = {
        room: {alias.name for node in door.body if isinstance(node, ast.ImportFrom) for alias in node.names}
        for room, door in doors.items()
    }
    wrong = [
        f"{module} imports {other}"
        for module, imported in IMPORTS.items()
        for other in imported
        if room_of(module) != (room := room_of(other)) != "commands"
        and other != room
        and not (other.rpartition(".")[0] == room and other.rpartition(".")[2] in named[room])
    ]
    assert not wrong


def test_no_cycles():
    """Depth first over all imports; importing a door stands for importing what the door imports."""
    done: set[str] = set()

    def visit(module: str, trail: tuple[str, ...]) -> None:
        assert module not in trail, " -> ".join([*trail[trail.index(module) :], module])
        if module in done:
            return
        for other in IMPORTS[module]:
            visit(other, (*trail, module))
        done.add(module)

    for module in IMPORTS:
        if module:  # the package loads its public names on first use
            visit(module, ())


def test_rooms_are_small_and_have_doors():
    folders = defaultdict(list)
    for path in FILES.values():
        folders[path.parent].append(path.name)
    assert [str(folder) for folder, names in folders.items() if "__init__.py" not in names] == []
    assert {str(folder): len(names) for folder, names in folders.items() if len(names) > 20} == {}
    for folder in folders:
        door = ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8")))
        assert door, f"{folder}: a door says what lives there"
    assert statistics.median(len(path.read_text(encoding="utf-8").splitlines()) for path in FILES.values()) <= 180


def public_names(module: str) -> list[str]:
    """Functions, classes, type aliases and constants that a module defines for others."""
    names: list[str] = []
    for node in tree_of(module).body:
        match node:
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                names.append(name)
            case ast.Assign(targets=targets):
                names += [n.id for target in targets for n in ast.walk(target) if isinstance(n, ast.Name)]
            case ast.AnnAssign(target=ast.Name(id=name)) | ast.TypeAlias(name=ast.Name(id=name)):
                names.append(name)
    return [name for name in names if not name.startswith("_")]


def test_no_two_public_names_are_alike():
    """One name, one thing: whoever searches for a name finds one definition. `main` is the entry of every command."""
    homes = defaultdict(list)
    for module in FILES:
        for name in public_names(module):
            homes[name].append(module)
    assert {name: modules for name, modules in homes.items() if len(modules) > 1 and name != "main"} == {}


@pytest.mark.parametrize("room", [room for room in ORDER if room not in ("commands", "errors")])
def test_doors_name_what_they_import(room: str):
    door = tree_of(room)
    imported = [a.asname or a.name for node in door.body if isinstance(node, ast.ImportFrom) for a in node.names]
    listed = [n for node in door.body if isinstance(node, ast.Assign) for n in ast.literal_eval(node.value)]
    assert sorted(imported) == sorted(listed)


@pytest.mark.parametrize("command", ["diagnose", "doctor", "plots", "replay", "report"])
def test_commands_that_need_no_jax_do_not_load_it(command: str):
    """Loading JAX takes seconds; whoever mistypes a flag should not wait for them."""
    code = f"import sys, btr_mjx.{command}; print('jax' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.strip() == "False"
