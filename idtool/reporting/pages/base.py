"""`render`: a list of sections → one HTML file that needs no other file.

A section of a page is one of three:

- a `Section`, which makes its table from the report, for page and terminal alike. A new table is a class in
  ``reporting/sections/`` and an entry in the page's ``_SECTIONS`` (and in the list of the terminal).
- a heading with figures. A new figure is a function in ``reporting/plots/`` that returns a `Figure`, and such an entry.
- a heading with the name of a template under ``templates/``, for text with figures between or for drawings that no
  `Figure` holds. The template reads the keyword arguments of `render`; a missing one is an error.

Templates escape all text, since names and paths come from files of others. The browser draws figures with plotly.js,
which the page contains, compressed.
"""

from __future__ import annotations

import marshal
import re
import sys
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from importlib.metadata import version
from types import CodeType, MappingProxyType
from typing import Any, NamedTuple

import jinja2
from jinja2.bccache import Bucket
from markupsafe import Markup, escape
from typing_extensions import override

from idtool.common.kept_files import keep, read_kept
from idtool.common.names import is_or_are
from idtool.common.number_text import number, with_error
from idtool.reporting.number_text import metres, percent
from idtool.reporting.pages.embedding import EmbeddedFigures
from idtool.reporting.pages.plotly_js import compressed_plotly
from idtool.reporting.plots.figure import Figure
from idtool.reporting.sections.base import Section

_CODE = re.compile("`([^`\n]+)`")
_WITHIN_FIGURE = re.compile(r" (?=[±→])|(?<=[±→]) |(?<=\d) (?=[^\W\d])")  # the last before a unit


class _CompiledTemplates(jinja2.BytecodeCache):
    """Templates as compiled for the first page, of this process or of an earlier one."""

    def __init__(self) -> None:
        self._code: dict[str, CodeType] = {}

    @override
    def load_bytecode(self, bucket: Bucket) -> None:
        if bucket.key not in self._code:
            self._read(bucket)
        bucket.code = self._code.get(bucket.key)

    @override
    def dump_bytecode(self, bucket: Bucket) -> None:
        if bucket.code is not None:
            self._code[bucket.key] = bucket.code
            keep(__file__, f"template-{bucket.key}", marshal.dumps((_fingerprint(bucket), bucket.code)))

    def _read(self, bucket: Bucket) -> None:
        """Read a template that an earlier process has compiled from the same text in the same way."""
        kept = read_kept(__file__, f"template-{bucket.key}")
        if kept is None:
            return
        with suppress(EOFError, ValueError, TypeError):  # damaged
            fingerprint, code = marshal.loads(kept)  # noqa: S302  # as trustworthy as Python's own compiled modules
            if fingerprint == _fingerprint(bucket):
                self._code[bucket.key] = code


def _fingerprint(bucket: Bucket) -> str:
    """Text of all that the code of a template depends on."""
    environment = bucket.environment
    options = environment.autoescape, environment.optimized, environment.trim_blocks, environment.lstrip_blocks
    return f"{bucket.checksum} {options} {version('jinja2')} {sys.version}"


_COMPILED_TEMPLATES = _CompiledTemplates()

Sections = Sequence[tuple[str, str | Sequence[Figure]] | Section[Any]]


class TemplateSection(NamedTuple):
    """A section without a table of its own.

    Attributes
    ----------
    title
        Its heading.
    template
        The file under ``templates/`` that shows it.
    figures
        The figures that ``figures.html`` shows.
    """

    title: str
    template: str = "figures.html"
    figures: Sequence[Figure] = ()


def render(
    title: str,
    sections: Sections,
    scripts: list[str],
    data: Mapping[str, Any],
    folded: Collection[str] = (),
    topics: Mapping[str, Collection[str]] = MappingProxyType({}),
    **context: object,
) -> str:
    """The page.

    Parameters
    ----------
    title
        Its heading.
    sections
        In the order of the page; a tuple is a heading and a template, or figures.
    scripts
        Scripts under `templates/` that draw what no `Figure` holds, such as bodies in 3D.
    data
        Data of these scripts, for JSON; NaN is not allowed.
    folded
        Headings of the sections that show nothing else until they are opened.
    topics
        Headings of the sections by topic; the table of contents has a line for each topic.
    context
        Variables of the templates, beside ``data``.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("idtool.reporting"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        optimized=False,  # no filter is evaluated when a template is compiled, so that compiled ones can be kept
        trim_blocks=True,
        lstrip_blocks=True,
        bytecode_cache=_COMPILED_TEMPLATES,
    )
    figures = EmbeddedFigures()
    environment.filters.update(
        code=code,
        unbroken=unbroken,
        number=number,
        with_error=with_error,
        metres=metres,
        percent=percent,
        is_or_are=is_or_are,
    )
    environment.globals.update(embed=figures.add, embedded=figures.to_json)
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "allow_nan": False}
    page = environment.get_template("page.html")
    page_sections = [_template_section(*section) if isinstance(section, tuple) else section for section in sections]
    html = page.render(
        title=title,
        sections=page_sections,
        scripts=scripts,
        data=data,
        folded=folded,
        contents=_contents(page_sections, topics),
        plotly=compressed_plotly(),
        **context,
    )
    return html.encode(errors="replace").decode()  # a path need not be text


def heading(section: tuple[str, str | Sequence[Figure]] | Section[Any]) -> str:
    """Heading of a section."""
    return section[0] if isinstance(section, tuple) else section.title


def _contents(
    sections: Sequence[TemplateSection | Section[Any]], topics: Mapping[str, Collection[str]]
) -> list[tuple[str, list[tuple[int, TemplateSection | Section[Any]]]]]:
    """Lines of the table of contents: a topic, and its numbered sections."""
    numbered = list(enumerate(sections, start=1))
    if not topics:
        return [("", numbered)]
    lines = []
    for topic, titles in topics.items():
        of_topic = [(number, section) for number, section in numbered if section.title in titles]
        if of_topic:
            lines.append((topic, of_topic))
    return lines


def code(text: str) -> Markup:
    """Text as HTML, with what stands in backticks as code; markup stays as it is."""
    parts = _CODE.split(escape(text))
    parts[1::2] = [f"<code>{part}</code>" for part in parts[1::2]]
    return Markup("".join(parts))  # noqa: S704  # escaped above


def unbroken(text: str) -> str:
    """Text of which no line ends within a figure, such as "0.20 ± 0.01 rad"."""
    return _WITHIN_FIGURE.sub("\u00a0", text)


def _template_section(title: str, content: str | Sequence[Figure]) -> TemplateSection:
    if isinstance(content, str):
        return TemplateSection(title, content)
    return TemplateSection(title, figures=content)
