"""English speech with phone timings from espeak-ng (its library's phoneme events) and flite (`-psdur`)."""

from __future__ import annotations

import ctypes
import ctypes.util
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import soundfile as sf
from scipy.signal import resample_poly

from freetalk.corpus.assets import Array
from freetalk.corpus.phones import Phone, espeak_label, flite_label, merge

SAMPLE_RATE_HZ = 16000
_SYNCHRONOUS, _PHONEME_EVENTS, _PHONEME, _UTF8 = 2, 1, 7, 1
_RATE, _PITCH, _RANGE = 1, 3, 4


@dataclass(frozen=True)
class Voice:
    """A synthetic voice: `engine` is espeak or flite, `name` its voice; rate 1 and pitch 1 are its own.

    flite voices keep their own pitch.
    """

    engine: str
    name: str
    rate: float = 1.0
    pitch: float = 1.0


ESPEAK_BASES = ("en-us", "en", "en-gb-x-rp", "en-gb-scotland", "en-gb-x-gbclan", "en-029")
ESPEAK_VARIANTS = (
    "f1", "f2", "f3", "f4", "m1", "m2", "m3", "m4", "m5", "m6", "m7", "m8", "Andy", "Annie", "Denis", "Gene", "Lee",
    "Mario", "Michael", "Jacky", "linda", "steph", "edward", "max", "zac", "belinda", "caleb", "travis",
)  # fmt: skip
FLITE_VOICES = ("slt", "awb", "kal16", "kal", "rms")
TEST_VARIANTS = ("f5", "david", "quincy")
TEST_FLITE = ("rms",)
VAL_VARIANTS = ("anika", "robert")


class _Id(ctypes.Union):
    _fields_ = [("number", ctypes.c_int), ("name", ctypes.c_char_p), ("string", ctypes.c_char * 8)]


class _Event(ctypes.Structure):
    _fields_ = [
        ("type", ctypes.c_int),
        ("unique_identifier", ctypes.c_uint),
        ("text_position", ctypes.c_int),
        ("length", ctypes.c_int),
        ("audio_position", ctypes.c_int),
        ("sample", ctypes.c_int),
        ("user_data", ctypes.c_void_p),
        ("id", _Id),
    ]


_Callback = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.POINTER(ctypes.c_short), ctypes.c_int, ctypes.POINTER(_Event)
)


class _Espeak:
    """The espeak-ng library, once a process."""

    def __init__(self) -> None:
        path = ctypes.util.find_library("espeak-ng") or "libespeak-ng.so.1"
        try:
            self._library = ctypes.CDLL(path)
        except OSError as error:
            raise RuntimeError(
                "espeak-ng is not installed: install it (apt install espeak-ng flite)"
            ) from error
        self.rate_hz = self._library.espeak_Initialize(_SYNCHRONOUS, 500, None, _PHONEME_EVENTS)
        if self.rate_hz <= 0:
            raise RuntimeError("espeak-ng finds no voice data: install it (apt install espeak-ng)")
        self._samples: list[np.ndarray] = []
        self._events: list[tuple[int, str]] = []
        self._callback = _Callback(self._receive)
        self._library.espeak_SetSynthCallback(self._callback)

    def _receive(self, wave: object, count: int, events: object) -> int:
        if wave and count > 0:
            self._samples.append(np.ctypeslib.as_array(wave, (count,)).copy())
        i = 0
        while events[i].type != 0:  # type: ignore[index]
            event = events[i]  # type: ignore[index]
            if event.type == _PHONEME:
                mnemonic = bytes(event.id.string).decode("utf-8", "ignore")
                self._events.append((event.sample, mnemonic))
            i += 1
        return 0

    def speak(self, text: str, voice: Voice) -> tuple[np.ndarray, list[tuple[int, str]]]:
        """Samples (S,) int16 and (sample, mnemonic) events at `rate_hz`."""
        self._samples, self._events = [], []
        if self._library.espeak_SetVoiceByName(voice.name.encode()) != 0:
            raise RuntimeError(f"espeak-ng has no voice {voice.name}")
        self._library.espeak_SetParameter(_RATE, int(round(165 * voice.rate)), 0)
        self._library.espeak_SetParameter(_PITCH, int(np.clip(50 * voice.pitch, 5, 99)), 0)
        self._library.espeak_SetParameter(_RANGE, 60, 0)
        data = text.encode()
        self._library.espeak_Synth(data, len(data) + 1, 0, 1, 0, _UTF8, None, None)
        self._library.espeak_Synchronize()
        samples = np.concatenate(self._samples) if self._samples else np.zeros(0, np.int16)
        return samples, self._events


@lru_cache(maxsize=1)
def _espeak() -> _Espeak:
    return _Espeak()


def speak(text: str, voice: Voice) -> tuple[Array, list[Phone]]:
    """Speaks a text.

    Returns:
        samples (S,) float32 at 16 kHz in [-1, 1] and contiguous phones from 0 to the end.
    """
    if voice.engine == "espeak":
        samples, events = _espeak().speak(text, voice)
        rate = _espeak().rate_hz
        audio = resample_poly(samples.astype(np.float64) / 32768, SAMPLE_RATE_HZ, rate)
        phones = _espeak_phones(events, rate, len(audio) / SAMPLE_RATE_HZ)
    elif voice.engine == "flite":
        audio, phones = _flite(text, voice)
    else:
        raise ValueError(f"engine is {voice.engine!r}: use espeak or flite")
    if len(audio) == 0:
        raise RuntimeError(f"{voice.engine} voice {voice.name} produced no sound for: {text}")
    return audio.astype(np.float32), merge(phones)


def pronounce(word: str) -> list[str]:
    """ARPABET of an English word as espeak-ng says it, pauses left out.

    Raises:
        RuntimeError: espeak-ng is not installed, or says nothing.
    """
    _, events = _espeak().speak(word, Voice("espeak", "en-us"))
    labels = [label for _, mnemonic in events for label in espeak_label(mnemonic)]
    labels = [label for label in labels if label != "sil"]
    if not labels:
        raise RuntimeError(f"espeak-ng has no pronunciation of {word!r}")
    return labels


def _espeak_phones(events: list[tuple[int, str]], rate_hz: int, duration_s: float) -> list[Phone]:
    starts = [sample / rate_hz for sample, _ in events]
    phones = [Phone(0.0, min(starts[0], duration_s), "sil")] if starts else []
    for i, (_, mnemonic) in enumerate(events):
        start = min(starts[i], duration_s)
        end = min(starts[i + 1], duration_s) if i + 1 < len(starts) else duration_s
        labels = espeak_label(mnemonic)
        step = (end - start) / len(labels)
        phones += [
            Phone(start + k * step, start + (k + 1) * step, label) for k, label in enumerate(labels)
        ]
    return phones


def _flite(text: str, voice: Voice) -> tuple[np.ndarray, list[Phone]]:
    if shutil.which("flite") is None:
        raise RuntimeError("flite is not installed: install it (apt install flite)")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "speech.wav"
        command = ["flite", "-voice", voice.name, "-psdur", "-t", text, "-o", str(path)]
        command += ["--setf", f"duration_stretch={1 / voice.rate:.3f}"]
        run = subprocess.run(command, capture_output=True, text=True, check=True)
        samples, rate = sf.read(path, dtype="float64")
    audio = resample_poly(samples, SAMPLE_RATE_HZ, rate) if rate != SAMPLE_RATE_HZ else samples
    phones, start = [], 0.0
    for token in run.stdout.split():
        name, _, end = token.rpartition(":")
        phones.append(Phone(start, float(end), flite_label(name)))
        start = float(end)
    duration = len(audio) / SAMPLE_RATE_HZ
    if start < duration:
        phones.append(Phone(start, duration, "sil"))
    return audio, phones
