"""Who may import whom: rooms lie on floors, and nothing reaches up or runs in a circle."""

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from tests.helpers.paths import ROOT

# From the top down; rooms of one floor do not know each other.
FLOORS = (
    ("cli",),
    ("api",),
    ("report",),
    ("pipelines",),
    ("survey",),
    ("simulation", "campaign", "config"),
    ("methods", "io"),
    ("core",),
)
METHODS = (
    ("land_vehicle",),
    ("ins_gnss",),
    ("alignment",),
    ("strapdown",),
    ("height",),
    ("allan", "attitude_smoother", "coning", "hse"),
)
# Methods take arrays and give arrays; they ask nobody what a user said.
NOT_IN_METHODS = ("click", "pydantic", "rich")


def imports(path, root):
    """Modules that a file imports anywhere, TYPE_CHECKING and function bodies included."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{path}: a relative import"
            for alias in node.names:
                whole = root.joinpath(*node.module.split("."), alias.name)
                inside = whole.is_dir() or whole.with_suffix(".py").exists()
                yield f"{node.module}.{alias.name}" if inside else node.module


def graph(root):
    """Imports within the package, by module."""
    arrows = {}
    for path in sorted((root / "sinstool").rglob("*.py")):
        name = ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__")
        arrows[name] = {one for one in imports(path, root) if one != name}
    return arrows


def upward(arrows, prefix, floors):
    """Imports that do not go down, of the rooms below ``prefix``."""
    height = {room: -k for k, rooms in enumerate(floors) for room in rooms}

    def room(module):
        parts = module.removeprefix(prefix).split(".")
        return parts[0] if module.startswith(prefix) and parts[0] in height else None

    return [
        f"{a} imports {b}"
        for a, uses in arrows.items()
        for b in uses
        if room(a) and room(b) and room(a) != room(b) and height[room(b)] >= height[room(a)]
    ]


def faults(root):
    """All that is against the plan of the house."""
    arrows = graph(root)
    result = upward(arrows, "sinstool.", FLOORS)
    result += upward(arrows, "sinstool.methods.", METHODS)
    result += [
        f"{a} imports {b}"
        for a, uses in arrows.items()
        for b in uses
        if a.startswith("sinstool.methods.") and b.split(".")[0] in NOT_IN_METHODS
    ]
    inner = {a: {b for b in uses if b in arrows and b != "sinstool"} for a, uses in arrows.items()}
    try:
        TopologicalSorter(inner).prepare()
    except CycleError as exc:
        result.append(f"a circle: {' -> '.join(exc.args[1])}")
    return result


def test_nothing_reaches_up_and_nothing_runs_in_a_circle():
    assert faults(ROOT) == []


def test_every_room_has_its_floor_and_nothing_lies_loose():
    package = ROOT / "sinstool"
    rooms = {path.name for path in package.iterdir() if (path / "__init__.py").exists()}
    assert rooms == {room for floor in FLOORS for room in floor}
    assert {path.name for path in package.glob("*.py")} == {"__init__.py", "__main__.py"}
    methods = {path.parent.name for path in (package / "methods").glob("*/__init__.py")}
    assert methods == {room for floor in METHODS for room in floor}


@pytest.mark.parametrize(
    ("where", "line", "said"),
    [
        ("core/a.py", "from sinstool.io import b", "sinstool.core.a imports sinstool.io.b"),
        ("io/a.py", "import sinstool.methods.hse", "sinstool.io.a imports sinstool.methods.hse"),
        ("methods/hse/a.py", "import click", "sinstool.methods.hse.a imports click"),
        (
            "methods/height/a.py",
            "def f():\n    from sinstool.methods.ins_gnss.b import x",
            "sinstool.methods.height.a imports sinstool.methods.ins_gnss.b",
        ),
    ],
)
def test_a_wrong_import_is_found(tmp_path, where, line, said):
    for place, text in ((where, line), ("io/b.py", ""), ("methods/ins_gnss/b.py", "x = 1")):
        path = tmp_path / "sinstool" / Path(place)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    assert faults(tmp_path) == [said]


def test_a_circle_is_found(tmp_path):
    core = tmp_path / "sinstool" / "core"
    core.mkdir(parents=True)
    for one, other in (("a", "b"), ("b", "a")):
        (core / f"{one}.py").write_text(f"from sinstool.core.{other} import x")
    (fault,) = faults(tmp_path)
    assert "sinstool.core.a" in fault and "sinstool.core.b" in fault
