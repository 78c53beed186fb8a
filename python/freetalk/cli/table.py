"""``freetalk table``: the papers' tables."""

from __future__ import annotations

import argparse


def add_table(parser: argparse.ArgumentParser) -> None:
    """Adds the name; what follows it is the table's own."""
    parser.description = (
        "Trains a table's rows, scores them and judges the paper's claims; 'freetalk table supp_2 -- --help' lists "
        "what a table takes."
    )
    freetalk = ("2", "3", "supp_1", "supp_2", "radius")
    tables = (*freetalk, *(f"facetalk_{number}" for number in range(1, 6)))
    parser.add_argument("name", choices=tables, help="which")
    parser.add_argument("rest", nargs=argparse.REMAINDER, metavar="...", help="its arguments")


def run(arguments: argparse.Namespace) -> None:
    """Makes the table."""
    short = arguments.name
    name = f"table_{short}" if short.isdigit() else short
    rest = arguments.rest[1:] if arguments.rest[:1] == ["--"] else arguments.rest
    if name == "facetalk_1":
        from freetalk.tables import systems

        status = systems.main(rest)
    elif name == "facetalk_4":
        from freetalk.tables import fitting

        status = fitting.main(rest)
    else:
        from freetalk.tables import main

        status = main(name, rest)
    if status:
        raise SystemExit(status)
