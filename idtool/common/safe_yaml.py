"""Untrusted YAML: plain values only, of bounded size."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from idtool.common.exceptions import ConfigError
from idtool.common.input_files import read_error_text

_MAX_BYTES = 1 << 20  # no configuration or bag metadata is larger
_MAX_NODES = 200_000  # with aliases followed, so that nested aliases cannot blow up
_MAX_CHARACTERS = 10_000  # of one value: numbers in base 60 take the square of their length to read


def read_yaml(path: Path, *, as_text: bool = False) -> Any:
    """The contents of an untrusted YAML file; parameters and errors as in `yaml_bytes` and `parse_yaml`."""
    return parse_yaml(path, yaml_bytes(path), as_text=as_text)


def yaml_bytes(path: Path) -> bytes:
    """The bytes of a YAML file.

    Raises
    ------
    ConfigError
        If it cannot be read, or is too large.
    """
    try:
        with path.open("rb") as file:
            data = file.read(_MAX_BYTES + 1)
    except OSError as error:
        raise ConfigError(path, read_error_text(path, error)) from None
    if len(data) > _MAX_BYTES:
        raise ConfigError(path, f"is larger than {_MAX_BYTES >> 20} MiB")
    return data


def parse_yaml(path: Path, data: bytes, *, as_text: bool = False) -> Any:
    """Plain values from YAML of bounded size.

    Parameters
    ----------
    path
        The file, for errors.
    data
        From `yaml_bytes`.
    as_text
        If true, all values stay text of any length, and tags are ignored.

    Raises
    ------
    ConfigError
        If it is not YAML, or repeats a key.
    """
    try:
        loader = yaml.BaseLoader(data) if as_text else yaml.SafeLoader(data)
        root = loader.get_single_node()
        if root is None:
            return None
        _check_nodes(path, root, _MAX_BYTES if as_text else _MAX_CHARACTERS)
        return loader.construct_document(root)
    except yaml.MarkedYAMLError as error:
        line = f" in line {error.problem_mark.line + 1}" if error.problem_mark else ""
        raise ConfigError(path, f"is not YAML{line}: {error.problem}; correct it there") from None
    except RecursionError:
        raise ConfigError(
            path, "is not YAML: its lists or mappings are nested too deeply; write fewer levels"
        ) from None
    except ConfigError:
        raise
    except Exception:  # the parser has no error of its own for a tag that does not fit its value
        what = "is not YAML: it has bytes that are no UTF-8 text, or a value that does not fit its type"
        raise ConfigError(path, f"{what}; write plain values in UTF-8") from None


def _check_nodes(path: Path, root: yaml.Node, longest: int) -> None:
    """Refuse repeated keys, values of more than ``longest`` characters, and aliases that expand to too many values."""
    sizes: dict[int, int] = {}

    def size(node: yaml.Node) -> int:
        if id(node) in sizes:
            return sizes[id(node)]
        sizes[id(node)] = _MAX_NODES  # for an alias within its own node
        children: list[yaml.Node] = []
        if isinstance(node, yaml.MappingNode):
            keys: set[str] = set()
            for key, value in node.value:
                if isinstance(key, yaml.ScalarNode) and key.value in keys:
                    line = key.start_mark.line + 1
                    raise ConfigError(path, f"duplicate key '{key.value}' in line {line}; keep one")
                keys.add(str(key.value))
                children += [key, value]
        elif isinstance(node, yaml.SequenceNode):
            children = list(node.value)
        elif len(node.value) > longest:
            raise ConfigError(
                path, f"contains a value of {len(node.value)} characters in line {node.start_mark.line + 1}"
            )
        sizes[id(node)] = 1 + sum(map(size, children))
        return sizes[id(node)]

    if size(root) >= _MAX_NODES:
        raise ConfigError(path, f"contains more than {_MAX_NODES} values once its aliases are expanded")
