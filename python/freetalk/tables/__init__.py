"""The tables of FreeTalk, made from a dataset with one command each (``scripts/table_*.py``)."""

from freetalk.tables.command import main

__all__ = ["main"]
