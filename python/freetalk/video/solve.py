"""Pose and bounded expression weights of every frame, from points in the image [Gauss-Newton, batched over frames].

Frame t sees the points ``p = s R (neutral + w . basis) + shift`` (scaled orthography). Its unknowns x_t are three
rotations, the logarithm of the scale, the shift and the weights w in [0, 1]. One step of Gauss-Newton solves

    (H + q D'D) dx = g,    H = blockdiag(J'WJ + ridge),    D = second differences in time

for all frames at once (:mod:`freetalk.data.bounded_steps`). W are the weights of an iteratively
reweighted Geman-McClure loss, so that a few lost points do not move the face.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from freetalk.data.bounded_steps import (
    POSE,
    bounded_step,
    second_differences,
    turn_angles,
    turned,
)

#: Width of the robust loss in each step: wide at first, as nothing is known of the mouth.
_WIDTHS = (8.0, 3.0, 1.0, 1.0)


@dataclass(frozen=True)
class SolveOptions:
    """What the solver trusts.

    Attributes:
        outlier_px: residual from which a point counts less.
        ridge_px: pull of the weights to zero, pixels at weight one.
        smooth_px: penalty on the weights' second differences, pixels at one weight per frame squared.
        pose_smooth: the same on rotation (radians), log scale and shift (tenths of a metre), times 100.
        pair_weight: how much more a distance between two points counts than the points.
        depth_weight: what the tracker's depth counts beside the image; 0 leaves it out.
    """

    outlier_px: float = 4.0
    ridge_px: float = 1.5
    smooth_px: float = 15.0
    pose_smooth: float = 3.0
    pair_weight: float = 3.0
    depth_weight: float = 0.15


@dataclass(frozen=True)
class FaceBasis:
    """The linear face of one talker at the tracked points.

    Attributes:
        neutral: (P, 3) float, m.
        basis: (E, P, 3) float, m.
        depth_bias: (P,) what the tracker's depth differs by from ``neutral``, m.
        point_weights: (P,) trust in each point.
        pairs: (K, 2) points whose distance matters (lips, lids, corners).
    """

    neutral: Tensor
    basis: Tensor
    depth_bias: Tensor
    point_weights: Tensor
    pairs: Tensor


@dataclass(frozen=True)
class Poses:
    """Scaled orthographic cameras of T frames: rotation (T, 3, 3), scale (T,) px / m, shift (T, 2) px."""

    rotation: Tensor
    scale: Tensor
    shift: Tensor


def initial_poses(points: Tensor, neutral: Tensor, weights: Tensor) -> Poses:
    """Similarity that takes neutral points nearest to the tracked ones (Umeyama), depth included.

    Args:
        points: (T, P, 3) px, +Y up, +Z towards the camera.
        neutral: (P, 3) m.
        weights: (P,) trust.
    """
    share = weights / weights.sum()
    centre, origin = (points * share[:, None]).sum(1), (neutral * share[:, None]).sum(0)
    target, source = points - centre[:, None], neutral - origin
    covariance = torch.einsum("p,tpi,pj->tij", share, target, source)
    u, singular, v = torch.linalg.svd(covariance)
    sign = torch.ones_like(singular)
    sign[:, 2] = torch.sign(torch.linalg.det(u) * torch.linalg.det(v))
    rotation = (u * sign[:, None]) @ v
    scale = (singular * sign).sum(1) / (share[:, None] * source.square()).sum()
    shift = centre - scale[:, None] * (rotation @ origin)
    return Poses(rotation, scale, shift[:, :2])


def canonical(points: Tensor, poses: Poses) -> Tensor:
    """Tracked points (T, P, 3) px in the face's own frame, m; depth is measured from the points' mean."""
    flat = points.clone()
    flat[..., :2] -= poses.shift[:, None]
    flat[..., 2] -= flat[..., 2].mean(1, keepdim=True)
    return torch.einsum("tji,tpj->tpi", poses.rotation, flat) / poses.scale[:, None, None]


def project(shape: Tensor, poses: Poses) -> Tensor:
    """Points (T, P, 3) of the face in the image and their depth, (T, P, 3) px."""
    seen = poses.scale[:, None, None] * torch.einsum("tij,tpj->tpi", poses.rotation, shape)
    return torch.cat([seen[..., :2] + poses.shift[:, None], seen[..., 2:]], -1)


def solve(
    points: Tensor, first: Tensor, face: FaceBasis, start: Poses, options: SolveOptions
) -> tuple[Tensor, Poses]:
    """Pose and weights of every frame.

    Args:
        points: (T, P, 3) px, +Y up, +Z towards the camera; clips one after another.
        first: (T,) bool, the first frame of each clip.
        face: the talker.
        start: first guess of the poses.
        options: what to trust.

    Returns:
        weights (T, E) in [0, 1], and poses.
    """
    frames, expressions = len(points), len(face.basis)
    weights = points.new_zeros(frames, expressions)
    inner = ~(first[1:-1] | first[2:])  # differences over three frames of one clip
    poses, size = start, start.scale.median() * 0.1  # px of a tenth of a metre
    ridge = options.ridge_px**2
    smooth = torch.cat(
        [
            (100 * options.pose_smooth) ** 2 * torch.ones(4).to(points),
            (100 * options.pose_smooth / size) ** 2 * torch.ones(2).to(points),
            options.smooth_px**2 * torch.ones(expressions).to(points),
        ]
    )
    residual = _residuals(points, weights, poses, face)
    for width in _WIDTHS:
        jacobian = _jacobian(weights, poses, face)
        rows, wanted, trust = _equations(jacobian, residual, face, options, width)
        weighted = (rows * trust[..., None]).mT
        normal, gradient = weighted @ rows, (weighted @ wanted[..., None])[..., 0]
        state = torch.cat([_pose_state(poses), weights], 1)
        gradient[:, POSE:] -= ridge * weights
        normal.diagonal(dim1=1, dim2=2)[:, POSE:] += ridge
        normal.diagonal(dim1=1, dim2=2).add_(1e-4)
        gradient -= smooth * second_differences(state, inner)
        change = bounded_step(normal, gradient, weights, smooth, inner)
        weights = (weights + change[:, POSE:]).clamp(0, 1)
        poses = _moved(poses, change[:, :POSE])
        residual = _residuals(points, weights, poses, face)
    return weights, poses


def _residuals(points: Tensor, weights: Tensor, poses: Poses, face: FaceBasis) -> Tensor:
    """(T, P, 3) tracked minus projected points, px; depth relative to its mean."""
    shape = face.neutral + torch.einsum("te,epi->tpi", weights, face.basis)
    apart = points - project(shape, poses)
    depth = apart[..., 2] - poses.scale[:, None] * face.depth_bias
    return torch.cat([apart[..., :2], (depth - depth.mean(1, keepdim=True))[..., None]], -1)


def _jacobian(weights: Tensor, poses: Poses, face: FaceBasis) -> Tensor:
    """(T, P, 3, 6 + E): rotation about the camera's axes, log scale, shift, weights."""
    shape = face.neutral + torch.einsum("te,epi->tpi", weights, face.basis)
    scaled = poses.scale[:, None, None] * poses.rotation
    seen = torch.einsum("tij,tpj->tpi", scaled, shape)
    x, y, z = seen.unbind(-1)
    zero, one = torch.zeros_like(x), torch.ones_like(x)
    turns = torch.stack(
        [
            torch.stack([zero, -z, y], -1),
            torch.stack([z, zero, -x], -1),
            torch.stack([-y, x, zero], -1),
            seen,
            torch.stack([one, zero, zero], -1),
            torch.stack([zero, one, zero], -1),
        ],
        -1,
    )
    moved = torch.einsum("tij,epj->tpie", scaled, face.basis)
    return torch.cat([turns, moved], -1)


def _equations(
    jacobian: Tensor, residual: Tensor, face: FaceBasis, options: SolveOptions, width: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Rows (T, R, X), what they should give (T, R) and their trust (T, R)."""
    error = residual[..., :2].square().sum(-1)
    robust = face.point_weights / (1 + error / (width * options.outlier_px) ** 2).square()
    left, right = face.pairs.unbind(1)
    apart = jacobian[:, left, :2] - jacobian[:, right, :2]
    distance = residual[:, left, :2] - residual[:, right, :2]
    held = options.pair_weight * torch.minimum(robust[:, left], robust[:, right])
    rows = [jacobian[:, :, :2].flatten(1, 2), apart.flatten(1, 2)]
    wanted = [residual[..., :2].flatten(1, 2), distance.flatten(1, 2)]
    trust = [robust.repeat_interleave(2, 1), held.repeat_interleave(2, 1)]
    if options.depth_weight > 0:
        depth = jacobian[:, :, 2]
        rows.append(depth - depth.mean(1, keepdim=True))
        wanted.append(residual[..., 2])
        trust.append(options.depth_weight**2 * robust)
    return torch.cat(rows, 1), torch.cat(wanted, 1), torch.cat(trust, 1)


def _pose_state(poses: Poses) -> Tensor:
    """(T, 6) poses as numbers whose second differences are those of the poses: they vary little."""
    angles = turn_angles(poses.rotation)
    return torch.cat([angles, poses.scale.log()[:, None], poses.shift], 1)


def _moved(poses: Poses, change: Tensor) -> Poses:
    return Poses(
        turned(poses.rotation, change[:, :3]),
        poses.scale * change[:, 3].exp(),
        poses.shift + change[:, 4:6],
    )
