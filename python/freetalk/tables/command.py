"""The command line of ``scripts/table_*.py``."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from freetalk.data import parse_spec
from freetalk.tables.definitions import Recipes
from freetalk.tables.facetalk import TABLES
from freetalk.tables.report import write_results
from freetalk.tables.sets import Catalogue
from freetalk.tables.sizes import SIZES
from freetalk.tables.table import TableRun
from freetalk.tables.training import StoppedError


def main(name: str, arguments: Sequence[str] | None = None) -> int:
    """Makes a table row by row; a call that was killed is called again and goes on.

    Args:
        name: a key of ``freetalk.tables.facetalk.TABLES``.
        arguments: of the command line; ``None``: the process's.

    Returns:
        Exit status: 0, or 130 where a training was stopped.
    """
    given = _parser(name).parse_args(arguments)
    size = SIZES[given.size]
    catalogue = Catalogue(given.data, size.families, size.counterparts)
    kinds = ("ats", "facetalk") if given.speech else ()
    encoder = [f"{kind}.task.speech_encoder={given.speech}" for kind in kinds]
    recipes = Recipes(size, given.seed, [*given.overrides, *encoder])
    table = TABLES[name](recipes, given.settings)
    if (
        size.name == "full"
        and not given.speech
        and any(row.ats or row.facetalk for row in table.rows)
    ):
        raise SystemExit(
            "at size full the tables need the papers' speech encoder: give --speech DIR"
        )
    run = TableRun(
        table, catalogue, given.work / size.name, given.speech, size.sampler, given.device
    )
    try:
        seeds = range(given.seed, given.seed + (given.seeds or size.seeds))
        rows = run.rows(given.rows, seeds)
    except StoppedError as error:
        print(f"{error}; the same command goes on from there", file=sys.stderr)
        return 130
    named = [(label, Path(path)) for label, _, path in map(parse_spec, given.pred)]
    folders = [(label or path.name, path) for label, path in named]
    rows += run.predictions(folders)
    command = f"python scripts/table_{name.removeprefix('table_')}.py"
    typed = list(sys.argv[1:] if arguments is None else arguments)
    written = write_results(
        table,
        rows,
        size,
        catalogue,
        given.out,
        f"{command} {shlex.join(typed)}".strip(),
        given.seed,
    )
    print("\n".join(str(path) for path in written))
    return 0


def _parser(name: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=f"table_{name.removeprefix('table_')}.py",
        description=(TABLES[name].__doc__ or "").splitlines()[0],
        epilog="Rows are stored one by one below --work; the same command goes on where it was stopped.",
    )
    parser.add_argument(
        "--data",
        action="append",
        required=True,
        metavar="[NAME=]DIR",
        help="the open corpus, or EmoVOCA=, MEAD-EMOTE=, VOCASET=, BIWI=, Multiface=DIR; repeatable",
    )
    parser.add_argument("--size", choices=tuple(SIZES), default="small")
    parser.add_argument("--out", type=Path, default=Path("results/open"), help="where results go")
    parser.add_argument(
        "--work", type=Path, default=Path("build/tables"), help="trainings and rows, to go on from"
    )
    parser.add_argument("--rows", nargs="*", default=[], help="only these rows")
    parser.add_argument(
        "--settings",
        nargs="*",
        default=[],
        help="tables 2 and 3: other rows, as '1,2,4,5+3,4,5'; radius: other radii; facetalk_3: targets, "
        "as weights and head",
    )
    parser.add_argument(
        "--pred",
        action="append",
        default=[],
        metavar="NAME=DIR",
        help="another system's predictions of the test clips; repeatable",
    )
    parser.add_argument("--speech", default="", help="folder of the speech encoder")
    parser.add_argument(
        "--device", help="where rows are scored: cpu, cuda or cuda:N; a GPU where there is one"
    )
    parser.add_argument("--seed", type=int, default=0, help="the first seed")
    parser.add_argument(
        "--seeds",
        type=int,
        default=0,
        help="trainings of each row, by seed; 3 at size small, else 1 (a claim needs 3 to be decided)",
    )
    parser.add_argument("overrides", nargs="*", help="stm.section.key=value, or ats. or facetalk.")
    return parser
