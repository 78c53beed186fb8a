"""What a moving surface says about the face: where its 68 landmarks are, and ARKit's weights over time."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from freetalk._pretrained import PRETRAINED
from freetalk.corpus.linear_face import built_in_face
from freetalk.data.landmark_transfer import propose_landmarks
from freetalk.rig import FaceRig
from freetalk.viz.sequence import Sequence

_POSES = PRETRAINED / "open-small" / "rig_poses.safetensors"


def find_landmarks(sequence: Sequence) -> NDArray[np.int64] | None:
    """The vertices under the 68 landmarks of an aligned face.

    Returns:
        (68,) in iBUG order; None where the animation does not say how its mesh lies, or it is no whole face.
    """
    if not sequence.located:
        return None
    try:
        proposed = propose_landmarks(
            sequence.upright(sequence.vertices), sequence.faces.astype(np.int32), built_in_face()
        )
    except (ValueError, ModuleNotFoundError):  # no face, or no SciPy to look for one with
        return None
    return proposed.indices


def arkit_curves(
    sequence: Sequence, landmarks: NDArray[np.integer[Any]]
) -> dict[str, NDArray[Any]]:
    """ARKit's weights that explain the motion of the landmarks.

    Args:
        sequence: the animation.
        landmarks: (68,) vertices.

    Returns:
        (T,) float32 in [0, 1] by name; empty where no weights with poses are installed.
    """
    turn = sequence.upright_matrix[:3, :3].T.astype(np.float32)
    motion = sequence.displacements[:, np.asarray(landmarks)] @ turn
    return landmark_curves(torch.from_numpy(np.ascontiguousarray(motion)))


def landmark_curves(motion: torch.Tensor) -> dict[str, NDArray[Any]]:
    """ARKit's weights that explain landmark motion.

    Args:
        motion: (T, 68, 3) float32 displacements, metres, canonical frame.

    Returns:
        As :func:`arkit_curves`.
    """
    if not _POSES.is_file():
        return {}
    rig = _landmark_rig()
    return rig.curves(rig.solve(motion))


@lru_cache(maxsize=1)
def _landmark_rig() -> FaceRig:
    """A rig whose surface is the landmarks themselves: solving asks for no more."""
    return FaceRig.build(lambda landmarks: landmarks, _POSES, num_poses=1, max_correctives=1)
