"""Scores of a row clip by clip: meshes from true landmarks, from speech, or landmarks from speech."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from tqdm import tqdm

from freetalk import metrics
from freetalk.data import Dataset, FaceMesh, MotionSequence
from freetalk.evaluate.dataset_truth import origin_of
from freetalk.evaluate.facetalk import SpeechToCodes
from freetalk.evaluate.masks import landmark_masks
from freetalk.evaluate.metric_specs import spec_of
from freetalk.evaluate.motion_files import Origin
from freetalk.evaluate.pretrained import LandmarksToMesh, SpeechToMotion
from freetalk.tables.views import faces_of
from freetalk.train.initial import named_encoder

FloatArray = npt.NDArray[np.float32]
Masks = Mapping[str, torch.Tensor]

#: How much the error of neighbouring vertices of the lips differs: what makes a surface look noisy.
ROUGHNESS = "roughness"
#: How far codes that are generated for the same speech lie apart [FaceTalk Eq. 20]; more is better.
DIVERSITY = "diversity"
_OWN = {ROUGHNESS: ("mm", "frames"), DIVERSITY: ("1", "sequences")}
#: Samples of a clip that :data:`DIVERSITY` compares.
_SAMPLES = 4


@dataclass
class ClipScores:
    """Values of clips on one dataset, in printed units.

    Attributes:
        values: metric, clip to value.
        frames: clip to its length, the weight in a mean over frames.
        origins: clip to speaker and take, which clips have in common.
    """

    values: dict[str, dict[str, float]] = field(default_factory=dict)
    frames: dict[str, int] = field(default_factory=dict)
    origins: dict[str, Origin] = field(default_factory=dict)

    def add(self, clip: MotionSequence, frames: int, values: Mapping[str, float]) -> None:
        """Takes in the values of a clip."""
        self.frames[clip.id] = frames
        self.origins[clip.id] = origin_of(clip)
        for metric, value in values.items():
            self.values.setdefault(metric, {})[clip.id] = value

    def to_dict(self) -> dict[str, dict[str, object]]:
        """As stored."""
        return {
            "values": dict(self.values),
            "frames": dict(self.frames),
            "origins": dict(self.origins),
        }


def unit_of(metric: str) -> str:
    """Unit that a metric is printed in."""
    return _OWN[metric][0] if metric in _OWN else spec_of(metric).unit


def title_of(metric: str) -> str:
    """How tables call a metric."""
    return metric if metric in _OWN else spec_of(metric).title


def pooling_of(metric: str) -> str:
    """What a test set's number is the mean over: ``frames`` or ``sequences``."""
    return _OWN[metric][1] if metric in _OWN else spec_of(metric).pooling


def values_of(
    guess: torch.Tensor, true: torch.Tensor, names: Sequence[str], masks: Masks
) -> dict[str, float]:
    """Metrics of one clip, displacements (T, V, 3) m; a mask that is empty has no value."""
    found = {}
    for name in names:
        if name == ROUGHNESS:
            found[name] = roughness(guess, true, masks["edges"])
            continue
        spec = spec_of(name)
        mask = None if spec.mask == "all" else masks[spec.mask]
        value = metrics.vertex_metric(spec.name, guess, true, vertices=mask).item()
        if np.isfinite(value):
            found[name] = spec.factor * value
    return found


def roughness(guess: torch.Tensor, true: torch.Tensor, edges: torch.Tensor) -> float:
    """mean_t mean_(i,j) | (d_ti - d'_ti) - (d_tj - d'_tj) | over edges (i, j) of the lips, mm.

    Args:
        guess: (T, V, 3) displacements, m.
        true: (T, V, 3).
        edges: (E, 2) vertices.
    """
    error = guess - true
    steps = error[:, edges[:, 0]] - error[:, edges[:, 1]]
    return 1000 * float(steps.norm(dim=-1).mean())


def lip_edges(faces: npt.NDArray[np.int64], lips: npt.NDArray[np.bool_]) -> torch.Tensor:
    """Edges with both ends in the mask, each once, (E, 2)."""
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    pairs = np.unique(np.sort(pairs[lips[pairs].all(axis=1)], axis=1), axis=0)
    return torch.from_numpy(pairs)


def still_face(view: Dataset, names: Sequence[str], on_landmarks: bool) -> ClipScores:
    """Scores of a face that does not move, which numbers are read against."""
    scores = ClipScores()
    names = [name for name in names if name != DIVERSITY]
    for clip, identity, topology in faces_of(view, "test"):
        if on_landmarks:
            masks, true = _landmark_masks(), torch.from_numpy(view.landmarks(clip))
        else:
            masks = face_masks(view.mesh(identity, topology))
            true = torch.from_numpy(view.vertex_displacements(topology, clip))
        scores.add(clip, len(true), values_of(torch.zeros_like(true), true, names, masks))
    return scores


def face_masks(mesh: FaceMesh) -> Masks:
    """Vertices of lips and upper face, and edges of the lips."""
    return {
        "lips": torch.from_numpy(np.flatnonzero(mesh.lip_mask)),
        "upper": torch.from_numpy(np.flatnonzero(mesh.upper_face_mask)),
        "edges": lip_edges(mesh.faces, mesh.lip_mask),
    }


def _landmark_masks() -> Masks:
    return {name: torch.from_numpy(mask.indices) for name, mask in landmark_masks().items()}


def mesh_scores(
    model: LandmarksToMesh,
    view: Dataset,
    names: Sequence[str],
    landmarks: Callable[[MotionSequence], FloatArray],
) -> ClipScores:
    """Scores of the test clips moved by the given landmarks, (T, 68, 3) m at the view's rate."""
    scores = ClipScores()
    masks: dict[tuple[int, str], Masks] = {}
    for clip, identity, topology in tqdm(
        faces_of(view, "test"), desc=f"score {view.name}", leave=False
    ):
        face = identity, topology
        if face not in masks:
            masks[face] = face_masks(view.mesh(identity, topology))
        guess = model.vertices(view, identity, topology, landmarks(clip))
        true = torch.from_numpy(view.vertex_displacements(topology, clip, 0, len(guess)))
        length = min(len(guess), len(true))
        scores.add(clip, length, values_of(guess[:length], true[:length], names, masks[face]))
    return scores


def landmark_scores(
    view: Dataset, names: Sequence[str], landmarks: Callable[[MotionSequence], FloatArray]
) -> ClipScores:
    """Scores of landmarks, (T, 68, 3) m at the view's rate, on the test clips."""
    masks = _landmark_masks()
    scores = ClipScores()
    for clip in view.sequences("test"):
        guess = torch.from_numpy(landmarks(clip))
        true = torch.from_numpy(view.landmarks(clip, 0, len(guess)))
        length = min(len(guess), len(true))
        scores.add(clip, length, values_of(guess[:length], true[:length], names, masks))
    return scores


def code_scores(model: SpeechToCodes, view: Dataset, names: Sequence[str]) -> ClipScores:
    """Scores of the landmarks that the codes of the test clips move, and of how codes vary from seed to seed."""
    on_landmarks = [name for name in names if name != DIVERSITY]
    made = spoken(model, view)
    scores = landmark_scores(view, on_landmarks, lambda clip: made[clip.id])
    if DIVERSITY in names:
        values = scores.values.setdefault(DIVERSITY, {})
        for clip in tqdm(view.sequences("test"), desc=f"vary {view.name}", leave=False):
            codes = model.codes(model.heard(view, clip), range(_SAMPLES))
            values[clip.id] = float(metrics.diversity(codes[None])[0])
    return scores


def spoken(model: SpeechToMotion | SpeechToCodes, view: Dataset) -> dict[str, FloatArray]:
    """Landmarks (T, 68, 3) m of the test clips from their sound, each with a seed of its own."""
    clips = view.sequences("test")
    made = model.perform(view, clips, [[seed] for seed in range(len(clips))])
    return {
        clip.id: motion[0]
        for clip, motion in tqdm(made, desc=f"speak {view.name}", total=len(clips), leave=False)
    }


def encoder_folder(given: str) -> Path:
    """Folder of the speech encoder, given as a folder or a name; the shipped one where none is given."""
    return named_encoder(given or "open-small")
