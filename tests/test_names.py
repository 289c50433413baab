"""One of each: no two classes of the packages have the same name, and the terms of use are written once."""

from __future__ import annotations

import ast
from collections import defaultdict

from dgrasp.files import licences
from tests.imports import ROOT, tree


def test_every_class_has_a_name_of_its_own() -> None:
    places: dict[str, list[str]] = defaultdict(list)
    for package in ("dgrasp", "raisim_like"):
        for path in sorted((ROOT / package).rglob("*.py")):
            for node in ast.walk(tree(path)):
                if isinstance(node, ast.ClassDef):
                    places[node.name].append(path.relative_to(ROOT).as_posix())
    assert len(places) > 100
    assert {name: files for name, files in places.items() if len(files) > 1} == {}


def test_the_terms_of_use_are_written_once() -> None:
    files = sorted((ROOT / "dgrasp").rglob("*.py"))
    for words in ("non-commercial", "CC BY-NC", "academic research only", '"MIT'):
        holding = [path.relative_to(ROOT).as_posix() for path in files if words in path.read_text(encoding="utf-8")]
        assert holding == ["dgrasp/files/licences.py"], words
    assert licences.DEXYCB == "DexYCB CC BY-NC 4.0; derived from MANO: non-commercial research only, no redistribution"
    assert licences.FREE_HAND == "MIT, as the project"


def test_files_and_folders_are_replaced_in_one_place() -> None:
    """Atomic writing has one home: nothing else renames what it wrote."""
    found = set()
    for path in sorted((ROOT / "dgrasp").rglob("*.py")):
        for node in ast.walk(tree(path)):
            name = node.func.attr if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) else ""
            if name in ("rename", "renames", "mkstemp") or (name == "replace" and _is_os(node)):
                found.add(path.relative_to(ROOT).as_posix())
    assert found == {"dgrasp/files/atomic.py"}


def _is_os(call: ast.AST) -> bool:
    """Whether the function called is one of `os`, not the method of a text."""
    assert isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute)
    return isinstance(call.func.value, ast.Name) and call.func.value.id == "os"
