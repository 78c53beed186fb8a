"""Rendered frames of a face and of its mouth alone, and what is told of them: features for FID and KID, or a user's score."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from PIL import Image
from scipy.fft import dctn

from freetalk.corpus.assets import load_face_model
from freetalk.data.landmarks import LIPS
from freetalk.evaluate.generated import Features
from freetalk.viz import FaceRenderer, Sequence, View

Pictures = npt.NDArray[np.uint8]
#: A user's score of a clip: frames (T, H, W, 3) uint8 and their rate to a number, such as FIQA's or VQA's.
ClipScore = Callable[[Pictures, float], float]

#: Half of the side of the square around the mouth, m.
_MOUTH_M = 0.04
_DCT_SIDE, _DCT_KEPT = 64, 8
_FRONTAL = View(yaw_deg=0.0, pitch_deg=0.0, occlusion=False)


def face_frames(sequence: Sequence, fps: float = 25.0, side: int = 224) -> Pictures:
    """Frames of a face from the front, (T, side, side, 3) uint8.

    Args:
        sequence: the motion, in the canonical frame.
        fps: frames per second; 25 is SyncNet's.
        side: px; 224 is SyncNet's.
    """
    times = np.arange(round(sequence.duration_s * fps)) / fps
    with FaceRenderer(sequence, (side, side), _FRONTAL) as renderer:
        return np.stack([renderer.image(sequence.at_time(t)) for t in times])


def mouth_frames(sequence: Sequence, fps: float = 25.0, side: int = 64) -> Pictures:
    """Grey frames of the mouth alone, (T, side, side, 3) uint8 with three equal channels [FaceTalk, supplement C].

    Args:
        sequence: the motion, in the canonical frame.
        fps: frames per second.
        side: px.
    """
    rendered, times = 4 * side, np.arange(round(sequence.duration_s * fps)) / fps
    model = load_face_model()
    mouth = model.neutral[model.landmarks68[list(LIPS)]].mean(axis=0)
    with FaceRenderer(sequence, (rendered, rendered), _FRONTAL) as renderer:
        edges = [mouth + _MOUTH_M * np.array(way) for way in ((-1.0, 1.0, 0.0), (1.0, -1.0, 0.0))]
        (left, top), (right, bottom) = (_pixel(renderer, edge, rendered) for edge in edges)
        frames = []
        for time in times:
            picture = Image.fromarray(renderer.image(sequence.at_time(time))).convert("L")
            cut = picture.crop((left, top, right, bottom)).resize(
                (side, side), Image.Resampling.BOX
            )
            frames.append(np.repeat(np.asarray(cut)[..., None], 3, axis=2))
    return np.stack(frames)


def _pixel(renderer: FaceRenderer, point: npt.NDArray[Any], side: int) -> tuple[float, float]:
    """Column and row of a place, from the top left."""
    scene = renderer.plotter.renderer
    scene.SetWorldPoint(*map(float, point), 1.0)
    scene.WorldToDisplay()
    column, row, _ = scene.GetDisplayPoint()
    return column, side - row


def dct_features(pictures: list[Pictures]) -> npt.NDArray[np.float64]:
    """(N, 63) low frequencies of grey pictures: the first 8 by 8 of their cosine transform at 64 px, without the mean.

    The default where no network is given: no weights of Inception can be shipped here. Distances of these are of shapes
    and shades, and no published FID.
    """
    rows = []
    for picture in pictures:
        grey = Image.fromarray(picture).convert("L").resize((_DCT_SIDE, _DCT_SIDE))
        values = dctn(np.asarray(grey, np.float64) / 255, norm="ortho")[:_DCT_KEPT, :_DCT_KEPT]
        rows.append(values.ravel()[1:])
    return np.stack(rows)


def network_features(path: str | Path, device: torch.device | str = "cpu") -> Features:
    """Features of a user's TorchScript network, such as the public Inception of FID.

    Args:
        path: takes (B, 3, H, W) uint8 or, where it refuses these, float in [0, 1]; gives (B, D).
        device: where it runs.

    Raises:
        ValueError: it is no TorchScript.
    """
    try:
        network = torch.jit.load(str(path), map_location=device).eval()
    except RuntimeError as error:
        raise ValueError(
            f"{path} is no TorchScript network ({str(error).splitlines()[0]})"
        ) from error

    @torch.no_grad()
    def features(pictures: list[Pictures]) -> npt.NDArray[np.float64]:
        batch = torch.from_numpy(np.stack(pictures)).permute(0, 3, 1, 2).to(device)
        try:
            found = network(batch)
        except RuntimeError:
            found = network(batch.float() / 255)
        return found.flatten(1).cpu().double().numpy()

    return features


def clip_score(spec: str) -> tuple[str, ClipScore]:
    """A user's score by name: ``NAME=module:function`` of frames (T, H, W, 3) and frames per second.

    Raises:
        ValueError: not of that form, or no such function.
    """
    name, equals, where = spec.partition("=")
    module, colon, function = where.partition(":")
    if not equals or not colon or not name:
        raise ValueError(f"--score {spec}: write NAME=module:function")
    try:
        found: ClipScore = getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError) as error:
        raise ValueError(f"--score {spec}: {error}") from error
    return name, found
