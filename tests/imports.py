"""What Python sources import, read without running them."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


@cache
def tree(path: Path) -> ast.Module:
    """The parsed source of a file."""
    return ast.parse(path.read_text(encoding="utf-8"))


def imported_names(source: str | ast.Module, module: str, is_package: bool = False) -> set[str]:
    """Full names of all that a module imports, at any depth of the code.

    module: the module's own dotted name, which relative imports start from. `from a import b` yields "a" and
    "a.b", as b may be a module itself.
    """
    package = module.split(".") if is_package else module.split(".")[:-1]
    names = set()
    for node in ast.walk(ast.parse(source) if isinstance(source, str) else source):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            names |= {base} | {f"{base}.{alias.name}" for alias in node.names}
    return names


@cache
def _imports(path: Path) -> set[str]:
    """What a file of the checkout imports."""
    relative = path.relative_to(ROOT)
    is_package = path.name == "__init__.py"
    parts = relative.parent.parts if is_package else relative.with_suffix("").parts
    return imported_names(tree(path), ".".join(parts), is_package)


def modules(folder: str) -> Iterator[tuple[str, set[str]]]:
    """Each module below a folder of the checkout, by its path from there, with what it imports."""
    for path in sorted((ROOT / folder).rglob("*.py")):
        yield path.relative_to(ROOT).as_posix(), _imports(path)


def imports_within(package: str) -> dict[str, set[str]]:
    """The modules of a package by dotted name, each with the other modules of the package that it imports.

    A folder's empty `__init__` is left out: what is imported are the modules beside it.
    """
    found = {_dotted(path): names for path, names in modules(package) if (ROOT / path).stat().st_size}
    return {module: {name for name in names if name in found and name != module} for module, names in found.items()}


def circles(graph: Mapping[str, set[str]]) -> list[list[str]]:
    """Groups of modules, sorted, of which each one imports all others of its group, directly or through them."""
    reach: dict[str, set[str]] = {}
    for start in graph:
        seen, todo = set[str](), list(graph[start])
        while todo:
            name = todo.pop()
            if name not in seen:
                seen.add(name)
                todo.extend(graph[name])
        reach[start] = seen
    groups = {tuple(sorted(other for other in reach[name] if name in reach[other])) for name in graph}
    return sorted(list(group) for group in groups if group)


def _dotted(path: str) -> str:
    return path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def within(name: str, *packages: str) -> bool:
    """Whether a dotted name is one of the packages or inside one."""
    return any(name == package or name.startswith(package + ".") for package in packages)
