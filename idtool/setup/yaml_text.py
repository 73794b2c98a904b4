"""Sections as YAML with comments. Names are untrusted: none may end the comment that it is in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import wrap
from typing import Any

import yaml

from idtool.common.outputs import as_yaml
from idtool.robot.config.schema import SCHEMA_FILE
from idtool.setup.records import ConfigSection

_WIDTH = 116  # characters of a line, less those of a comment's sign


def one_line(text: str) -> str:
    """The text on one line; line breaks and other unprintable characters are escaped."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def configuration_text(header: Sequence[str], sections: Sequence[ConfigSection]) -> str:
    """The text of the configuration, which first names its JSON schema for editors.

    Parameters
    ----------
    header
        Comments at the top, one line each.
    sections
        Sections of the configuration.
    """
    for_editors = f"# yaml-language-server: $schema={SCHEMA_FILE}\n"
    return for_editors + "\n".join([_comment(header), *map(_block, sections)])


def _comment(sentences: Sequence[str]) -> str:
    """Sentences as comments, each on a new line."""
    lines = []
    for sentence in sentences:  # names stay in one piece
        lines += wrap(one_line(sentence), _WIDTH, break_long_words=False, break_on_hyphens=False)
    return "".join(f"# {line}\n" for line in lines)


def _block(section: ConfigSection) -> str:
    text = _comment(section.comments)
    if section.value is not None:
        text += _yaml({section.key: section.value})
    text += _comment(section.remarks)
    if section.template is not None:
        lines = _yaml({section.key: section.template}).splitlines()
        if section.value is not None:
            lines = lines[1:]  # entries of the key that is there
        text += "".join(f"# {one_line(line)}\n" for line in lines)
    return text


def _yaml(data: Mapping[str, Any]) -> str:
    """Plain data as YAML, with each entry of a key on one line if it fits."""
    node = yaml.compose(as_yaml(data, ""), Loader=yaml.SafeLoader)
    _lay_out(node, 0)
    return str(yaml.serialize(node, Dumper=yaml.SafeDumper, width=_WIDTH))


def _lay_out(node: yaml.Node | None, depth: int) -> int:
    """Choose the collections that are written on one line; return the depth of the node."""
    if not isinstance(node, yaml.CollectionNode):
        return 0
    pairs = node.value if isinstance(node, yaml.SequenceNode) else [child for pair in node.value for child in pair]
    height = 1 + max((_lay_out(child, depth + 1) for child in pairs), default=0)
    node.flow_style = depth > 0 and height <= (1 if depth == 1 else 2)
    return height
