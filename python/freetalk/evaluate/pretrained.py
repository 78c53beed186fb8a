"""A folder of weights, as training writes it and the package ships it, opened for evaluation on one device."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from freetalk.animation import resample_motion
from freetalk.ats import Ats, GenerateOptions, generate, generate_batch
from freetalk.data import Dataset, MotionSequence
from freetalk.speech import SpeechEncoder, encode_speech
from freetalk.stm import FrameDecoder, Stm
from freetalk.train.stm_landmarks import FaceLandmarks
from freetalk.train.stm_meshes import prepare_mesh

FloatArray = npt.NDArray[np.float32]

#: Faces whose operators and features stay in memory.
_KEPT_FACES = 16
#: Clips that a GPU samples together.
_CLIPS_ON_GPU = 16


def device_of(name: torch.device | str | None) -> torch.device:
    """The device that a name means; ``None`` and ``auto``: a GPU where there is one.

    Raises:
        ValueError: no such device, or CUDA is asked for and absent.
    """
    if name is None or name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise ValueError(f"unknown device {name!r}: give cpu, cuda or cuda:N") from error
    if device.type == "cuda" and not torch.cuda.is_available():
        raise ValueError(f"device {name} is asked for, but this machine has no usable GPU")
    return device


class SpeechToMotion:
    """Speech encoder and ATS on one device: samples in, landmark motion out.

    Args:
        encoder: folder of the speech encoder.
        ats: folder of the audio-to-landmarks stage.
        sampling: fields of ``GenerateOptions``.
        device: where it runs, see :func:`device_of`.
    """

    def __init__(
        self,
        encoder: Path,
        ats: Path,
        sampling: Mapping[str, object],
        device: torch.device | str | None = None,
    ) -> None:
        self.device = device_of(device)
        self.encoder = SpeechEncoder.from_pretrained(encoder).to(self.device).eval()
        self.ats = Ats.from_pretrained(ats).to(self.device).eval()
        self.options = GenerateOptions.from_dict(dict(sampling))
        self.fps = float(self.ats.options.fps)
        self.emotions = tuple(self.ats.options.emotions)

    @classmethod
    def of(
        cls,
        directory: str | Path,
        sampling: Mapping[str, object] | None = None,
        device: torch.device | str | None = None,
    ) -> SpeechToMotion:
        """Of a folder with ``speech`` and ``ats``.

        Args:
            directory: the folder; its ``talker.json`` says how the weights want to be sampled.
            sampling: fields of ``GenerateOptions`` that win over it.
            device: see :func:`device_of`.
        """
        path = Path(directory)
        about = path / "talker.json"
        own = json.loads(about.read_text()).get("generate", {}) if about.is_file() else {}
        return cls(path / "speech", path / "ats", {**own, **(sampling or {})}, device)

    def features(self, wave: FloatArray) -> torch.Tensor:
        """Speech features at the motion's frames, (T, C), on the device."""
        return encode_speech(self.encoder, torch.from_numpy(np.array(wave)), self.fps)

    def motion(
        self,
        features: torch.Tensor,
        emotion: str = "neutral",
        intensity: float = 1.0,
        seed: int = 0,
    ) -> FloatArray:
        """Landmark displacements, (T, 68, 3) m."""
        motion = generate(
            self.ats,
            features,
            emotion=self.mixture(emotion),
            intensity=intensity,
            options=self.options,
            seed=seed,
        )
        return motion.cpu().numpy()

    def mixture(self, emotion: str) -> torch.Tensor:
        """(E,) of one emotion.

        Raises:
            ValueError: the weights do not know it.
        """
        if emotion not in self.emotions:
            raise ValueError(f"the weights know no emotion {emotion!r}: {', '.join(self.emotions)}")
        mixture = torch.zeros(len(self.emotions), device=self.device)
        mixture[self.emotions.index(emotion)] = 1.0
        return mixture

    def perform(
        self,
        dataset: Dataset,
        clips: Sequence[MotionSequence],
        seeds: Sequence[Sequence[int]],
        batch: int = 0,
    ) -> Iterator[tuple[MotionSequence, FloatArray]]:
        """Landmark motion of clips from their sound, under their own emotions.

        Args:
            dataset: whose clips they are.
            clips: with sound.
            seeds: K a clip, of as many performances.
            batch: clips that are sampled together; 0: 16 on a GPU, else one.

        Yields:
            Clip and displacements (K, T, 68, 3) m, at the clip's frame rate.
        """
        size = batch or (1 if self.device.type == "cpu" else _CLIPS_ON_GPU)
        for first in range(0, len(clips), size):
            chosen = clips[first : first + size]
            made = generate_batch(
                self.ats,
                [self.features(dataset.audio(clip)) for clip in chosen],
                emotion=torch.stack([self.mixture(dataset.emotions[c.emotion]) for c in chosen]),
                intensity=torch.tensor([float(c.intensity) for c in chosen], device=self.device),
                options=self.options,
                seeds=seeds[first : first + size],
            )
            for clip, motions in zip(chosen, made, strict=True):
                moved = [at_rate(motion, self.fps, clip) for motion in motions.cpu().numpy()]
                yield clip, np.stack(moved)


class LandmarksToMesh:
    """STM on one device: moves the faces of datasets.

    Args:
        directory: folder of the landmarks-to-mesh stage.
        device: see :func:`device_of`.
    """

    def __init__(self, directory: str | Path, device: torch.device | str | None = None) -> None:
        self.device = device_of(device)
        self.stm = Stm.from_pretrained(directory).to(self.device).eval()
        keep = lru_cache(maxsize=_KEPT_FACES)
        self._prepared: Callable[..., FrameDecoder] = keep(self._prepare)

    def vertices(
        self, dataset: Dataset, identity: int, topology: str, landmarks: FloatArray
    ) -> torch.Tensor:
        """Vertex displacements (T, V, 3) m, on the CPU, of landmark displacements (T, 68, 3) m."""
        decoder = self._prepared(dataset, identity, topology)
        motion = torch.from_numpy(np.ascontiguousarray(landmarks, dtype=np.float32))
        return decoder.decode(motion.to(self.device)).float().cpu()

    def _prepare(self, dataset: Dataset, identity: int, topology: str) -> FrameDecoder:
        options = self.stm.options
        mesh = prepare_mesh(
            dataset,
            identity,
            topology,
            options.length_scale,
            options.k_eig,
            device=self.device,
            landmarks=FaceLandmarks(dataset) if options.follows_landmarks else None,
        )
        with torch.no_grad():
            features = self.stm.encode(mesh.positions, mesh.operators)
        return self.stm.frame_decoder(features, mesh.operators, follower=mesh.follower)


def at_rate(motion: FloatArray, fps: float, clip: MotionSequence) -> FloatArray:
    """Landmark motion at `fps` as the clip's frames, as a talker has it, as far as it goes."""
    count = int(((np.arange(clip.num_frames) * fps / clip.fps) <= len(motion) - 1 + 1e-6).sum())
    spoken = torch.from_numpy(motion)
    moved: FloatArray = resample_motion(spoken, fps, clip.fps, count, spoken).numpy()
    return moved
