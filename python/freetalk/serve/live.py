"""A live stream for the page: samples in, weights of the face's rig out.

The page sends signed 16-bit mono samples at 16 kHz and, as text, ``{"emotion": ..., "intensity": ...}``. It gets, as text,
what the stream is like, then the moving surface once (a take whose targets are the rig's), then for every frame its
index (uint32), its moment of the speech in seconds (float32) and its weights (uint16, 65535 is 1), little-endian.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from freetalk.animation import Parts
from freetalk.corpus.assets import load_face_model
from freetalk.page.take import pack_rig
from freetalk.rig import FaceRig
from freetalk.talker import Face, LiveFrame
from freetalk.viz.sequence import Sequence

RATE_HZ = 16000
#: Longest message with samples: one second.
MOST_BYTES = 2 * RATE_HZ


def whole_mesh_targets(face: Face, rig: FaceRig) -> NDArray[np.float32]:
    """(W, V, 3) metres, canonical frame: the rig's targets with teeth, tongue and eyes that go with the skin."""
    pose = face.report.alignment.to_canonical
    model = load_face_model()
    rest = model.neutral[model.landmarks68].astype(np.float64)
    parts = Parts(pose.apply(np.asarray(face.mesh.vertices)), face.mesh.faces, rest)
    # Landmarks of a target: those of the skin's vertices nearest to them.
    skin = np.asarray(parts.face_vertices)
    nearest = [int(np.square(skin - mark).sum(axis=1).argmin()) for mark in rest]
    targets = rig.targets
    return parts.move(targets, targets[:, nearest].contiguous()).numpy()


def rig_take(face: Face, rig: FaceRig, name: str) -> bytes:
    """The surface of a live stream as the page reads it."""
    still = Sequence.at_rest(face.mesh, face.report.alignment.to_canonical, located=True)
    return pack_rig(still, whole_mesh_targets(face, rig), rig.names, name)


def samples_of(message: bytes) -> NDArray[np.float32]:
    """Samples of a message.

    Raises:
        ValueError: half a sample, or more than a second.
    """
    if len(message) % 2 or len(message) > MOST_BYTES:
        raise ValueError(f"send whole 16-bit samples, at most {RATE_HZ} at a time")
    return np.frombuffer(message, "<i2").astype(np.float32) / np.float32(32768)


def frame_message(frames: list[LiveFrame]) -> bytes:
    """Frames as the page reads them."""
    parts = []
    for frame in frames:
        weights: torch.Tensor | None = frame.weights
        assert weights is not None
        parts.append(struct.pack("<If", frame.index, frame.time_s))
        parts.append(np.rint(weights.numpy().clip(0, 1) * 65535).astype("<u2").tobytes())
    return b"".join(parts)


def stream_facts(live: Any, rig: FaceRig) -> dict[str, Any]:
    """What the page needs to know of a stream."""
    return {
        "fps": live.fps,
        "latency_s": live.latency_s,
        "weights": len(rig.names),
        "rate_hz": RATE_HZ,
    }
