"""``freetalk evaluate``."""

from __future__ import annotations

import argparse


def run(arguments: argparse.Namespace) -> None:
    """Measures weights on the test split of a corpus."""
    raise ValueError(arguments)
