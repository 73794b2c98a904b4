"""plotly.js as `templates/load.js` takes it: gzip in base64."""

from __future__ import annotations

import base64
import gzip
import threading
from functools import cache

import plotly

from idtool.common.kept_files import keep, read_kept


@cache
def compressed_plotly() -> str:
    """plotly.js, compressed once."""
    name = f"plotly-{plotly.__version__}.js.gz.base64"
    kept = read_kept(__file__, name)
    if kept is not None:
        return kept.decode()
    from plotly.offline import get_plotlyjs

    compressed = base64.b64encode(gzip.compress(get_plotlyjs().encode(), compresslevel=6, mtime=0))
    keep(__file__, name, compressed)
    return compressed.decode()


def prepare_plotly() -> None:
    """Begin to compress plotly.js in the background, for a page that is written later."""
    threading.Thread(target=compressed_plotly, daemon=True).start()
