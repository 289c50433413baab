"""Who may import whom: the engines behind one door, the learner apart from the task, physics apart from grasping."""

from __future__ import annotations

import pytest

from tests.imports import imported_names, modules, within


def offenders(folder: str, *forbidden: str) -> list[str]:
    """The modules below a folder that import something forbidden, with what it is."""
    found = list(modules(folder))
    assert found, f"no modules below {folder}"
    return [f"{path} imports {name}" for path, names in found for name in sorted(names) if within(name, *forbidden)]


@pytest.mark.parametrize("folder", ["dgrasp", "raisim_like"])
def test_only_the_engines_folder_imports_an_engine(folder: str) -> None:
    found = offenders(folder, "pybullet", "pybullet_data", "pybullet_utils", "mujoco")
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
