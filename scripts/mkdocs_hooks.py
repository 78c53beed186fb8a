"""What mkdocs calls while it builds the pages."""

from __future__ import annotations

import re
from typing import Any


def on_page_content(html: str, **_: Any) -> str:
    """Roles of docstrings (``:class:`X```) as plain code, which is all that the theme shows of them."""
    return re.sub(r":(?:attr|class|data|func|meth|mod):(?=<code>)", "", html)
