"""What the speech encoder is taught to hear: phones, spectra, expression curves, lip opening."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freetalk.data import Dataset, MotionSequence, interpolate_frames, lip_opening
from freetalk.train.speech_recordings import RECORDED, Recordings

FloatArray = npt.NDArray[np.float32]

#: Label of frames whose phone is not known.
IGNORED_PHONE = -100


class SpeechTargets:
    """Targets of a corpus, and of recordings beside it, at any time of a sequence.

    Curves and opening are standardised over the train split of the corpus. Data without phones and named expressions
    knows the opening alone. Aligned recordings know no schwa, their
    dictionary writes AH; with them AX counts as AH.
    """

    def __init__(
        self,
        corpus: Dataset,
        sequences: Sequence[MotionSequence],
        recordings: Recordings | None = None,
    ) -> None:
        self.corpus = corpus
        self.recordings = recordings or Recordings([], corpus.fps)
        labels = {label for s in sequences for _, _, label in self._intervals(s)}
        merged = {"AX": "AH"} if self.recordings.sequences else {}
        self.phones: list[str] = sorted({merged.get(label, label) for label in labels} | {"sil"})
        index = {label: i for i, label in enumerate(self.phones)}
        self._phone_index = {label: index[merged.get(label, label)] for label in labels | {"sil"}}
        sequences = [s for s in sequences if s.source != RECORDED]
        if not sequences:
            raise ValueError("recordings alone teach no motion: give a source of the corpus too")
        mouth = [
            i
            for i, n in enumerate(corpus.expressions)
            if n.lower().startswith(("jaw", "mouth", "tongue"))
        ]
        weights = np.concatenate([corpus.weights(s)[:, mouth] for s in sequences])
        spread = weights.std(axis=0)
        active = spread > 0.01
        self._columns = np.array(mouth, dtype=int)[active]
        self._mean, self._spread = weights.mean(axis=0)[active], spread[active]
        openings = np.concatenate([lip_opening(corpus.landmarks(s)) for s in sequences])
        self._opening_mean = float(openings.mean())
        self._opening_spread = max(float(openings.std()), 1e-6)

    @property
    def num_curves(self) -> int:
        """Expression curves that move in the train split and belong to the mouth."""
        return len(self._columns)

    def phones_at(self, sequence: MotionSequence, times_s: FloatArray) -> npt.NDArray[np.int64]:
        """Phone index at each time; ``IGNORED_PHONE`` where the sequence has no phones."""
        intervals = self._intervals(sequence)
        if not intervals:
            return np.full(len(times_s), IGNORED_PHONE, dtype=np.int64)
        starts = np.array([start for start, _, _ in intervals])
        codes = np.array([self._phone_index.get(p, IGNORED_PHONE) for _, _, p in intervals])
        index = np.clip(np.searchsorted(starts, times_s, side="right") - 1, 0, None)
        result = codes[index]
        ends = np.array([end for _, end, _ in intervals])
        outside = (times_s >= ends[index]) | (times_s < starts[0])
        result[outside] = self._phone_index["sil"]
        return result.astype(np.int64)

    def motion_at(
        self, sequence: MotionSequence, times_s: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Standardised curves (T, num_curves) and opening (T,) at each time; zeros for recordings."""
        if len(times_s) == 0 or sequence.source == RECORDED:
            count = len(times_s)
            return np.zeros((count, self.num_curves), np.float32), np.zeros(count, np.float32)
        frames = np.clip(times_s * sequence.fps, 0, sequence.num_frames - 1)
        first, last = int(frames[0]), min(int(frames[-1]) + 2, sequence.num_frames)
        weights = self.corpus.weights(sequence, first, last)[:, self._columns]
        opening = lip_opening(self.corpus.landmarks(sequence, first, last))
        curves = (interpolate_frames(weights, frames - first) - self._mean) / self._spread
        gap = interpolate_frames(opening[:, None], frames - first)[:, 0]
        return (
            curves.astype(np.float32),
            ((gap - self._opening_mean) / self._opening_spread).astype(np.float32),
        )

    def _intervals(self, sequence: MotionSequence) -> list[tuple[float, float, str]]:
        heard = self.recordings if sequence.source == RECORDED else self.corpus
        return heard.phones(sequence)


def mel_filters(num_mels: int, fft_size: int, sample_rate_hz: int) -> Tensor:
    """Triangular filters on the mel scale (HTK), (fft_size / 2 + 1, num_mels)."""
    hertz = torch.linspace(0, sample_rate_hz / 2, fft_size // 2 + 1)
    top = 2595 * math.log10(1 + 0.5 * sample_rate_hz / 700)
    bottom = 2595 * math.log10(1 + 50 / 700)
    edges = 700 * (10 ** (torch.linspace(bottom, top, num_mels + 2) / 2595) - 1)
    rising = (hertz[:, None] - edges[:-2]) / (edges[1:-1] - edges[:-2])
    falling = (edges[2:] - hertz[:, None]) / (edges[2:] - edges[1:-1])
    return torch.minimum(rising, falling).clamp_min(0)


def log_mel(
    wave: Tensor, num_frames: int, offset_s: float, num_mels: int, sample_rate_hz: int = 16000
) -> Tensor:
    """Log-mel energies around the centres of the encoder's frames, each clip's mean removed.

    Args:
        wave: (B, S) samples.
        num_frames: S', frames 20 ms apart.
        offset_s: centre of the first frame.
        num_mels: bands.
        sample_rate_hz: rate of `wave`.

    Returns:
        (B, S', num_mels), divided by 3 (natural logarithm), about unit variance.
    """
    window, hop, fft_size = int(0.025 * sample_rate_hz), sample_rate_hz // 50, 512
    pad = window
    padded = torch.nn.functional.pad(wave, (pad, pad + hop))
    start = pad + int(offset_s * sample_rate_hz) - window // 2
    frames = padded[:, start:].unfold(1, window, hop)[:, :num_frames]  # (B, S', window)
    shaped = frames * torch.hann_window(window, device=wave.device)
    power = torch.fft.rfft(shaped, n=fft_size).abs().square()
    filters = mel_filters(num_mels, fft_size, sample_rate_hz).to(wave.device)
    energies = (power @ filters + 1e-6).log()
    return (energies - energies.mean(dim=(1, 2), keepdim=True)) / 3.0
