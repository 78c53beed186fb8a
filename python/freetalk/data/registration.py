"""A linear face model fitted to scans: landmarks, then surfaces, all frames of a sequence together.

[FaceTalk, Aneja et al. 2024, supplement Eq. 21-31] fits FLAME to points of multi-view stereo by Adam: landmarks, distances
to points (0.1) and planes (0.9), squared shape and expression, changes in time. Here the same terms are solved by
Gauss-Newton, with three differences: a scan's point seeks its place on the model, so that what was not scanned asks for
nothing; distances count by Geman-McClure's loss, with a width that shrinks from stage to stage; changes in time are
second differences, which leave steady motion alone. One identity is sought for all frames: its equations are what is left
when the frames' own unknowns are eliminated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freetalk.data.bounded_steps import (
    POSE,
    bounded_step,
    held_weights,
    second_differences,
    turn_angles,
    turned,
    with_held,
)
from freetalk.data.expressive_faces import ExpressiveFace
from freetalk.data.triangles import closest_on_triangles
from freetalk.geometry import SurfaceTree

Points = npt.NDArray[np.float64]

_POINT_SHARE, _PLANE_SHARE = 0.1, 0.9  # Eq. 24
#: Neighbouring points see the same bumps: all of them together count as so many independent ones.
_INDEPENDENT = 300
#: How far off landmarks may be, m: jaw line, brows, nose, eyes, lips.
_LANDMARK_M = np.repeat([0.008, 0.004, 0.0025, 0.0015, 0.0015], [17, 10, 9, 12, 20])
#: Landmarks further off than this when the pose is sought do not count [supplement D].
_OUTLIER_M = 0.020
_LANDMARK_STEPS, _LEAST_LANDMARKS = 5, 12
#: Largest distance of a point from its place in each step, m: then half of it is the width of the robust loss.
_REACH_M = (0.02, 0.014, 0.01, 0.008, 0.006, 0.005, 0.004, 0.004, 0.004, 0.004)
_SMALLEST_COSINE, _LEAST_POINTS = 0.5, 20


@dataclass(frozen=True)
class Scan:
    """What is known of a face at a moment.

    Attributes:
        points: (P, 3) of its surface, m.
        normals: (P, 3) unit and outward, where known.
        landmarks: (68, 3) m, NaN where unknown; a sequence needs those of its first frame.
    """

    points: Points
    normals: Points | None = None
    landmarks: Points | None = None


@dataclass(frozen=True)
class RegisterOptions:
    """What the fit trusts.

    Attributes:
        points: drawn from each scan, anew in each step; 0 takes all.
        noise_m: spread of the points about the surface.
        identity_prior: weight of the squared coefficients, whose deviation is 1 [Eq. 25].
        expression_prior: weight of the squared weights, in units of their usual deviation [Eq. 26].
        smooth_expression: weight of their squared second differences, likewise [Eq. 29]; 0 for single scans.
        smooth_pose: the same of turns (0.01 radians) and shifts (1 mm) [Eq. 30].
    """

    points: int = 2000
    noise_m: float = 0.001
    identity_prior: float = 1.0
    expression_prior: float = 1.0
    smooth_expression: float = 3.0
    smooth_pose: float = 1.0


@dataclass(frozen=True)
class Registration:
    """A face model on scans.

    Attributes:
        identity: (K,) coefficients.
        weights: (T, E) of the expressions.
        rotation: (T, 3, 3) from the model's frame to the scans'.
        shift: (T, 3) m, likewise.
        vertices: (T, N, 3) m, registered meshes in the model's frame.
        error_mm: (T,) mean distance of the points that the model explains.
        explained: (T,) share of the points that lie within 4 mm of it.
    """

    identity: Points
    weights: Points
    rotation: Points
    shift: Points
    vertices: Points
    error_mm: Points
    explained: Points

    def canonical(self, points: npt.NDArray[Any], frame: int) -> Points:
        """Points (P, 3) of a scan in the model's frame."""
        return (np.asarray(points, np.float64) - self.shift[frame]) @ self.rotation[frame]


def register(
    scans: Sequence[Scan],
    face: ExpressiveFace,
    *,
    options: RegisterOptions | None = None,
    identity: npt.NDArray[Any] | None = None,
    seed: int = 0,
    on_step: Callable[[int, int], None] | None = None,
) -> Registration:
    """Fits one identity, and an expression and a pose a frame.

    Args:
        scans: T frames of one face.
        face: the model.
        options: what the fit trusts.
        identity: (K,) where it is known already.
        seed: of the points that are drawn.
        on_step: called with steps done and steps in all; may raise to stop.

    Raises:
        ValueError: no scan, numbers that are not finite, no landmarks in the first one, or a scan that is no face
            in this pose and unit.
    """
    if not scans:
        raise ValueError("there is no scan to register")
    for number, scan in enumerate(scans):
        if scan.points.ndim != 2 or scan.points.shape[1] != 3 or len(scan.points) < 100:
            raise ValueError(f"scan {number}: expected points (P, 3), found {scan.points.shape}")
        if not np.isfinite(scan.points).all():
            raise ValueError(f"scan {number} has points that are not finite")
    found = _Solver(list(scans), face, options or RegisterOptions(), identity, seed)
    steps = _LANDMARK_STEPS + len(_REACH_M)
    for step in range(steps):
        found.step(None if step < _LANDMARK_STEPS else _REACH_M[step - _LANDMARK_STEPS])
        if on_step is not None:
            on_step(step + 1, steps)
    return found.result()


class _Solver:
    def __init__(
        self,
        scans: list[Scan],
        face: ExpressiveFace,
        options: RegisterOptions,
        identity: npt.NDArray[Any] | None,
        seed: int,
    ) -> None:
        self.scans, self.face, self.options = scans, face, options
        self.known = identity is not None
        self.identity = np.zeros(len(face.identity_basis)) if identity is None else identity
        self.weights = np.zeros((len(scans), len(face.names)))
        self.rng = np.random.default_rng(seed)
        self.rotation, self.shift = _initial_poses(scans, face)
        inner = torch.ones(max(len(scans) - 2, 0), dtype=torch.bool)
        self.inner = inner
        smooth = np.full(POSE + len(face.names), options.smooth_expression / face.spread**2)
        smooth[:3], smooth[3:POSE] = options.smooth_pose / 0.01**2, options.smooth_pose / 0.001**2
        self.smooth = torch.from_numpy(smooth)

    def step(self, reach: float | None) -> None:
        """One step of Gauss-Newton; of landmarks alone where no reach is given."""
        posed = self.face.posed(self.identity, self.weights)
        systems = np.stack([self._system(t, posed[t], reach) for t in range(len(self.scans))])
        own, both, right, shared, wanted = self._parts(systems)
        smooth = self.smooth if len(self.scans) > 2 else torch.zeros_like(self.smooth)
        weights, spread = torch.from_numpy(self.weights), self.face.spread
        prior = self.options.expression_prior / spread**2
        own.diagonal(dim1=1, dim2=2)[:, POSE:] += prior
        own.diagonal(dim1=1, dim2=2)[:, :POSE] += 1e-3
        right[:, POSE:] -= prior * weights
        state = torch.cat([self._pose_state(), weights], 1)
        right -= smooth * second_differences(state, self.inner)
        if not self.known:
            held = with_held(own, held_weights(right, weights, self.face.bounds))
            held = held + torch.diag(6 * smooth)
            explained = torch.linalg.solve(held, torch.cat([both, right[..., None]], -1))
            kept = torch.einsum("txk,txy->ky", both, explained).numpy()
            shared, wanted = shared - kept[:, :-1], wanted - kept[:, -1]
            ridge = self.options.identity_prior
            shared = shared + ridge * np.eye(len(shared))
            change = np.linalg.solve(shared, wanted - ridge * self.identity)
            self.identity = self.identity + change
            right = right - both @ torch.from_numpy(change)
        moved = bounded_step(own, right, weights, smooth, self.inner, self.face.bounds)
        self.weights = (weights + moved[:, POSE:]).clamp(*self.face.bounds).numpy()
        self.rotation = turned(torch.from_numpy(self.rotation), moved[:, :3]).numpy()
        self.shift = self.shift + moved[:, 3:POSE].numpy()

    def result(self) -> Registration:
        posed = self.face.posed(self.identity, self.weights)
        error, explained = np.zeros(len(self.scans)), np.zeros(len(self.scans))
        for t, scan in enumerate(self.scans):
            placed = (scan.points - self.shift[t]) @ self.rotation[t]
            _, distance, triangle = SurfaceTree(posed[t], self._faces).nearest(placed)
            near = (distance < _REACH_M[-1]) & self.face.inner_faces[triangle]
            explained[t] = near.mean()
            error[t] = 1000 * distance[near].mean() if near.any() else np.inf
            if explained[t] < 0.02:
                raise ValueError(
                    f"scan {t} and the model hardly meet: is it a face, are its landmarks and its unit right?"
                )
        return Registration(
            identity=np.asarray(self.identity, np.float64),
            weights=self.weights,
            rotation=self.rotation,
            shift=self.shift,
            vertices=posed,
            error_mm=error,
            explained=explained,
        )

    @cached_property
    def _faces(self) -> npt.NDArray[np.int32]:
        return np.ascontiguousarray(self.face.faces, np.int32)

    def _pose_state(self) -> Tensor:
        turns = torch.from_numpy(self.rotation)
        return torch.cat([turn_angles(turns @ turns[0].T), torch.from_numpy(self.shift)], 1)

    def _parts(self, systems: Points) -> tuple[Tensor, Tensor, Tensor, Points, Points]:
        """Blocks of the frames, of frames with identity, right sides; the identity's own, summed."""
        frame = POSE + len(self.face.names)
        tensors = torch.from_numpy(systems)
        own, both = tensors[:, :frame, :frame].clone(), tensors[:, :frame, frame:-1]
        whole = systems.sum(axis=0)
        right = tensors[:, :frame, -1].clone()
        return own, both, right, whole[frame:-1, frame:-1], whole[frame:-1, -1]

    def _system(self, t: int, posed: Points, reach: float | None) -> Points:
        """(X + 1, X + 1) normal equations of a frame, X = 6 + E + K, with their right side as the last column.

        Of landmarks and, within reach, of the surface.
        """
        scan, face = self.scans[t], self.face
        basis = self._basis
        if face.moves_change:
            own = face.moves(self.identity, self.weights[t])
            basis = np.concatenate([_by_vertex(own), basis[:, :, len(own) :]], axis=2)
        size = POSE + basis.shape[2] + 1
        total = np.zeros((size, size))
        if scan.landmarks is not None:
            known = np.isfinite(scan.landmarks).all(axis=1)
            at, spread = np.asarray(face.landmarks)[known], _LANDMARK_M[known]
            apart = self._canonical(scan.landmarks[known], t) - posed[at]
            trust = _robust(np.linalg.norm(apart, axis=1), 2 * spread) / spread**2
            total += self._gram(
                t, posed[at], basis[at], apart, np.sqrt(trust)[:, None, None] * np.eye(3)
            )
        if reach is None:
            return total
        chosen = np.arange(len(scan.points))
        if 0 < self.options.points < len(chosen):
            chosen = self.rng.choice(len(chosen), self.options.points, replace=False)
        points = self._canonical(scan.points[chosen], t)
        nearest, distance, triangle = SurfaceTree(posed, self._faces).nearest(points)
        a, b, c = (posed[self._faces[triangle, k]] for k in range(3))
        normals = np.cross(b - a, c - a)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        kept = (distance < reach) & face.inner_faces[triangle]
        if scan.normals is not None:
            seen = scan.normals[chosen] @ self.rotation[t]
            kept &= (seen * normals).sum(axis=1) > _SMALLEST_COSINE
        if kept.sum() < _LEAST_POINTS:
            return total
        corners, nearest, normals = self._faces[triangle[kept]], nearest[kept], normals[kept]
        shares = closest_on_triangles(nearest, posed[corners])[0].astype(np.float32)
        moves = np.einsum("nkdx,nk->ndx", basis[corners], shares)
        trust = _robust(distance[kept], np.full(len(corners), reach / 2))
        trust = trust * min(1.0, _INDEPENDENT / len(chosen)) / self.options.noise_m**2
        along = normals[:, :, None] * normals[:, None]
        both = (
            np.sqrt(_POINT_SHARE) * (np.eye(3) - along) + along
        )  # its square: 0.1 point, 0.9 plane
        both *= np.sqrt(trust)[:, None, None]
        return total + self._gram(t, nearest, moves, points[kept] - nearest, both)

    @cached_property
    def _basis(self) -> npt.NDArray[np.float32]:
        """(N, 3, E + K) what weights and identity move."""
        own = self.face.moves(self.identity, self.weights[0])
        return np.concatenate([_by_vertex(own), _by_vertex(self.face.identity_basis)], axis=2)

    def _canonical(self, points: Points, t: int) -> Points:
        return (points - self.shift[t]) @ self.rotation[t]

    def _gram(
        self,
        t: int,
        places: Points,
        moves: npt.NDArray[np.float32],
        apart: Points,
        roots: Points,
    ) -> Points:
        """Equations that draw places (N, 3) of the model by what is apart (N, 3), weighed by roots (N, 3, 3)."""
        rows = np.zeros((len(apart), 3, POSE + moves.shape[2] + 1), np.float32)
        x, y, z = places.T
        cross = np.zeros((len(apart), 3, 3))  # omega x p, in the model's frame
        cross[:, 0, 1], cross[:, 0, 2] = z, -y
        cross[:, 1, 0], cross[:, 1, 2] = -z, x
        cross[:, 2, 0], cross[:, 2, 1] = y, -x
        rows[:, :, :3], rows[:, :, 3:POSE] = cross @ self.rotation[t].T, self.rotation[t].T
        rows[:, :, POSE:-1], rows[:, :, -1] = moves, apart
        flat = (roots.astype(np.float32) @ rows).reshape(-1, rows.shape[2])
        return (flat.T @ flat).astype(np.float64)


def _by_vertex(basis: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    """(N, 3, E) of (E, N, 3)."""
    return np.ascontiguousarray(np.asarray(basis, np.float32).transpose(1, 2, 0))


def _robust(distance: Points, width: Points) -> Points:
    """Geman-McClure's weights."""
    return 1 / np.square(1 + np.square(distance / width))


def _initial_poses(scans: list[Scan], face: ExpressiveFace) -> tuple[Points, Points]:
    """Rotations and shifts that bring the model's landmarks nearest; without landmarks, those of the frame before."""
    rotation, shift = np.zeros((len(scans), 3, 3)), np.zeros((len(scans), 3))
    for t, scan in enumerate(scans):
        marks = np.full((68, 3), np.nan) if scan.landmarks is None else scan.landmarks
        known = np.isfinite(marks).all(axis=1)
        if known.sum() < _LEAST_LANDMARKS:
            if t == 0:
                raise ValueError(
                    f"the first scan has {int(known.sum())} landmarks; {_LEAST_LANDMARKS} are needed to know "
                    "where the face is"
                )
            rotation[t], shift[t] = rotation[t - 1], shift[t - 1]
            continue
        source = np.asarray(face.neutral, np.float64)[np.asarray(face.landmarks)[known]]
        target = marks[known]
        kept: npt.NDArray[np.bool_] = np.ones(len(target), bool)
        for _ in range(3):
            rotation[t], shift[t] = _rigid(source[kept], target[kept])
            apart = np.linalg.norm(source @ rotation[t].T + shift[t] - target, axis=1)
            kept = apart < max(_OUTLIER_M, 1.5 * float(np.median(apart)))
    return rotation, shift


def _rigid(source: Points, target: Points) -> tuple[Points, Points]:
    """Rotation and shift that bring points (N, 3) nearest to others [Umeyama 1991]."""
    center, goal = source.mean(axis=0), target.mean(axis=0)
    u, _, vt = np.linalg.svd((target - goal).T @ (source - center))
    turn = (u * [1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return turn, goal - turn @ center
