"""Scans made ready to speak: repaired, lips cut apart, teeth and eyes put in; written with their look."""

from __future__ import annotations

from freetalk.prepare.inner_parts import add_inner_parts
from freetalk.prepare.mouth import open_mouth
from freetalk.prepare.repair import (
    FLOATING,
    Prepared,
    open_lips,
    prepare_mesh,
    save_prepared,
    to_budget,
)

__all__ = [
    "FLOATING",
    "Prepared",
    "add_inner_parts",
    "open_lips",
    "open_mouth",
    "prepare_mesh",
    "save_prepared",
    "to_budget",
]
