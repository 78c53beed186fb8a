"""Motion of the face model from tracked points: one identity and camera a talker, weights and pose a frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freetalk.corpus.assets import FaceModel, load_face_model
from freetalk.corpus.lips import Lips
from freetalk.video.points import PAIRS, point_weights, rigid_weights
from freetalk.video.solve import (
    FaceBasis,
    Poses,
    SolveOptions,
    canonical,
    initial_poses,
    project,
    solve,
)
from freetalk.video.tracks import FaceTrack

FloatArray = npt.NDArray[np.float32]

_UPPER, _LOWER = 62, 66
_CHUNK_FRAMES = 3000
_REST_SHARE = 0.15
_IDENTITY_RIDGE_M = 0.002
_ROUNDS = 3
#: Gaps that exceed that of resting lips by less are closed lips.
_CLOSED_MARGIN_M = 0.0006
#: Opening of lips that count as closed.
CLOSED_M = 0.0006
#: A frame whose points lie further off than this, at 70 px between the outer corners of the eyes, is left out.
_LOST_PX = 4.0
_STANDARD_PX = 70.0
#: Expressions that landmarks cannot tell: they stay at rest.
_UNSEEN = ("eyeLook", "tongue", "cheekPuff", "jawForward")


@dataclass(frozen=True, kw_only=True)
class _Fitted:
    """What was fitted to T frames.

    Attributes:
        weights: (T, E) expression weights in [0, 1] of the face model.
        landmarks: (T, 68, 3) displacements from the talker's rest, m, canonical frame.
        rotation: (T, 3, 3) head to camera.
        shift: (T, 3) head's place in m, relative to the clip's mean; depth, from the apparent size, in parts of
            the distance.
        error_px: (T,) mean reprojection error at 70 px between the outer corners of the eyes.
        projected: (T, 68, 2) the fitted landmarks in the image, px as the track's.
        gap: (T,) the tracker's inner-lip gap beyond that of closed lips, m.
        width: (T,) the tracker's width of the mouth, m.
    """

    weights: FloatArray
    landmarks: FloatArray
    rotation: FloatArray
    shift: FloatArray
    error_px: FloatArray
    projected: FloatArray
    gap: FloatArray
    width: FloatArray

    def part(self, start: int, stop: int) -> _Fitted:
        """Frames [start, stop)."""
        return _Fitted(**{f.name: getattr(self, f.name)[start:stop] for f in fields(self)})


@dataclass(frozen=True, kw_only=True)
class FittedClip(_Fitted):
    """Motion of one clip; frames without a face are filled from their neighbours.

    Attributes:
        track: what it was fitted to.
        good: (T,) bool, found and not lost.
    """

    track: FaceTrack
    good: npt.NDArray[np.bool_]


@dataclass(frozen=True)
class FittedTalker:
    """A talker's face and clips.

    Attributes:
        name: of the talker.
        neutral: (68, 3) landmarks at rest, m, canonical frame.
        identity: (100,) coefficients of the face model.
        closed_gap_m: the tracker's gap of closed lips.
        clips: in the order given.
    """

    name: str
    neutral: FloatArray
    identity: FloatArray
    closed_gap_m: float
    clips: list[FittedClip] = field(default_factory=list)


def fit_talker(tracks: Sequence[FaceTrack], options: SolveOptions | None = None) -> FittedTalker:
    """Fits the clips of one talker.

    Args:
        tracks: clips that show one face.
        options: what the solver trusts.

    Raises:
        ValueError: fewer than ten frames with a face.
    """
    options, model = options or SolveOptions(), load_face_model()
    points = torch.from_numpy(np.concatenate([t.points[t.found] for t in tracks]))
    if len(points) < 10:
        raise ValueError(f"{tracks[0].talker}: {len(points)} frames with a face; 10 are needed")
    corners = (points[:, 36, :2] - points[:, 45, :2]).numpy()
    unit = float(np.median(np.linalg.norm(corners, axis=-1))) / _STANDARD_PX
    points = points / unit
    mean = torch.from_numpy(model.neutral[model.landmarks68])
    rest = _resting(points)
    neutral, identity, poses = mean, np.zeros(0, np.float32), None
    rigid = torch.from_numpy(rigid_weights()).float()
    for _ in range(_ROUNDS):
        poses = initial_poses(points, neutral, rigid)
        seen = canonical(points, poses)[rest].median(dim=0).values
        seen = seen - (seen - neutral).mul(rigid[:, None]).sum(0) / rigid.sum()
        identity = _identity(model, seen.numpy())
        shape = _shape(model, identity)
        neutral = torch.stack([seen[:, 0], seen[:, 1], shape[:, 2]], 1)
    assert poses is not None
    seen_by_landmarks = [not name.startswith(_UNSEEN) for name in model.expression_names]
    face = FaceBasis(
        neutral=neutral,
        basis=torch.from_numpy(model.landmark_basis[seen_by_landmarks]),
        depth_bias=seen[:, 2] - neutral[:, 2],
        point_weights=torch.from_numpy(point_weights()).float(),
        pairs=torch.tensor(PAIRS),
    )
    lengths = [int(t.found.sum()) for t in tracks]
    told, poses = _solved(points, lengths, face, poses, options)
    weights = np.zeros((len(points), len(model.expression_names)), np.float32)
    weights[:, seen_by_landmarks] = told.numpy()
    gap, width = _measured(points, poses)
    closed = float(gap[rest].median()) + _CLOSED_MARGIN_M
    target = (gap - closed).clamp_min(0).numpy()
    edited = _with_lips(model, weights, target)
    moved = torch.from_numpy(np.tensordot(edited, model.landmark_basis, 1))
    flat = project(neutral + moved, poses)[..., :2]
    fitted = _Fitted(
        weights=edited,
        landmarks=moved.numpy(),
        rotation=poses.rotation.numpy(),
        shift=_place(poses).numpy(),
        error_px=(points[..., :2] - flat).norm(dim=-1).mean(1).numpy(),
        projected=(unit * flat).numpy(),
        gap=target,
        width=width.numpy(),
    )
    centred = (neutral - neutral.mean(0)).numpy().astype(np.float32)
    result = FittedTalker(tracks[0].talker, centred, identity, closed)
    stops = np.cumsum(lengths)
    for track, start, stop in zip(tracks, stops - lengths, stops, strict=True):
        result.clips.append(_clip(track, fitted.part(start, stop)))
    return result


def _solved(
    points: Tensor, lengths: list[int], face: FaceBasis, poses: Poses, options: SolveOptions
) -> tuple[Tensor, Poses]:
    """Clips solved in chunks, which bound the memory."""
    done: list[tuple[Tensor, Poses]] = []
    start, stop, firsts = 0, 0, [0]
    for number, length in enumerate(lengths):
        stop += length
        if stop - start >= _CHUNK_FRAMES or number + 1 == len(lengths):
            first = torch.zeros(stop - start, dtype=torch.bool)
            first[[f - start for f in firsts if f < stop]] = True
            part = slice(start, stop)
            own = Poses(poses.rotation[part], poses.scale[part], poses.shift[part])
            done.append(solve(points[part], first, face, own, options))
            start, firsts = stop, []
        firsts.append(stop)
    weights, cameras = zip(*done, strict=True)
    joined = Poses(
        torch.cat([c.rotation for c in cameras]),
        torch.cat([c.scale for c in cameras]),
        torch.cat([c.shift for c in cameras]),
    )
    return torch.cat(weights), joined


def _resting(points: Tensor) -> Tensor:
    """(T,) bool: the frames whose lips are nearest to one another."""
    gap = points[:, _UPPER, 1] - points[:, _LOWER, 1]
    return gap <= float(np.quantile(gap.numpy(), _REST_SHARE))


def _identity(model: FaceModel, seen: FloatArray) -> FloatArray:
    """(100,) coefficients nearest to the resting landmarks (68, 3), height and width before depth."""
    basis = model.identity_basis[:, model.landmarks68].astype(np.float64)
    trust = np.sqrt(np.maximum(rigid_weights(), point_weights()))[:, None] * np.array(
        [1.0, 1.0, 0.3]
    )
    rows = (basis * trust).reshape(len(basis), -1).T
    wanted = ((seen - model.neutral[model.landmarks68]) * trust).ravel()
    normal = rows.T @ rows + _IDENTITY_RIDGE_M**2 * np.eye(len(basis))
    return np.linalg.solve(normal, rows.T @ wanted).astype(np.float32)


def _shape(model: FaceModel, identity: FloatArray) -> Tensor:
    moved = np.tensordot(identity, model.identity_basis[:, model.landmarks68], 1)
    return torch.from_numpy((model.neutral[model.landmarks68] + moved).astype(np.float32))


def _measured(points: Tensor, poses: Poses) -> tuple[Tensor, Tensor]:
    """The tracker's inner-lip gap along the face's vertical and its mouth width, (T,) m each."""
    up = poses.rotation[:, :2, 1]  # the face's vertical in the image
    across = poses.rotation[:, :2, 0]

    def along(direction: Tensor, a: int, b: int) -> Tensor:
        length = direction.norm(dim=-1)
        apart = ((points[:, a, :2] - points[:, b, :2]) * direction).sum(-1)
        return apart / (poses.scale * length.square())

    return along(up, _UPPER, _LOWER), along(across, 54, 48)


def _with_lips(model: FaceModel, weights: FloatArray, target: FloatArray) -> FloatArray:
    """Weights whose lips are as far apart as the tracker's, and closed where the tracker's are."""
    lips = Lips(model)
    return np.clip(lips.without_interpenetration(lips.set_opening(weights, target)), 0, 1)


def _place(poses: Poses) -> Tensor:
    """(T, 3) where the head is, m: across the image as its points, in depth as its size."""
    distance = 1 / poses.scale
    return torch.cat(
        [poses.shift / poses.scale[:, None], -(distance / distance.mean())[:, None]], 1
    )


def _clip(track: FaceTrack, known: _Fitted) -> FittedClip:
    """A clip of the frames in which a face was found; the others are filled from their neighbours."""
    frames, at = np.arange(len(track.points)), np.flatnonzero(track.found)

    def filled(values: FloatArray) -> FloatArray:
        if len(at) == len(frames):
            return values.astype(np.float32)
        columns = [np.interp(frames, at, column) for column in values.reshape(len(at), -1).T]
        return np.stack(columns, 1).reshape(len(frames), *values.shape[1:]).astype(np.float32)

    nearest = np.searchsorted((at[1:] + at[:-1]) / 2, frames)
    values = {f.name: filled(getattr(known, f.name)) for f in fields(known)}
    values["rotation"] = known.rotation[nearest]
    values["shift"] = values["shift"] - values["shift"].mean(0)
    return FittedClip(track=track, good=track.found & (values["error_px"] < _LOST_PX), **values)
