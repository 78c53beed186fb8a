"""Codes of a parametric head for every frame of a packed corpus: what FaceTalk's denoiser learns to speak.

A head that was trained on the built-in face knows the code of any expression weights. Frames of captured speech are
fitted to the posed face from there on [FaceTalk Eq. 16-19, by Gauss-Newton], so that their codes show what the head
itself can show; frames that are synthetic anyway keep the code of their weights.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from freetalk._progress import progress_bar
from freetalk.corpus.heads import HeadModel, PosedHead, head_model
from freetalk.data import Dataset, MotionSequence, open_dataset
from freetalk.data.codes import write_codes
from freetalk.data.pack import FloatArray
from freetalk.head import FitOptions, ParametricHead, PreparedHead, content_hash, fit_expressions

CAPTURED = ("facegood",)
"""Sources whose motion was captured."""

_CHUNK = 240  # frames that are fitted together
_MILLIMETRES = 1e3


@dataclass(frozen=True)
class CodesReport:
    """How near the codes' surfaces come to the posed faces, mean distance of the head's own field, mm.

    Attributes:
        frames: of the corpus.
        fitted: those of captured takes.
        rig_mm: of the fitted frames by the codes of their weights.
        fitted_mm: after the fit.
    """

    frames: int
    fitted: int
    rig_mm: float
    fitted_mm: float


def make_codes(
    head: ParametricHead,
    directory: str | Path,
    *,
    fitted: tuple[str, ...] = CAPTURED,
    options: FitOptions | None = None,
    progress: bool | Callable[[float], None] | None = True,
) -> CodesReport:
    """Writes the codes of all frames into a packed corpus, beside its landmarks.

    Args:
        head: trained on the built-in face, see ``freetalk train head``.
        directory: the packed corpus.
        fitted: sources that are fitted; the others get the codes of their weights.
        options: of the fit.
        progress: a bar on a terminal, nothing, or a callback that is told the finished share.

    Raises:
        ValueError: the head names no expressions, or the corpus has some that the head lacks.
    """
    corpus = open_dataset(directory)
    names = list(head.options.expressions)
    strange = sorted(set(corpus.expressions) - set(names))
    if not names or not corpus.expressions or strange:
        raise ValueError(
            f"{directory}: its frames have no codes of this head, which knows "
            f"{len(names)} expressions{', not ' + ', '.join(strange) if strange else ''}"
        )
    columns = [names.index(name) for name in corpus.expressions]
    rig = head_model()
    pack = corpus.packs[corpus.name]
    rest = head.state_dict()["rest_expression"]
    codes = np.tile(rest.numpy(), (pack.landmarks.shape[0], 1))
    z_id = head.identity_code(torch.zeros((1, head.options.num_coefficients)))[0].detach()
    seen = outer_face(rig)
    rig_mm: list[FloatArray] = []
    fitted_mm: list[FloatArray] = []
    takes = {sequence.start_frame: sequence for sequence in corpus.sequences()}
    with progress_bar(progress, "codes") as bar:
        for number, sequence in enumerate(takes.values()):
            weights = _weights(corpus, sequence, columns, len(names))
            with torch.no_grad():
                own = head.expression_code(torch.from_numpy(weights))
            if sequence.source in fitted:
                for first in range(0, len(own), _CHUNK):
                    part = slice(first, first + _CHUNK)
                    points = [
                        rig.vertices(np.zeros(len(rig.identity_basis)), row)[seen].astype(
                            np.float32
                        )
                        for row in weights[part]
                    ]
                    rig_mm.append(distances_mm(head, z_id, own[part], points))
                    found = fit_expressions(head, z_id, points, prior=own[part], options=options)
                    fitted_mm.append(found.error_mm.numpy())
                    own[part] = found.z_exp
            start = sequence.start_frame
            codes[start : start + len(own)] = own.numpy()
            if bar is not None:
                bar((number + 1) / len(takes))
    write_codes(pack.directory, codes, content_hash(head), rest.numpy())
    count = sum(map(len, fitted_mm))
    means = [float(np.concatenate(of).mean()) if count else 0.0 for of in (rig_mm, fitted_mm)]
    return CodesReport(len(codes), count, *means)


def _weights(
    corpus: Dataset, sequence: MotionSequence, columns: list[int], count: int
) -> FloatArray:
    """(T, E) weights of a whole take, as the head has them."""
    stored, first = corpus.packs[sequence.dataset].motion, sequence.start_frame
    assert stored is not None  # it has expressions
    frames = stored.read(first, first + sequence.stored_frames)
    weights = np.zeros((len(frames), count), np.float32)
    weights[:, columns] = frames
    return weights


def outer_face(rig: HeadModel) -> np.ndarray:
    """Vertices of the face that are seen from outside while the mouth is open."""
    open_mouth = PosedHead(rig, np.zeros(len(rig.identity_basis)), rig.canonical_weights)
    outer = np.unique(open_mouth.faces[open_mouth.is_outer()])
    skin = outer[outer < len(rig.neutral)]
    return skin[rig.is_face[skin]]


def distances_mm(
    head: ParametricHead, z_id: torch.Tensor, codes: torch.Tensor, points: list[np.ndarray]
) -> FloatArray:
    """(T,) mean distance of each frame's points from the surface of its code, mm."""
    ready, unit = PreparedHead(head, z_id), head.options.units_per_metre
    found = [
        float(ready.sdf(unit * torch.from_numpy(own), code).abs().mean())
        for own, code in zip(points, codes, strict=True)
    ]
    return _MILLIMETRES / unit * np.array(found, np.float32)
