"""The numbers of MANO's hand stand where MANO's and the authors' formats are read, and nowhere else."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from tests.imports import ROOT, modules, tree, within

NUMBERS = {51, 48, 45, 63, 21, 16, 279}
"""Degrees of freedom, rotations, finger angles, key point coordinates, key points, parts, the published observation."""

FORMATS = (
    "dgrasp/hand/mano/", "dgrasp/hand/free/", "dgrasp/hand/builder/", "dgrasp/labels/recorded/",
    "dgrasp/labels/formats/release.py", "dgrasp/rl/run/published.py",
)  # fmt: skip
"""Files that read MANO's own formats, hands made from them, or the authors' files."""

OTHER_THINGS = {
    "dgrasp/objects/names.py": "DexYCB's numbers of objects",
    "dgrasp/objects/catalogue.py": "DexYCB's numbers of objects",
    "dgrasp/objects/add/parts.py": "hexadecimal digits of a hash",
    "dgrasp/config/experiment.py": "bits of a seed",
    "dgrasp/geometry/solids.py": "corners of a circle",
    "dgrasp/report/charts.py": "pixels",
}

SKELETON = "dgrasp.hand.mano.skeleton"
READERS = ("dgrasp.hand.mano", "dgrasp.hand.free", "dgrasp.hand.builder", "dgrasp.labels.recorded",
           "dgrasp.labels.formats.release")
"""Modules that may name MANO's joints and parts one by one."""
HANDS_OF_MANO = {"dgrasp.hand.load", "dgrasp.hand.motions", "dgrasp.hand.surface", "dgrasp.hand.store"}
"""Modules of the hand that treat hands with MANO's joints and others side by side."""


def numbers(source: ast.Module) -> Iterator[tuple[int, int]]:
    """(line, number) of each whole number of a module, those in docstrings' shapes such as (N, 51) included."""
    for node in ast.walk(source):
        if isinstance(node, ast.Constant) and type(node.value) is int and node.value in NUMBERS:
            yield node.lineno, node.value
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            for shape in re.findall(r"\((?:[A-Z]|\d+)?(?:, ?(?:[A-Z]|\d+))*,?\)", node.value):
                yield from ((node.lineno, int(word)) for word in re.findall(r"\d+", shape) if int(word) in NUMBERS)


def test_no_other_file_knows_how_many_joints_a_hand_has() -> None:
    found = []
    for path, _ in modules("dgrasp"):
        if path.startswith(FORMATS) or path in OTHER_THINGS:
            continue
        found += [f"{path}:{line}: {number}" for line, number in numbers(tree(ROOT / path))]
    assert found == []


def test_the_exceptions_are_there_and_needed() -> None:
    for path in OTHER_THINGS:
        assert list(numbers(tree(ROOT / path))), f"{path} needs no exception"


def test_only_readers_of_manos_formats_name_its_joints() -> None:
    found = []
    for path, names in modules("dgrasp"):
        module = path.removesuffix(".py").replace("/", ".").removesuffix(".__init__")
        if any(within(name, SKELETON) for name in names) and not within(module, *READERS):
            found.append(module)
    assert set(found) <= HANDS_OF_MANO


def test_numbers_are_found_in_code_and_in_docstrings() -> None:
    assert list(numbers(ast.parse("a = 51\nb = 1.0\nc = 50"))) == [(1, 51)]
    assert list(numbers(ast.parse('"""gc (N, 51) and (T, 16, 3)."""'))) == [(1, 51), (1, 16)]
    assert list(numbers(ast.parse('"""page 51, (21 of them)"""'))) == []
