"""Plain values of a config, read from YAML and changed by dotted `key=value` overrides."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import yaml

from dgrasp.errors import ConfigError


class _ConfigLoader(yaml.SafeLoader):
    """SafeLoader that reads 1e-3 as a number, as YAML 1.2 does, and refuses duplicate keys and numbers that YAML 1.1
    reads in another base: 010 as 8, 1:30 as 90."""

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        seen: set[Any] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, str):
                raise yaml.constructor.ConstructorError(None, None, f"key {key!r} is not text", key_node.start_mark)
            if key in seen:
                raise yaml.constructor.ConstructorError(None, None, f"duplicate key {key!r}", key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep=deep)


_ConfigLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(\d[\d_]*\.?[\d_]*|\.[\d_]+)[eE][-+]?\d+$"),
    list("-+0123456789."),
)


def _number(loader: _ConfigLoader, node: yaml.ScalarNode) -> int | float:
    """A number in base 10 (or marked as 0x or 0b); `ConfigError` for one that YAML would read in base 8 or 60."""
    digits = node.value.lstrip("+-").replace("_", "")
    is_float = node.tag == "tag:yaml.org,2002:float"
    base = 60 if ":" in digits else 8 if not is_float and re.fullmatch(r"0\d+", digits) else 10
    if base != 10:
        place = f"line {node.start_mark.line + 1}: " if node.start_mark.line else ""
        raise ConfigError(f"{place}YAML reads {node.value[:40]} in base {base}; expected a decimal number without "
                          f"leading zeros or colons, or quoted text: '{node.value[:40]}'")
    return loader.construct_yaml_float(node) if is_float else loader.construct_yaml_int(node)


_ConfigLoader.add_constructor("tag:yaml.org,2002:int", _number)
_ConfigLoader.add_constructor("tag:yaml.org,2002:float", _number)


@lru_cache(maxsize=128)
def _parsed(text: str) -> Any:
    """A config takes 10 ms to read, and the table of an experiment reads the same ones hundreds of times."""
    return yaml.load(text, Loader=_ConfigLoader)


def parse_yaml(text: str, where: str) -> Any:
    """The values of a YAML text; `where` names its source in errors."""
    try:
        return copy.deepcopy(_parsed(text))
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from None
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise ConfigError(f"{where}: not valid YAML ({' '.join(str(error).split())})") from None


def apply_overrides(values: dict[str, Any], overrides: list[str]) -> dict[str, Any]:
    """A copy of `values`, changed by dotted `key=value` overrides; the overrides' values are YAML."""
    merged = _copy(values)
    for item in overrides:
        key, separator, text = item.partition("=")
        if not separator or not key:
            raise ConfigError(f"override {item!r}: expected key=value, such as ppo.epochs=100")
        node = merged
        *parents, leaf = key.split(".")
        for parent in parents:
            child = node.setdefault(parent, {})
            if not isinstance(child, dict):
                raise ConfigError(f"override {item!r}: {parent!r} is not a section")
            node = child
        node[leaf] = parse_yaml(text, f"override {item!r}")
    return merged


def override(key: str, value: Any) -> str:
    """The override `key=value` that sets a dotted key to a plain value, such as text or a list of texts."""
    return f"{key}={json.dumps(value)}"


def flat_keys(values: Mapping[Any, Any], prefix: str = "") -> dict[str, Any]:
    """Nested mappings as one mapping with dotted keys: {"ppo": {"epochs": 6}} as {"ppo.epochs": 6}."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        name = f"{prefix}{key}"
        flat |= flat_keys(value, f"{name}.") if isinstance(value, Mapping) else {name: value}
    return flat


def _copy(value: Any) -> Any:
    return {k: _copy(v) for k, v in value.items()} if isinstance(value, dict) else value
