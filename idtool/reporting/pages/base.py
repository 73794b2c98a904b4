"""A list of sections → one HTML file that needs nothing else.

A section is a heading and either a template under `templates/`, which reads what `render` is given, or figures.
All text is escaped by the templates: names and paths are a stranger's. The browser draws figures with plotly.js,
which is in the page, compressed.
"""

from __future__ import annotations

import base64
import gzip
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import jinja2
from plotly.offline import get_plotlyjs

from idtool.reporting.figures import metres, number, percent, with_error
from idtool.reporting.pages.embedding import EmbeddedFigures
from idtool.reporting.plots.figure import Figure

Section = tuple[str, str | Sequence[Figure]]
Sections = Sequence[Section]


def render(title: str, sections: Sections, scripts: list[str], data: Mapping[str, Any], **context: object) -> str:
    """The page.

    Parameters
    ----------
    title
        Its heading.
    sections
        Heading and template, or figures, of each.
    scripts
        Files under `templates/` that draw what no `Figure` holds, such as bodies in 3D.
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
    figures = EmbeddedFigures()
    environment.filters.update(number=number, with_error=with_error, metres=metres, percent=percent)
    environment.globals.update(embed=figures.add, embedded=figures.to_json)
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "allow_nan": False}
    page = environment.get_template("page.html")
    html = page.render(title=title, sections=sections, scripts=scripts, data=data, plotly=_library(), **context)
    return html.encode(errors="replace").decode()  # a path need not be text


@cache
def _library() -> str:
    """plotly.js as `templates/load.js` takes it: gzip in base64."""
    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), compresslevel=6, mtime=0)).decode()
