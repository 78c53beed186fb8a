"""Lip-sync error with a user's SyncNet weights: LSE-D and LSE-C [Chung and Zisserman 2016; Prajwal et al. 2020].

SyncNet's weights are not free: they are read from the user's file, in the layout of the public
``syncnet_v2.model``. Frames and speech that it is shown, and the distance, are those of the published evaluation.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from scipy.fft import dct
from torch import Tensor, nn
from torch.nn import functional

FPS, SAMPLE_RATE_HZ, SIDE = 25, 16000, 224
#: Frames that SyncNet sees at once, and MFCC frames (100 Hz) that belong to them and to one.
_FRAMES, _SPOKEN, _SPOKEN_A_FRAME = 5, 20, 4
_COEFFICIENTS, _BANDS, _FFT = 13, 26, 512
_WINDOW, _HOP, _PREEMPHASIS, _LIFTER = 400, 160, 0.97, 22


class LipSync(NamedTuple):
    """How well lips and speech agree.

    Attributes:
        distance: LSE-D, the mean distance at the best offset; less is better.
        confidence: LSE-C, how much less that is than the median over offsets; more is better.
        offset_frames: by how many frames (of 25 fps) the lips are ahead of the speech there.
    """

    distance: float
    confidence: float
    offset_frames: int


class SyncNet(nn.Module):
    """SyncNet in the layout of the public weights: ``netcnnaud``, ``netfcaud``, ``netcnnlip``, ``netfclip``."""

    def __init__(self) -> None:
        super().__init__()
        self.netcnnaud = nn.Sequential(
            *_flat(1, 64, 3, 1),
            nn.MaxPool2d(1, 1),
            *_flat(64, 192, 3, 1),
            nn.MaxPool2d(3, (1, 2)),
            *_flat(192, 384, 3, 1),
            *_flat(384, 256, 3, 1),
            *_flat(256, 256, 3, 1),
            nn.MaxPool2d(3, 2),
            *_flat(256, 512, (5, 4), 0),
        )
        self.netcnnlip = nn.Sequential(
            *_deep(3, 96, (5, 7, 7), 2, 0),
            nn.MaxPool3d((1, 3, 3), (1, 2, 2)),
            *_deep(96, 256, (1, 5, 5), 2, 1),
            nn.MaxPool3d((1, 3, 3), (1, 2, 2), (0, 1, 1)),
            *_deep(256, 256, (1, 3, 3), 1, 1),
            *_deep(256, 256, (1, 3, 3), 1, 1),
            *_deep(256, 256, (1, 3, 3), 1, 1),
            nn.MaxPool3d((1, 3, 3), (1, 2, 2)),
            *_deep(256, 512, (1, 6, 6), 1, 0),
        )
        self.netfcaud, self.netfclip = (
            nn.Sequential(nn.Linear(512, 512), nn.BatchNorm1d(512), nn.ReLU(), nn.Linear(512, 1024))
            for _ in range(2)
        )

    @classmethod
    def from_file(cls, path: str | os.PathLike[str]) -> SyncNet:
        """Reads weights.

        Args:
            path: a file of tensors by name, as ``torch.save`` writes a state dictionary.

        Raises:
            FileNotFoundError: no such file.
            ValueError: the file is none of that kind, or a tensor is missing or of another shape; names it.
        """
        if not Path(path).is_file():
            raise FileNotFoundError(f"there is no file {os.fspath(path)}")
        try:
            state = torch.load(path, map_location="cpu", weights_only=True)
        except Exception as error:  # whatever a file that is no such archive makes it throw
            raise ValueError(f"{os.fspath(path)} holds no tensors by name ({error})") from None
        net = cls()
        for name, own in net.state_dict().items():
            shape = tuple(state[name].shape) if name in state else "none"
            if shape != tuple(own.shape) and not name.endswith("num_batches_tracked"):
                raise ValueError(
                    f"{os.fspath(path)} is not of SyncNet's layout: {name} is {shape}, expected {tuple(own.shape)}"
                )
        net.load_state_dict(state, strict=False)
        return net.eval()

    def forward(self, lips: Tensor, speech: Tensor) -> tuple[Tensor, Tensor]:
        """Embeddings of lips and speech.

        Args:
            lips: (B, 3, 5, 224, 224) BGR in [0, 255].
            speech: (B, 1, 13, 20) MFCC.

        Returns:
            (B, 1024) each.
        """
        seen = self.netfclip(self.netcnnlip(lips).flatten(1))
        return seen, self.netfcaud(self.netcnnaud(speech).flatten(1))


@torch.no_grad()
def lip_sync_error(
    net: SyncNet,
    frames: npt.NDArray[np.uint8],
    samples: npt.NDArray[np.float32],
    *,
    max_offset: int = 15,
    batch_size: int = 20,
) -> LipSync:
    """LSE-D and LSE-C of a video of a face and its speech.

    Args:
        net: the user's weights.
        frames: (T, 224, 224, 3) RGB crops of the face at 25 fps.
        samples: (S,) speech in [-1, 1] at 16 kHz.
        max_offset: frames by which lips and speech are shifted against each other either way.
        batch_size: windows at a time.

    Raises:
        ValueError: frames are of another shape, or the clip is shorter than six frames.
    """
    if frames.ndim != 4 or frames.shape[1:] != (SIDE, SIDE, 3):
        raise ValueError(f"expected frames (T, {SIDE}, {SIDE}, 3), found {frames.shape}")
    count = min(len(frames), len(samples) * FPS // SAMPLE_RATE_HZ) - _FRAMES
    if count < 1:
        raise ValueError(
            f"SyncNet needs six frames of 25 fps, found {len(frames)} and {len(samples)} samples"
        )
    device = next(net.parameters()).device
    spoken = torch.from_numpy(mfcc(samples)).to(device)  # (13, N)
    seen, heard = [], []
    for first in range(0, count, batch_size):
        starts = range(first, min(first + batch_size, count))
        lips = np.stack([frames[at : at + _FRAMES, ..., ::-1] for at in starts])
        begin = [_SPOKEN_A_FRAME * at for at in starts]
        speech = [spoken[:, at : at + _SPOKEN] for at in begin]
        pair = net(
            torch.from_numpy(lips).to(device).permute(0, 4, 1, 2, 3).float(),
            torch.stack(speech)[:, None],
        )
        seen.append(pair[0])
        heard.append(pair[1])
    return _agreement(torch.cat(seen), torch.cat(heard), max_offset)


def _agreement(seen: Tensor, heard: Tensor, max_offset: int) -> LipSync:
    padded = functional.pad(heard, (0, 0, max_offset, max_offset))
    shifts = 2 * max_offset + 1
    distances = torch.stack(
        [functional.pairwise_distance(seen, padded[at : at + len(seen)]) for at in range(shifts)]
    ).mean(1)
    best = int(distances.argmin())
    smallest = float(distances[best])
    return LipSync(smallest, float(distances.median()) - smallest, max_offset - best)


def mfcc(samples: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Mel-frequency cepstra as ``python_speech_features`` computes them of 16-bit samples.

    Args:
        samples: (S,) in [-1, 1] at 16 kHz.

    Returns:
        (13, N) at 100 Hz; the first is the logarithm of the energy.
    """
    signal = np.rint(np.clip(samples, -1, 1).astype(np.float64) * 32767)
    signal = np.append(signal[:1], signal[1:] - _PREEMPHASIS * signal[:-1])
    count = 1 + max(0, -(-(len(signal) - _WINDOW) // _HOP))
    signal = np.pad(signal, (0, max(0, (count - 1) * _HOP + _WINDOW - len(signal))))
    windows = np.lib.stride_tricks.sliding_window_view(signal, _WINDOW)[::_HOP][:count]
    power = np.square(np.abs(np.fft.rfft(windows, _FFT))) / _FFT
    tiny = np.finfo(np.float64).eps
    bands = np.maximum(power @ _mel_bands().T, tiny)
    cepstra = dct(np.log(bands), type=2, axis=1, norm="ortho")[:, :_COEFFICIENTS]
    cepstra *= 1 + _LIFTER / 2 * np.sin(np.pi * np.arange(_COEFFICIENTS) / _LIFTER)
    cepstra[:, 0] = np.log(np.maximum(power.sum(1), tiny))
    return cepstra.T.astype(np.float32)


def _mel_bands() -> npt.NDArray[np.float64]:
    """(26, 257) triangles, evenly on the mel scale from 0 to 8 kHz."""
    mel = np.linspace(0, 2595 * np.log10(1 + SAMPLE_RATE_HZ / 2 / 700), _BANDS + 2)
    edges = np.floor((_FFT + 1) * 700 * (10 ** (mel / 2595) - 1) / SAMPLE_RATE_HZ)
    bins = np.arange(_FFT // 2 + 1)
    low, peak, high = edges[:-2, None], edges[1:-1, None], edges[2:, None]
    rising = np.where((bins >= low) & (bins < peak), (bins - low) / np.maximum(peak - low, 1), 0)
    falling = np.where(
        (bins >= peak) & (bins < high), (high - bins) / np.maximum(high - peak, 1), 0
    )
    return rising + falling


def _flat(inputs: int, outputs: int, kernel: int | tuple[int, int], pad: int) -> list[nn.Module]:
    convolution = nn.Conv2d(inputs, outputs, kernel, padding=pad)
    return [convolution, nn.BatchNorm2d(outputs), nn.ReLU()]


def _deep(
    inputs: int, outputs: int, kernel: tuple[int, int, int], stride: int, pad: int
) -> list[nn.Module]:
    convolution = nn.Conv3d(
        inputs, outputs, kernel, stride=(1, stride, stride), padding=(0, pad, pad)
    )
    return [convolution, nn.BatchNorm3d(outputs), nn.ReLU()]
