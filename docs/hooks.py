"""Hook of mkdocs: the search index also as a script.

Browsers let a page that is opened from disk load scripts, but no data and no workers. ``theme/search/main.js`` reads
this script in place of mkdocs' ``search_index.json``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any


def on_post_build(config: Any) -> None:
    """Write ``search/search_index.js`` from the index that mkdocs has written."""
    folder = Path(config.site_dir) / "search"
    index = (folder / "search_index.json").read_text()
    (folder / "search_index.js").write_text(f"var search_index = {index};\n")
