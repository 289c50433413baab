"""Read small YAML files of plain data, such as DexYCB's, whose only Python tag is `!!python/tuple`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from dgrasp.errors import DataError
from dgrasp.types import Array

MAX_BYTES = 50_000
"""Largest file that is read (DexYCB's have some kilobytes)."""


class _Loader(yaml.SafeLoader):
    """SafeLoader with tuples. Keys must be plain words, each used once.

    Collections as keys and merged mappings are refused: nested through aliases, their hash or their size can double
    with every line.
    """

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        seen: set[Any] = set()
        for key_node, _ in node.value:
            plain = isinstance(key_node, yaml.ScalarNode) and not key_node.tag.endswith((":merge", ":value"))
            key = self.construct_object(key_node) if plain else None
            if not isinstance(key, (str, int)) or key in seen:
                raise yaml.constructor.ConstructorError(None, None, "expected words as keys, each once",
                                                        key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep=deep)


def _tuple(loader: _Loader, node: yaml.Node) -> tuple[Any, ...]:
    if not isinstance(node, yaml.SequenceNode):
        raise yaml.constructor.ConstructorError(None, None, "expected a sequence", node.start_mark)
    return tuple(loader.construct_sequence(node))


_Loader.add_constructor("tag:yaml.org,2002:python/tuple", _tuple)


def read_yaml(path: Path) -> dict[Any, Any]:
    """The mapping that a YAML file holds. Raises `DataError` naming the file for anything else; nothing is executed."""
    path = Path(path)
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise DataError(f"{path}: {size} bytes; such a file has at most {MAX_BYTES}")
        content = yaml.load(path.read_text(encoding="utf-8"), Loader=_Loader)
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error})") from None
    except DataError:
        raise
    except Exception as error:
        # The constructors of dates, numbers and binary data fail in ways of their own.
        raise DataError(f"{path}: not plain YAML ({type(error).__name__}: {' '.join(str(error).split())[:200]}); get "
                        "the file again") from None
    if not isinstance(content, dict):
        raise DataError(f"{path}: holds a {type(content).__name__}; expected a mapping; get the file again")
    return content


def numbers(value: Any, counts: range, where: str) -> Array:
    """A list or tuple of finite numbers as float64; their count must be in `counts`. Raises `DataError` otherwise."""
    if isinstance(value, (list, tuple)) and len(value) in counts:
        plain = all(isinstance(v, (int, float)) and not isinstance(v, bool) and abs(v) <= 1e6 for v in value)
        if plain:
            return np.array([float(v) for v in value])
    wanted = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    raise DataError(f"{where}: expected a list of {wanted} finite numbers; get the file again")
