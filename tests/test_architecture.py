"""The house: arrows go one way, pictures of it are true, and importing the package stays light."""

import ast
import functools
import graphlib
import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import pytest

import deadtime as dt

SOURCE = Path(dt.__file__).parent
CONTRIBUTING = Path(__file__).parents[1] / "CONTRIBUTING.md"
# The picture of the rooms: | `room/` | one sentence | the rooms that it uses |
PICTURE = re.findall(
    r"^\| `(\w+)/` \| (.+?) \| (.*?) \|$", CONTRIBUTING.read_text("utf-8"), re.MULTILINE
)
ORDER = [name for name, _, _ in PICTURE]
ROOMS = sorted(path.parent.name for path in SOURCE.glob("*/__init__.py"))


def module_of(path: Path) -> str:
    parts = path.relative_to(SOURCE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {module_of(path): path for path in sorted(SOURCE.rglob("*.py"))}


def imports_of(path: Path) -> set[str]:
    """The files of deadtime that a file imports, anywhere in it, for type checking, too."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names if alias.name.startswith("deadtime")}
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "deadtime":
            inner = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in FILES else str(node.module) for name in inner}
    return found


@functools.cache
def imports() -> dict[str, set[str]]:
    """What every file imports; asked for by tests, so that collecting them parses nothing."""
    return {name: imports_of(path) for name, path in FILES.items()}


def room_of(name: str) -> str:
    return (*name.split("."), "")[1]


def uses() -> dict[str, set[str]]:
    """The rooms that each room uses."""
    found = defaultdict(set)
    for name, imported in imports().items():
        found[room_of(name)] |= {room_of(other) for other in imported} - {room_of(name), ""}
    return found


def test_rooms_form_a_partial_order():
    graphlib.TopologicalSorter({room: uses()[room] for room in ROOMS}).prepare()


def test_no_file_imports_itself_by_way_of_others():
    graphlib.TopologicalSorter(imports()).prepare()


def test_no_folder_of_a_room_imports_itself_by_way_of_its_neighbours():
    """Of identification, whose files and folders have an order as rooms have."""
    uses: dict[str, set[str]] = defaultdict(set)
    for name, imported in imports().items():
        room, _, own = name.removeprefix("deadtime.").partition(".")
        if room == "identification":
            within = {other.split(".")[2] for other in imported if room_of(other) == room}
            uses[own.split(".")[0]] |= within - {own.split(".")[0]}
    graphlib.TopologicalSorter(uses).prepare()


def test_only_the_explorer_which_writes_scripts_uses_the_face_of_the_package():
    outside = {name for name, imported in imports().items() if "deadtime" in imported}
    assert {room_of(name) for name in outside} <= {"app"}


def test_the_picture_has_every_room_below_those_that_it_uses():
    assert sorted(ORDER) == ROOMS
    for room in ROOMS:
        assert {ORDER.index(other) for other in uses()[room]} <= set(range(ORDER.index(room)))


@pytest.mark.parametrize(("room", "sentence", "used"), PICTURE)
def test_the_picture_says_what_a_room_is_and_uses(room, sentence, used):
    text = ast.get_docstring(ast.parse((SOURCE / room / "__init__.py").read_text("utf-8")))
    assert text.split("\n")[0] == sentence
    assert used.split() == [other for other in ORDER if other in uses()[room]]


def test_every_file_lies_in_a_room():
    loose = {path.stem for path in SOURCE.glob("*.py")}
    assert loose == {"__init__", "__main__"}


# The same thing for another kind: as a command, a table and a figure; of a law and of a model; in a
# problem file and in memory; of a problem and of a study; of laws and of imperfections.
KINDS = {
    "audit certificates design experiment fit identify loop maps monte_carlo report robustness "
    "runs",
    "markov",
    "servo",
    "load schema",
    "entry",
}
SHARED_CLASSES = {"Loop"}  # faces of two rooms, each with its own


def test_files_and_classes_share_no_name_but_for_one_thing_of_several_kinds():
    files = [path.stem for path in FILES.values() if not path.stem.startswith("__")]
    shared = {name for name in files if files.count(name) > 1}
    assert shared == {name for kind in KINDS for name in kind.split()}
    classes = [
        node.name
        for path in FILES.values()
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.ClassDef)
    ]
    assert {name for name in classes if classes.count(name) > 1} == SHARED_CLASSES


def test_laws_filters_and_batches_ask_for_a_switching_model_and_know_none_by_name():
    models = {
        f"deadtime.switching.models.{name}" for name in ("markov", "markov_chain", "semi_markov")
    }
    rooms = {"feedback", "estimation", "spectrum", "laws", "simulation", "certificates", "margins"}
    rooms |= {"synthesis", "controller", "app"}
    knowing = {name for name, imported in imports().items() if imported & models}
    assert {room_of(name) for name in knowing}.isdisjoint(rooms)
    asking = [text for _, text in texts(SOURCE) if re.search(r"isinstance\([^)]*Markov", text)]
    assert asking == []


def texts(folder: Path) -> list[tuple[str, str]]:
    return [(str(path), path.read_text(encoding="utf-8")) for path in folder.rglob("*.py")]


def test_tests_mirror_the_rooms():
    folders = {path.parent.name for path in Path(__file__).parent.rglob("test_*.py")}
    assert folders - {"tests", "documents", "browser"} <= set(ROOMS)


def test_one_file_sets_how_many_bits_balls_have():
    """All threads share them, so whoever sets them keeps the others waiting."""
    setting = {
        Path(name).name for name, text in texts(SOURCE) if re.search(r"\bctx\.|workprec", text)
    }
    assert setting == {"precision.py"}


def test_importing_the_package_loads_nothing_heavy():
    code = (
        "import sys, deadtime; "
        "heavy = {'scipy', 'numba', 'matplotlib', 'xarray', 'pandas', 'pydantic', 'rich', "
        "'cyclopts', 'control', 'jinja2', 'clarabel', 'flint', 'numpy', "
        "'dask', 'distributed', 'zarr', 'panel', 'bokeh', 'tomlkit'}; "
        "print(sorted(heavy & set(sys.modules)))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout.strip() == "[]", result.stderr


def test_a_plant_and_a_law_load_numpy_and_little_else():
    code = (
        "import sys, deadtime as dt; plant = dt.SwitchedSystem([[[1.0]]], [[[1.0]]], 0.5); "
        "dt.AveragedPredictor(plant, [[[-2.0]]]); "
        "heavy = {'scipy', 'numba', 'matplotlib', 'xarray', 'pydantic', 'clarabel'}; "
        "print(sorted(heavy & set(sys.modules)))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout.strip() == "[]", result.stderr


def test_public_names_are_all_there():
    assert all(hasattr(dt, name) for name in dt.__all__)
    assert list(dt.__all__) == sorted(dt.__all__)
