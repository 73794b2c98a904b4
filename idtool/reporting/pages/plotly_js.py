"""plotly.js as `templates/load.js` takes it: gzip in base64."""

from __future__ import annotations

import base64
import gzip
import threading
from functools import cache

from plotly.offline import get_plotlyjs


@cache
def compressed_plotly() -> str:
    """plotly.js, compressed once in a process."""
    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), compresslevel=6, mtime=0)).decode()


def prepare_plotly() -> None:
    """Begin to compress plotly.js in the background, for a page that is written later."""
    threading.Thread(target=compressed_plotly, daemon=True).start()
