"""What to do about a warning, from the table that the pages have it from."""

from __future__ import annotations

from functools import cache


def advice(warning: str) -> list[str]:
    """What to do, a sentence each; none where the warning says it itself."""
    return [what for phrase, what in _by_phrase().items() if phrase in warning]


@cache
def _by_phrase() -> dict[str, str]:
    import jinja2

    environment = jinja2.Environment(loader=jinja2.PackageLoader("idtool.reporting"), autoescape=True)
    table: dict[str, str] = vars(environment.get_template("advice.html").module)["advice"]
    return table
