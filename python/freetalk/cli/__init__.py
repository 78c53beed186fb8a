"""The ``freetalk`` command. Each subcommand's work is imported only when it runs."""

from __future__ import annotations

from freetalk.cli.app import main

__all__ = ["main"]
