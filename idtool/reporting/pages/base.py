"""A list of sections → one HTML file that needs nothing else.

A section is a `Section`, or a heading and a template under `templates/`, which reads what `render` is given. All text
is escaped by the templates: names and paths are a stranger's. The browser draws plots with plotly.js, which is in the
page, compressed.
"""

from __future__ import annotations

import base64
import gzip
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import jinja2
from plotly.offline import get_plotlyjs

from idtool.reporting.figures import metres, number, percent, with_error
from idtool.reporting.sections.base import Section

Sections = Sequence[tuple[str, str] | Section[Any]]


class Passage(NamedTuple):
    """A section without a table of its own.

    Attributes
    ----------
    title
        Its heading.
    template
        The file under ``templates/`` that shows it.
    """

    title: str
    template: str


def render(title: str, sections: Sections, drawing: list[str], data: Mapping[str, Any], **context: object) -> str:
    """The page.

    Parameters
    ----------
    title
        Its heading.
    sections
        In the order of the page; a tuple is a heading and a template.
    drawing
        The scripts, files under `templates/`, that draw its plots.
    data
        What they draw, for JSON; NaN is not allowed.
    context
        What the templates read, beside ``data``.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("idtool.reporting"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(number=number, with_error=with_error, metres=metres, percent=percent)
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "allow_nan": False}
    page = environment.get_template("page.html")
    shown = [Passage(*section) if isinstance(section, tuple) else section for section in sections]
    html = page.render(title=title, sections=shown, drawing=drawing, data=data, plotly=_library(), **context)
    return html.encode(errors="replace").decode()  # a path need not be text


@cache
def _library() -> str:
    """plotly.js as `templates/load.js` takes it: gzip in base64."""
    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), compresslevel=6, mtime=0)).decode()
