"""What may import what: rooms in one order, no circles, the engines behind one door, physics apart from grasping."""

from __future__ import annotations

from collections import Counter
from pathlib import PurePosixPath

import pytest

from tests.imports import ROOT, circles, imported_names, imports_within, modules, within

ROOMS = {
    "dgrasp": [
        "version", "errors", "types", "files", "config", "geometry", "hand", "objects", "scene", "labels", "motion",
        "control", "rl", "env", "pool", "methods", "data", "build", "eval", "synthesis", "view", "export", "report",
        "evaluation", "training", "request", "grasping", "tables", "gym", "commands", "cli", "__main__",
    ],
    "raisim_like": [
        "errors", "rotations", "shapes", "shape_inertia", "contact", "urdf_gaps", "mimic", "urdf", "kinematics",
        "material", "batch", "engines", "rigid_body", "articulated_system", "world", "loop", "registry",
    ],
}  # fmt: skip
"""The modules and folders of each package, lowest first: each imports itself and what stands before it."""
MOST_FILES = 16
"""Python modules in one folder, besides its `__init__`."""
MOST_LINES = 320
"""Lines of one module."""


def room(module: str) -> str:
    """The part of a package that a module belongs to."""
    return module.split(".")[1]


@pytest.mark.parametrize("package", ROOMS)
def test_every_module_has_a_room(package: str) -> None:
    rooms = {room(module) for module in imports_within(package) if module != package}
    assert rooms and rooms <= set(ROOMS[package])


@pytest.mark.parametrize("package", ROOMS)
def test_no_import_runs_upwards(package: str) -> None:
    """Imports inside functions and for type checking count too."""
    height = {name: k for k, name in enumerate(ROOMS[package])}
    upwards = [
        (module, name)
        for module, names in imports_within(package).items()
        for name in names
        if package not in (module, name) and height[room(name)] > height[room(module)]
    ]
    assert upwards == []


@pytest.mark.parametrize("package", ROOMS)
def test_no_files_import_each_other_in_a_circle(package: str) -> None:
    assert circles(imports_within(package)) == []


@pytest.mark.parametrize("package", ROOMS)
def test_no_folder_is_crowded(package: str) -> None:
    files = (PurePosixPath(path) for path, _ in modules(package))
    count = Counter(path.parent for path in files if path.name != "__init__.py")
    assert {str(folder): n for folder, n in count.items() if n > MOST_FILES} == {}


@pytest.mark.parametrize("package", ROOMS)
def test_no_module_is_long(package: str) -> None:
    lines = {path: len((ROOT / path).read_text(encoding="utf-8").splitlines()) for path, _ in modules(package)}
    assert {path: n for path, n in lines.items() if n > MOST_LINES} == {}


@pytest.mark.parametrize(
    ("graph", "expected"),
    [
        ({"a": {"b"}, "b": {"c"}, "c": set()}, []),
        ({"a": {"b", "c"}, "b": {"c"}, "c": set()}, []),
        ({"a": {"b"}, "b": {"a"}, "c": {"a"}}, [["a", "b"]]),
        ({"a": {"b"}, "b": {"c"}, "c": {"d"}, "d": {"b"}, "e": {"f"}, "f": {"e"}}, [["b", "c", "d"], ["e", "f"]]),
    ],
)
def test_circles_are_found(graph: dict[str, set[str]], expected: list[list[str]]) -> None:
    assert circles(graph) == expected


def offenders(folder: str, *forbidden: str) -> list[str]:
    """The modules below a folder that import something forbidden, with what it is."""
    found = list(modules(folder))
    assert found, f"no modules below {folder}"
    return [f"{path} imports {name}" for path, names in found for name in sorted(names) if within(name, *forbidden)]


def test_no_import_hides_behind_a_name() -> None:
    """Only the command line imports by name; it stands above all that it names."""
    sources = {path: (ROOT / path).read_text(encoding="utf-8") for package in ROOMS for path, _ in modules(package)}
    by_name = ("import_module", "__import__", "from dgrasp import")
    assert [path for path, source in sources.items() if any(word in source for word in by_name)] == ["dgrasp/cli.py"]


@pytest.mark.parametrize("folder", ["dgrasp", "raisim_like"])
def test_only_the_engines_folder_imports_an_engine(folder: str) -> None:
    found = offenders(folder, "pybullet", "pybullet_data", "pybullet_utils", "mujoco", "mujoco_warp", "warp")
    assert [line for line in found if not line.startswith("raisim_like/engines/")] == []


def test_the_pybullet_engine_is_where_it_is_looked_for() -> None:
    assert offenders("raisim_like/engines", "pybullet")


def test_the_physics_layer_knows_nothing_of_grasping() -> None:
    assert offenders("raisim_like", "dgrasp") == []


def test_the_learner_knows_neither_task_nor_scene() -> None:
    assert offenders("dgrasp/rl", "dgrasp.env", "dgrasp.scene") == []


@pytest.mark.parametrize("folder", ["dgrasp", "raisim_like"])
def test_the_packages_do_not_lean_on_what_is_not_installed_with_them(folder: str) -> None:
    assert offenders(folder, "tests", "benchmarks", "train", "test") == []


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("import a.b as c, d", {"a.b", "d"}),
        ("from a import b as c", {"a", "a.b"}),
        ("def f():\n    if True:\n        import a", {"a"}),
        ("from . import x", {"top.mid", "top.mid.x"}),
        ("from .x import y", {"top.mid.x", "top.mid.x.y"}),
        ("from ..x import y", {"top.x", "top.x.y"}),
        ("text = 'import a'", set()),
    ],
)
def test_imports_are_found_in_every_form(source: str, expected: set[str]) -> None:
    assert imported_names(source, "top.mid.module") == expected


def test_relative_imports_of_a_package_start_at_itself() -> None:
    assert imported_names("from .x import y", "top.mid", is_package=True) == {"top.mid.x", "top.mid.x.y"}


def test_a_name_that_only_begins_alike_is_another() -> None:
    assert within("dgrasp.env.features", "dgrasp.env")
    assert not within("dgrasp.environment", "dgrasp.env")
