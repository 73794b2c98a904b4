"""Edits of a URDF's text at the places of its elements, so that every other byte stays as it is.

expat reports where elements begin. Comments, order, quoting and indentation are kept, which no XML writer does.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import field
from typing import NamedTuple
from xml.parsers import expat

from idtool.common.dataclass import dataclass

_OPENING = re.compile(rb"""<(?:[^>"']|"[^"]*"|'[^']*')*>""")  # a > in a quoted attribute does not end the tag
_ATTRIBUTE = re.compile(rb"""([^\s="'/<>]+)\s*=\s*("[^"]*"|'[^']*')""")


class Edit(NamedTuple):
    """New bytes in place of those from start to stop."""

    start: int
    stop: int
    new: bytes


@dataclass
class Element:
    """An element of the document and its position in the text.

    Attributes
    ----------
    tag, attributes
        As in the text, character references resolved.
    start, content, stop
        Positions in the text: of its first byte, after its opening tag, and after its last byte.
    children
        Elements right below it.
    """

    tag: str
    attributes: Mapping[str, str]
    start: int
    content: int
    stop: int = 0
    children: list[Element] = field(default_factory=list)

    @property
    def name(self) -> str:
        """Value of the attribute ``name``; empty if there is none."""
        return self.attributes.get("name", "")

    def with_tag(self, tag: str) -> Iterator[Element]:
        """The children with a tag."""
        return (child for child in self.children if child.tag == tag)

    def first(self, tag: str) -> Element | None:
        """The first child with a tag; None if there is none."""
        return next(self.with_tag(tag), None)

    def descendants(self) -> Iterator[Element]:
        """All elements below it, in the order of the text."""
        for child in self.children:
            yield child
            yield from child.descendants()


def root_element(text: bytes) -> Element:
    """Parse a document that is known to be well-formed and without a document type, and return its root."""
    parser = expat.ParserCreate()
    document = Element("", {}, 0, 0)
    stack = [document]

    def start(tag: str, attributes: dict[str, str]) -> None:
        position = parser.CurrentByteIndex
        opening = _OPENING.match(text, position)
        if opening is None:
            raise AssertionError  # the parser has already read the tag's end
        element = Element(tag, attributes, position, opening.end())
        stack[-1].children.append(element)
        stack.append(element)

    def end(tag: str) -> None:
        element = stack.pop()
        is_empty = text[element.content - 2 : element.content] == b"/>"
        element.stop = element.content if is_empty else text.index(b">", parser.CurrentByteIndex) + 1

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.Parse(text, True)
    return document.children[0]


def set_attribute(text: bytes, element: Element, name: str, value: str) -> Edit:
    """The edit that gives an element's attribute a value, whether it has the attribute or not."""
    for attribute in _ATTRIBUTE.finditer(text, element.start, element.content):
        if attribute[1] == name.encode():
            return Edit(*attribute.span(2), quoted_attribute(value))
    opening = text[element.start : element.content]
    end = element.start + len(re.sub(rb"\s*/?>\Z", b"", opening))
    return Edit(end, end, b" " + name.encode() + b"=" + quoted_attribute(value))


def set_child(text: bytes, element: Element, tag: str, rows: Iterable[bytes]) -> Edit:
    """The edit that replaces an element's first child with a tag by rows, or inserts them as its first child.

    Rows take the child's indentation. Without rows the child is removed, with the white space before it.
    """
    child = element.first(tag)
    rows = list(rows)
    line = _line_break(text, child or element, deeper=child is None)
    new = line.join(rows)
    if child is not None and rows:
        return Edit(child.start, child.stop, new)
    if child is not None:
        before = text[: child.start].rstrip(b" \t").removesuffix(b"\n").removesuffix(b"\r")
        return Edit(len(before), child.stop, b"")
    if not rows:
        return Edit(element.content, element.content, b"")
    if text[element.content - 2 : element.content] != b"/>":
        return Edit(element.content, element.content, line + new)
    closing = line[:-2] + b"</" + element.tag.encode() + b">"  # without the indentation of a child
    return Edit(element.content - 2, element.content, b">" + line + new + closing)


def _line_break(text: bytes, element: Element, deeper: bool) -> bytes:
    """A line end and the indentation of an element, or of a new child of it."""
    line_start = text.rfind(b"\n", 0, element.start) + 1
    before = text[line_start : element.start]
    indentation = before[: len(before) - len(before.lstrip(b" \t"))]
    line_end = b"\r\n" if text[:line_start].endswith(b"\r\n") else b"\n"
    return line_end + indentation + (b"  " if deeper else b"")


def quoted_attribute(value: str) -> bytes:
    """An attribute's value in quotes, in ASCII: right in whatever encoding the text is."""
    for character, reference in (("&", "&amp;"), ("<", "&lt;"), (">", "&gt;"), ('"', "&quot;")):
        value = value.replace(character, reference)
    return b'"' + value.encode("ascii", "xmlcharrefreplace") + b'"'


def apply_edits(text: bytes, edits: Iterable[Edit]) -> bytes:
    """The text with all edits made; they do not overlap."""
    for start, stop, new in sorted(edits, reverse=True):
        text = text[:start] + new + text[stop:]
    return text
