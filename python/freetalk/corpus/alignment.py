"""Phone timings of recorded English by forced alignment with its text.

The aligner is pocketsphinx with the acoustic model of its wheel (``pip install 'freetalk[align]'``): an optional tool, asked for
only here. Words that its dictionary lacks are pronounced by espeak-ng. Alignments are kept as JSON: recording to a list of
(start in s, end in s, ARPABET label), the form that ``freetalk evaluate --phones`` reads too.
"""

from __future__ import annotations

import json
import re
import unicodedata
from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from freetalk.corpus.phones import ARPABET, Phone, merge
from freetalk.corpus.speech import SAMPLE_RATE_HZ, pronounce

FRAME_S = 0.01
"""Pocketsphinx's frames: phones begin and end at multiples of it."""
_SHORTEST_S = 0.1
_SILENT = 1e-3
_HURRIED = 3  # frames of the shortest phone that the aligner allows
_MOST_HURRIED = 0.25
"""Share of such phones from which on the text cannot be what is said: texts that were, had 0.02 to 0.16 (41 clips of five
readers), those of other recordings 0.2 to 0.5."""


class Segment(Protocol):
    """A phone of an alignment, as pocketsphinx gives it: start and duration in frames of 10 ms."""

    name: str
    start: int
    duration: int


def align_speech(samples: npt.ArrayLike, text: str) -> list[Phone]:
    """When each phone of a recording is heard.

    Args:
        samples: (S,) float in [-1, 1] at 16 kHz.
        text: what is said, all of it and in order; numbers and abbreviations written out as words.

    Returns:
        Contiguous phones from 0 to the end, ``sil`` in the pauses. The dictionary knows no schwa: it is AH.

    Raises:
        ModuleNotFoundError: pocketsphinx is not installed.
        ValueError: the text has no words, or holds digits, or the clip is shorter than 0.1 s.
        RuntimeError: the text does not fit the recording: no path through it, or so many phones of the shortest length
            that it has to be another text. One that is nearly right goes unnoticed.
    """
    wave = np.asarray(samples, dtype=np.float32).reshape(-1)
    if len(wave) < _SHORTEST_S * SAMPLE_RATE_HZ:
        raise ValueError(f"a clip of {len(wave)} samples is too short to be aligned")
    words = spoken_words(text)
    decoder = _decoder()
    for word in words:
        if decoder.lookup_word(word) is None:
            decoder.add_word(word, " ".join(dictionary_phones(pronounce(word))), True)
    sound = _pcm(wave)
    try:
        decoder.set_align_text(" ".join(words))
        _decode(decoder, sound)
        decoder.set_alignment()  # a second pass, within the words of the first
        _decode(decoder, sound)
        segments = list(decoder.get_alignment().phones())
    except (RuntimeError, TypeError, AttributeError) as error:
        raise RuntimeError(f"the text does not fit the recording: {text[:60]!r}") from error
    if hurried_share(segments) > _MOST_HURRIED:
        raise RuntimeError(f"something else seems to be said in the recording than {text[:60]!r}")
    return phones_of(segments, len(wave) / SAMPLE_RATE_HZ)


def recognised_words(samples: npt.ArrayLike) -> tuple[str, float]:
    """What pocketsphinx hears in a recording of English without a transcript, for :func:`align_speech`.

    Args:
        samples: (S,) float in [-1, 1] at 16 kHz.

    Returns:
        The words, and how sure of them it is: their mean posterior by time, in [0, 1]; 0 of none.

    Raises:
        ModuleNotFoundError: pocketsphinx is not installed.
    """
    wave = np.asarray(samples, dtype=np.float32).reshape(-1)
    if np.abs(wave).max(initial=0.0) < _SILENT:
        return "", 0.0  # where pocketsphinx is sure of an "and"
    decoder = _recogniser()
    _decode(decoder, _pcm(wave))
    heard = [s for s in decoder.seg() if re.fullmatch(r"[a-z'.]+(\(\d\))?", s.word)]
    if not heard:
        return "", 0.0
    frames = [s.end_frame - s.start_frame + 1 for s in heard]
    sure = np.average([min(float(s.prob), 1.0) for s in heard], weights=frames)
    return " ".join(s.word.split("(")[0] for s in heard), float(sure)


def hurried_share(segments: Iterable[Segment]) -> float:
    """Share of the phones, pauses aside, that have the shortest length an alignment can give them."""
    spoken = [segment for segment in segments if segment.name in ARPABET]
    return sum(segment.duration <= _HURRIED for segment in spoken) / max(1, len(spoken))


def spoken_words(text: str) -> list[str]:
    """Words of a text as pronouncing dictionaries spell them: lower case, apostrophes kept.

    Raises:
        ValueError: there are none, or a number is not written out.
    """
    plain = unicodedata.normalize("NFKD", text.replace("’", "'")).encode("ascii", "ignore").decode()
    if re.search(r"\d", plain):
        raise ValueError(f"write numbers out as words: {text[:60]!r}")
    words = [word.strip("'") for word in re.findall(r"[a-z']+", plain.lower())]
    words = [word for word in words if word]
    if not words:
        raise ValueError(f"there are no words in {text[:60]!r}")
    return words


def dictionary_phones(labels: Iterable[str]) -> list[str]:
    """ARPABET as the CMU dictionary writes it: no pauses, schwa as AH."""
    return ["AH" if label == "AX" else label for label in labels if label != "sil"]


def phones_of(segments: Iterable[Segment], duration_s: float) -> list[Phone]:
    """Contiguous phones from 0 to the end of the clip; fillers (``SIL``, ``+NSN+``) become pauses.

    Raises:
        ValueError: the segments overlap or run backwards.
    """
    phones: list[Phone] = []
    reached = 0.0
    for segment in segments:
        start, end = segment.start * FRAME_S, (segment.start + segment.duration) * FRAME_S
        if start < reached - 0.5 * FRAME_S or end < start:
            raise ValueError(
                f"phone {segment.name} at {start:.2f} s begins before the last one ends"
            )
        label = segment.name if segment.name in ARPABET else "sil"
        phones += [Phone(reached, start, "sil"), Phone(start, min(end, duration_s), label)]
        reached = end
    return merge([*phones, Phone(min(reached, duration_s), duration_s, "sil")])


def read_transcripts(path: Path) -> dict[str, str]:
    """Recording to text from lines ``NAME|TEXT`` (LJ Speech's metadata too: the last column counts).

    Raises:
        ValueError: a line has no text, or a recording occurs twice; names the line.
    """
    texts: dict[str, str] = {}
    for number, line in enumerate(path.read_text(encoding="utf-8-sig").splitlines(), start=1):
        if not line.strip():
            continue
        name, *columns = (part.strip() for part in line.split("|"))
        if not name or not columns or not columns[-1]:
            raise ValueError(f"{path}: line {number} is not RECORDING|TEXT")
        if name in texts:
            raise ValueError(f"{path}: line {number} names {name} again")
        texts[name] = columns[-1]
    return texts


def alignment_json(alignments: Mapping[str, Iterable[Phone]]) -> str:
    """Alignments as JSON text, times rounded to 0.1 ms."""
    rows = {
        name: [[round(p.start_s, 4), round(p.end_s, 4), p.label] for p in phones]
        for name, phones in alignments.items()
    }
    return (
        "{\n" + ",\n".join(f"{json.dumps(k)}: {json.dumps(v)}" for k, v in rows.items()) + "\n}\n"
    )


def read_alignments(path: Path) -> dict[str, list[Phone]]:
    """Alignments that :func:`alignment_json` made, or another aligner's in that form.

    Raises:
        ValueError: the file is no such JSON, a phone ends before it begins, or a label is not ARPABET.
    """
    try:
        rows: dict[str, list[Any]] = json.loads(path.read_text(encoding="utf-8"))
        result = {
            str(name): [Phone(float(start), float(end), str(label)) for start, end, label in phones]
            for name, phones in rows.items()
        }
    except (TypeError, ValueError, AttributeError) as error:
        raise ValueError(
            f"{path}: not JSON of recordings with [start s, end s, label]: {error}"
        ) from error
    for name, phones in result.items():
        reached = 0.0
        for phone in phones:
            if not reached - 1e-3 <= phone.start_s <= phone.end_s:
                raise ValueError(f"{path}: {name}: the phone at {phone.start_s} s is out of order")
            if phone.label not in ARPABET:
                raise ValueError(f"{path}: {name}: '{phone.label}' is no ARPABET without stress")
            reached = phone.end_s
    return result


def aligned_files(path: Path) -> dict[str, tuple[Path, list[Phone]]]:
    """The recordings that an alignment file names, relative to its folder: file and phones by name.

    Raises:
        FileNotFoundError: one is missing.
        ValueError: as :func:`read_alignments`.
    """
    found = {}
    for name, phones in read_alignments(path).items():
        file = path.parent / name
        if not file.is_file():
            raise FileNotFoundError(f"{path} names {name}, but there is no {file}")
        found[name] = (file, phones)
    return found


@lru_cache(maxsize=1)
def _decoder() -> Any:
    return _pocketsphinx(bestpath=False)


@lru_cache(maxsize=1)
def _recogniser() -> Any:
    return _pocketsphinx(beam=1e-56, wbeam=5e-32, maxhmmpf=6000, maxwpf=12)


def _pocketsphinx(**options: Any) -> Any:
    try:
        from pocketsphinx import Decoder
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "aligning needs pocketsphinx: pip install 'freetalk[align]'"
        ) from error
    return Decoder(samprate=SAMPLE_RATE_HZ, loglevel="FATAL", **options)


def _pcm(wave: npt.NDArray[np.float32]) -> bytes:
    return (np.clip(np.nan_to_num(wave), -1.0, 1.0) * 32767).astype(np.int16).tobytes()


def _decode(decoder: Any, sound: bytes) -> None:
    decoder.start_utt()
    decoder.process_raw(sound, full_utt=True)
    decoder.end_utt()
