"""Where the elements of a URDF are in its text, so that one can be edited and every other byte stays."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from xml.parsers import expat
from xml.sax.saxutils import escape

_OPENING = re.compile(rb"""<(?:[^>"']|"[^"]*"|'[^']*')*>""")
_ATTRIBUTE = re.compile(rb"""([^\s="'/<>]+)\s*=\s*("[^"]*"|'[^']*')""")


@dataclass
class Span:
    """An element.

    Attributes
    ----------
    tag, attributes
        As in the text, character references resolved.
    start, opened, stop
        Positions in the text: of its first byte, after its opening tag, and after its last byte.
    children
        Elements right below it.
    """

    tag: str
    attributes: Mapping[str, str]
    start: int
    opened: int
    stop: int = 0
    children: list[Span] = field(default_factory=list)

    def named(self, tag: str) -> Iterator[Span]:
        """The children with a tag."""
        return (child for child in self.children if child.tag == tag)


def root_span(text: bytes) -> Span:
    """The root of a well-formed document, with all that is below it.

    Parameters
    ----------
    text
        The document, checked before: well-formed, without a document type.
    """
    parser = expat.ParserCreate()
    top = Span("", {}, 0, 0)
    stack = [top]

    def start(tag: str, attributes: dict[str, str]) -> None:
        at = parser.CurrentByteIndex
        match = _OPENING.match(text, at)
        span = Span(tag, attributes, at, match.end() if match else at)
        stack[-1].children.append(span)
        stack.append(span)

    def end(tag: str) -> None:
        span = stack.pop()
        empty = text[span.opened - 2 : span.opened] == b"/>"
        span.stop = span.opened if empty else text.index(b">", parser.CurrentByteIndex) + 1

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.Parse(text, True)
    return top.children[0]


def value_place(text: bytes, span: Span, name: str) -> tuple[int, int]:
    """Start and stop of an attribute's value, its quotes included; the attribute is there."""
    places = {match[1]: match.span(2) for match in _ATTRIBUTE.finditer(text, span.start, span.opened)}
    return places[name.encode()]


def quoted(value: str) -> bytes:
    """An attribute's value in quotes, in ASCII: right in whatever encoding the text is."""
    return b'"' + escape(value, {'"': "&quot;"}).encode("ascii", "xmlcharrefreplace") + b'"'


def edited(text: bytes, edits: list[tuple[int, int, bytes]]) -> bytes:
    """The text with the bytes from start to stop of every edit replaced; edits do not overlap."""
    for start, stop, new in sorted(edits, reverse=True):
        text = text[:start] + new + text[stop:]
    return text
