"""Entry point of the command line: parses, runs one command, turns errors into one sentence."""

from __future__ import annotations

import importlib
import sys
import traceback
from collections.abc import Sequence

from freetalk.cli.parser import UsageError, make_parser

EXIT_ERROR = 2
EXIT_STOPPED = 130


def main(argv: Sequence[str] | None = None) -> int:
    """Runs a ``freetalk`` command.

    Args:
        argv: Arguments without the program's name; those of the process by default.

    Returns:
        0, or 2 after an error (one sentence on stderr), or 130 when stopped from the keyboard.
    """
    debug = False
    try:
        arguments = make_parser().parse_args(argv)
        debug = arguments.debug
        module, function = arguments.handler.split(":")
        getattr(importlib.import_module(f"freetalk.cli.{module}"), function)(arguments)
        return 0
    except UsageError as error:
        return _report(str(error))
    except (ValueError, RuntimeError, OSError, ImportError, MemoryError) as error:
        if debug:
            traceback.print_exc()
            return EXIT_ERROR
        return _report(describe(error))
    except KeyboardInterrupt:
        print("freetalk: stopped", file=sys.stderr)
        return EXIT_STOPPED
    except SystemExit as finished:  # argparse, after --help and --version
        return finished.code if isinstance(finished.code, int) else EXIT_ERROR


def describe(error: BaseException) -> str:
    """Says in one line what went wrong."""
    if isinstance(error, OSError) and error.strerror and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, MemoryError):
        return "not enough memory; try a smaller mesh or shorter speech"
    # LibTorch appends the C++ call stack to its messages.
    message = str(error).split("\nException raised from")[0].split("\nC++ CapturedTraceback")[0]
    message = " ".join(message.split())
    if isinstance(error, ModuleNotFoundError) and error.name and error.name.isidentifier():
        return f"the Python package '{error.name}' is missing: pip install 'freetalk[all]'"
    return message or type(error).__name__


def _report(message: str) -> int:
    print(f"freetalk: {message}", file=sys.stderr)
    return EXIT_ERROR
