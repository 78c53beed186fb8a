"""FaceTalk: speech features to the expression codes of a parametric head, or to expression weights, by diffusion."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch

from freetalk import _native
from freetalk._module import NativeModule

FaceTalkOptions = _native.facetalk.FaceTalkOptions
GenerateOptions = _native.facetalk.GenerateOptions


class FaceTalk(NativeModule):
    """The transformer denoiser G(x_t, t, A) -> x_0 over expression codes [FaceTalk, Aneja et al. 2024, Sec. 4].

    No frame sees a later one. Each hears the speech of its own moment alone, and what the diffusion step says by
    FiLM; ``options`` name the paper's other variants.

    Args:
        options: a ``FaceTalkOptions``, or its fields by keyword.
    """

    _impl_type = _native.facetalk.FaceTalkImpl
    _options_type = FaceTalkOptions
    _format = "freetalk-facetalk"

    def forward(
        self,
        x: torch.Tensor,
        timestep: torch.Tensor,
        *,
        audio: torch.Tensor,
        drop_audio: torch.Tensor | None = None,
        valid: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """The estimate of the clean codes.

        Args:
            x: (B, T, code_dim) noisy normalised codes.
            timestep: (B,) int64 diffusion step.
            audio: (B, T, C) speech features at the codes' frames, or landmark displacements (condition
                ``landmarks``, C = 204, m).
            drop_audio: (B,) bool, true where the audio is replaced by the learned null (guidance).
            valid: (B, T) bool, false on padding, which comes last; matters only where ``align_audio`` is off.

        Returns:
            (B, T, code_dim) normalised codes.

        Raises:
            ValueError: a shape does not fit, or T exceeds the learned positions; the message says which.
        """
        return self._impl.forward(x, timestep, audio=audio, drop_audio=drop_audio, valid=valid)

    def normalize(self, codes: torch.Tensor) -> torch.Tensor:
        """Codes (..., code_dim) to the normalised space of the diffusion."""
        return self._impl.normalize(codes)

    def denormalize(self, codes: torch.Tensor) -> torch.Tensor:
        """Normalised codes (..., code_dim) back to codes."""
        return self._impl.denormalize(codes)

    def set_code_statistics(
        self,
        *,
        mean: torch.Tensor,
        scale: torch.Tensor,
        rest: torch.Tensor,
        landmark_basis: torch.Tensor,
    ) -> None:
        """Sets the buffers of the normalisation, the code of the face at rest and what codes do to landmarks.

        Args:
            mean: (code_dim,).
            scale: (code_dim,), positive.
            rest: (code_dim,).
            landmark_basis: (code_dim, 204) m.
        """
        self._impl.set_code_statistics(
            mean=mean, scale=scale, rest=rest, landmark_basis=landmark_basis
        )

    def landmarks(self, codes: torch.Tensor) -> torch.Tensor:
        """Landmark displacements (..., 68, 3), m, of codes (..., code_dim), by the linear map of ``landmark_basis``.

        Exact for weights; least squares over the training data for codes of a head.
        """
        return self._impl.landmarks(codes)


def generate(
    model: FaceTalk,
    features: torch.Tensor,
    *,
    options: _native.facetalk.GenerateOptions | None = None,
    seed: int | Sequence[int] = 0,
    on_step: Callable[[int, int], None] | None = None,
) -> torch.Tensor:
    """Codes of any length from speech features, piece after piece: as no frame looks ahead, pieces give the whole.

    Args:
        model: in eval mode.
        features: (T, C) speech features, or landmarks, at ``model.options.fps``.
        options: sampler, steps, guidance, temperature, precision.
        seed: of the noise; the same seed gives the same codes, on the CPU bit for bit. K seeds give K motions,
            sampled together.
        on_step: called with (steps done, steps in all).

    Returns:
        (T, code_dim) float32 codes; (K, T, code_dim) for a sequence of K seeds.

    Raises:
        ValueError: a shape does not fit, or a value is out of range.
    """
    several = isinstance(seed, Sequence)
    codes = _native.facetalk.generate(
        model._plain_impl,
        features,
        options=options or GenerateOptions(),
        seeds=[int(one) for one in seed] if isinstance(seed, Sequence) else [int(seed)],
        on_step=on_step,
    )
    return codes if several else codes[0]


#: Iterations of the bounded fit; its error then falls by less than a hundredth of a millimetre.
_ITERATIONS = 200


@torch.no_grad()
def codes_from_landmarks(
    model: FaceTalk,
    landmarks: torch.Tensor,
    *,
    noise_mm: float = 0.3,
    smoothness: float = 0.0,
) -> torch.Tensor:
    """The likeliest codes of landmark motion, so that other systems' motion (ATS's, a tracker's) drives the head.

    Minimises ||l - landmarks(z)||^2 / noise^2 + ||(z - mean) / scale||^2 + smoothness ||(z_(t+1) - z_t) / scale||^2:
    as the map from codes to landmarks is linear, a Gauss-Newton step is exact. Weights stay in [0, 1], by
    projected gradients with momentum [Beck and Teboulle 2009].

    Args:
        model: whose codes; ``landmark_basis`` and statistics set, as training does.
        landmarks: (T, 68, 3) displacements, m.
        noise_mm: what landmarks are trusted to; larger keeps closer to usual codes.
        smoothness: of neighbouring frames, relative to the prior.

    Returns:
        (T, code_dim) codes.

    Raises:
        ValueError: landmarks are of another shape or not finite, or the model knows no landmarks.
    """
    names = ("landmark_basis", "rest_code", "code_mean", "code_scale")
    basis, rest, mean, scale = (model.get_buffer(name).double() for name in names)
    if landmarks.dim() != 3 or landmarks.shape[1:] != (68, 3):
        raise ValueError(f"expected landmarks (T, 68, 3), found {tuple(landmarks.shape)}")
    if not landmarks.isfinite().all() or not basis.any():
        raise ValueError("landmarks must be finite, and the model must know what codes do to them")
    moves = basis * scale[:, None] * (1000 / noise_mm)  # of codes in units of their scale
    wanted = landmarks.to(basis).flatten(1) * (1000 / noise_mm)
    offset = ((mean - rest) @ basis) * (1000 / noise_mm)
    square = moves @ moves.T + torch.eye(len(moves)).to(moves)
    right = (wanted - offset) @ moves.T  # (T, Z)
    bounds = None
    if model.options.codes == "weights":
        bounds = (-mean / scale, (1 - mean) / scale)
    codes = torch.linalg.solve(square, right.T).T
    if bounds is not None or smoothness > 0:
        codes = _descended(square, right, codes, bounds, smoothness)
    return (codes * scale + mean).float()


def _descended(
    square: torch.Tensor,
    right: torch.Tensor,
    start: torch.Tensor,
    bounds: tuple[torch.Tensor, torch.Tensor] | None,
    smoothness: float,
) -> torch.Tensor:
    """Minimises z' square z / 2 - right' z + smoothness / 2 sum |z_(t+1) - z_t|^2 within bounds."""
    step = 1 / (float(torch.linalg.matrix_norm(square, 2)) + 4 * smoothness)
    codes = ahead = start if bounds is None else start.clamp(*bounds)
    momentum = 1.0
    for _ in range(_ITERATIONS):
        gradient = ahead @ square - right
        if smoothness > 0:
            change = smoothness * ahead.diff(dim=0)
            gradient[1:] += change
            gradient[:-1] -= change
        moved = ahead - step * gradient
        if bounds is not None:
            moved = moved.clamp(*bounds)
        following = (1 + (1 + 4 * momentum**2) ** 0.5) / 2
        ahead = moved + (momentum - 1) / following * (moved - codes)
        codes, momentum = moved, following
    return codes


class CodeStream:
    """Codes while the speech is being heard, with no delay of their own.

    The frames are those of :func:`generate` with the same seed and options, however the features are divided over the
    calls. Memory does not grow.

    Args:
        model: in eval mode, with ``align_audio``; shared, not copied.
        options: as for :func:`generate`.
        seed: of the noise.

    Raises:
        ValueError: an option is out of range, or the model hears whole clips.
    """

    def __init__(
        self,
        model: FaceTalk,
        *,
        options: _native.facetalk.GenerateOptions | None = None,
        seed: int = 0,
    ) -> None:
        self._stream = _native.facetalk.CodeStream(
            model._plain_impl, seeds=[int(seed)], options=options or GenerateOptions()
        )

    def push(self, features: torch.Tensor) -> torch.Tensor:
        """Takes (n, C) features of the next frames; returns their codes, (n, code_dim)."""
        return self._stream.push(features)[0]

    def reset(self) -> None:
        """Starts afresh."""
        self._stream.reset()


__all__ = [
    "CodeStream",
    "FaceTalk",
    "FaceTalkOptions",
    "GenerateOptions",
    "codes_from_landmarks",
    "generate",
]
