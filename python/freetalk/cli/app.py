"""Entry point of the command line: parses, runs one command, turns errors into one sentence."""

from __future__ import annotations

import importlib
import signal
import sys
import traceback
from collections.abc import Sequence
from typing import NoReturn

from freetalk.cli.parser import UsageError, make_parser

EXIT_ERROR = 2
EXIT_STOPPED = 130
EXIT_TERMINATED = 143


class TerminatedError(KeyboardInterrupt):
    """SIGTERM: everything half-written is cleared away on the way out."""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs a ``freetalk`` command.

    Args:
        argv: Arguments without the program's name; those of the process by default.

    Returns:
        0, or 2 after an error (one sentence on stderr), 130 when stopped from the keyboard, 143 by SIGTERM.
    """
    debug = False
    _end_in_order()
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
    except TerminatedError:
        print("freetalk: terminated", file=sys.stderr)
        return EXIT_TERMINATED
    except KeyboardInterrupt:
        print("freetalk: stopped", file=sys.stderr)
        return EXIT_STOPPED
    except SystemExit as finished:  # argparse, after --help and --version
        return finished.code if isinstance(finished.code, int) else EXIT_ERROR


def _end_in_order() -> None:
    def terminate(number: int, frame: object) -> NoReturn:
        raise TerminatedError

    try:
        if signal.getsignal(signal.SIGINT) == signal.SIG_DFL:  # see freetalk/__init__.py
            signal.signal(signal.SIGINT, signal.default_int_handler)
        if signal.getsignal(signal.SIGTERM) == signal.SIG_DFL:
            signal.signal(signal.SIGTERM, terminate)
    except ValueError:
        return  # signals belong to the main thread


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
