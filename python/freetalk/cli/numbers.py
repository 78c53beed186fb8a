"""Readers of the numbers of the command line: each says what it expects. Imports nothing heavy."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from typing import TypeVar

_Number = TypeVar("_Number", int, float)


def _reader(
    read: Callable[[str], _Number], fits: Callable[[_Number], bool], complaint: str
) -> Callable[[str], _Number]:
    """A reader of numbers that fit; of others, and of what is none, it complains."""

    def reader(text: str) -> _Number:
        try:
            value = read(text)
            if fits(value):
                return value
        except ValueError:
            pass
        raise argparse.ArgumentTypeError(f"'{text}' {complaint}")

    return reader


positive = _reader(float, lambda x: 0 < x < math.inf, "is not a number above 0")
frame_rate = _reader(
    float, lambda x: 0 < x <= 240, "is no frame rate: give a number above 0, at most 240"
)
at_least_one = _reader(
    float, lambda x: 1 <= x < math.inf, "is not a number of at least 1 (slight)"
)  # how strong an emotion may be is for the weights to say
tolerance = _reader(
    float, lambda x: 0 <= x < math.inf, "is no tolerance: give millimetres, 0 for none"
)
temperature = _reader(float, lambda x: 0 <= x <= 1, "is no temperature: give a number from 0 to 1")
articulation = _reader(
    float, lambda x: 0.5 <= x <= 1.5, "is no articulation: give 0.5 to 1.5, 1 is usual"
)
share = _reader(float, lambda x: 0 < x < 1, "is not a number between 0 and 1")
natural = _reader(int, lambda n: n > 0, "is not a whole number above 0")
seed = _reader(int, lambda n: 0 <= n < 2**63, "is not a whole number from 0 to 2^63 - 1")


def picture_size(text: str) -> tuple[int, int]:
    """WIDTHxHEIGHT, or one number for a square; even numbers."""
    parts = text.lower().split("x")
    numbers = [int(part) if part.isdecimal() else 0 for part in parts]
    if len(numbers) not in (1, 2) or any(n < 16 or n > 8192 or n % 2 for n in numbers):
        raise argparse.ArgumentTypeError(
            f"'{text}' is no picture size: give WIDTHxHEIGHT in even pixels, such as 720x720"
        )
    return numbers[0], numbers[-1]
