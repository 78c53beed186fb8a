"""Readers of the numbers of the command line: each says what it expects. Imports nothing heavy."""

from __future__ import annotations

import argparse
import math


def number(text: str) -> float:
    """A number; NaN, which no range holds, where the text is none."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def positive(text: str) -> float:
    """A finite number above 0."""
    value = number(text)
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"'{text}' is not a number above 0")
    return value


def at_least_one(text: str) -> float:
    """A finite number of at least 1; how strong an emotion may be is for the weights to say."""
    value = number(text)
    if not (math.isfinite(value) and value >= 1):
        raise argparse.ArgumentTypeError(f"'{text}' is not a number of at least 1 (slight)")
    return value


def tolerance(text: str) -> float:
    """A finite number of at least 0."""
    value = number(text)
    if not (math.isfinite(value) and value >= 0):
        raise argparse.ArgumentTypeError(f"'{text}' is no tolerance: give millimetres, 0 for none")
    return value


def temperature(text: str) -> float:
    """A number from 0 to 1."""
    value = number(text)
    if not 0 <= value <= 1:
        raise argparse.ArgumentTypeError(f"'{text}' is no temperature: give a number from 0 to 1")
    return value


def articulation(text: str) -> float:
    """A number from 0.5 to 1.5."""
    value = number(text)
    if not 0.5 <= value <= 1.5:
        raise argparse.ArgumentTypeError(
            f"'{text}' is no articulation: give 0.5 to 1.5, 1 is usual"
        )
    return value


def natural(text: str) -> int:
    """A whole number above 0."""
    if not text.isdecimal() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number above 0")
    return int(text)


def seed(text: str) -> int:
    """A whole number from 0 to 2^63 - 1."""
    if not text.isdecimal() or int(text) >= 2**63:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number from 0 to 2^63 - 1")
    return int(text)


def picture_size(text: str) -> tuple[int, int]:
    """WIDTHxHEIGHT, or one number for a square; even numbers."""
    parts = text.lower().split("x")
    numbers = [int(part) if part.isdecimal() else 0 for part in parts]
    if len(numbers) not in (1, 2) or any(n < 16 or n > 8192 or n % 2 for n in numbers):
        raise argparse.ArgumentTypeError(
            f"'{text}' is no picture size: give WIDTHxHEIGHT in even pixels, such as 720x720"
        )
    return numbers[0], numbers[-1]
