"""The parametric head as a ``torch.nn.Module``."""

from __future__ import annotations

import torch

from freetalk import _native
from freetalk._module import NativeModule

HeadOptions = _native.head.HeadOptions
nphm_paper_options = _native.head.nphm_paper_options
nphm_small_options = _native.head.nphm_small_options


class ParametricHead(NativeModule):
    """A neural parametric head F(x, z_id, z_exp) = I(x + E(x, z_id, z_exp), z_id) [NPHM; FaceTalk Eq. 1].

    Parameters are named as in the public NPHM code below ``identity`` (``ensembled_deep_sdf.lin0-L``,
    ``mlp_pos.0|2|4``) and below ``deformation_backward`` and ``deformation_forward`` (``compressor.0``, ``defDeepSDF.lin0-L``);
    further ``identity_map`` and ``expression_map`` where the options have them. Buffers: ``identity.anchors``
    (K - 1, 3) mean anchors, ``rest_expression`` (E,) the code of the closed mouth, ``canonical_weights`` (W,)
    expression weights of the canonical face, ``identity_mean`` and ``identity_scale`` (D,).

    Args:
        options: a ``HeadOptions``, or its fields by keyword. ``nphm_small_options()`` is the head that ships,
            ``nphm_paper_options()`` the published NPHM.
    """

    _impl_type = _native.head.ParametricHeadImpl
    _options_type = HeadOptions
    _format = "freetalk-head"

    def forward(
        self, points: torch.Tensor, z_id: torch.Tensor, z_exp: torch.Tensor
    ) -> torch.Tensor:
        """Signed distances at posed points.

        Args:
            points: (B, N, 3) float, head units.
            z_id: (B, ``identity_dim``) identity codes.
            z_exp: (B, ``options.expression_dim``) expression codes; 0 is the canonical face.

        Returns:
            (B, N) head units, negative inside.

        Raises:
            ValueError: a shape does not fit; the message says which.
        """
        return self._impl.forward(points, z_id, z_exp)

    sdf = forward

    def canonical_sdf(
        self,
        points: torch.Tensor,
        z_id: torch.Tensor,
        *,
        z_exp: torch.Tensor | None = None,
        hyper: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """Signed distances (B, N) at canonical points (B, N, 3).

        Args:
            points: (B, N, 3) float, head units.
            z_id: (B, ``identity_dim``).
            z_exp: (B, ``expression_dim``) where ``options.identity_sees`` is ``expression``; None is 0.
            hyper: (B, N, ``hyper_dim``) where it is ``hyper``; None is 0.
        """
        return self._impl.canonical_sdf(points, z_id, z_exp=z_exp, hyper=hyper)

    def to_canonical(
        self, points: torch.Tensor, z_id: torch.Tensor, z_exp: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor | None]:
        """Posed points (B, N, 3) moved to canonical space.

        The backward network; a head that has none inverts the forward one by Broyden's method, with the gradients
        of the implicit function.

        Returns:
            (B, N, 3) points, and (B, N, ``hyper_dim``) further coordinates where the identity field sees them.
        """
        return self._impl.to_canonical(points, z_id, z_exp)

    def to_posed(
        self, points: torch.Tensor, z_id: torch.Tensor, z_exp: torch.Tensor
    ) -> torch.Tensor:
        """Canonical points (B, N, 3) moved to the posed face: the forward network, or the backward one inverted."""
        return self._impl.to_posed(points, z_id, z_exp)

    def anchors(self, z_id: torch.Tensor) -> torch.Tensor:
        """Anchors (B, ``num_anchors``, 3) of identities on the canonical face, head units."""
        return self._impl.anchors(z_id)

    def identity_code(self, coefficients: torch.Tensor) -> torch.Tensor:
        """z_id (B, D) of a face model's identity coefficients (B, ``num_coefficients``)."""
        return self._impl.identity_code(coefficients)

    def expression_code(self, weights: torch.Tensor) -> torch.Tensor:
        """z_exp (B, E) of expression weights (B, ``num_weights``); that of ``canonical_weights`` is 0."""
        return self._impl.expression_code(weights)

    def symmetry_distance(self, z_id: torch.Tensor) -> torch.Tensor:
        """The mean distance of the local codes of mirrored anchors, a scalar that NPHM's training keeps small."""
        return self._impl.symmetry_distance(z_id)

    def sample_identity(self, count: int, *, seed: int) -> torch.Tensor:
        """z_id (count, D) of new identities, the same for the same seed."""
        return self._impl.sample_identity(count, seed=seed)

    @property
    def identity_dim(self) -> int:
        """D, channels of z_id."""
        return self._own.identity_dim


class PreparedHead:
    """A head made ready for one identity on a CPU: codes folded into biases, weights packed for its kernels.

    Equal to the ``ParametricHead`` in eval mode up to rounding; safe to use from several threads.

    Args:
        head: on the CPU, in float32; its weights must not change meanwhile.
        z_id: (D,) identity code.
        precision: of hidden channels, ``float32`` or ``bfloat16``: twice as fast where the processor multiplies
            them, off by some hundredths of a millimetre.

    Raises:
        ValueError: a code of another size, or with numbers that are not finite.
    """

    def __init__(
        self, head: ParametricHead, z_id: torch.Tensor, *, precision: str = "float32"
    ) -> None:
        self.options = head.options
        self.native = _native.head.PreparedHead(
            head._plain_impl, z_id, _native.head.PreparedOptions(precision=precision)
        )

    def sdf(self, points: torch.Tensor, z_exp: torch.Tensor) -> torch.Tensor:
        """Signed distances (N,) at posed points (N, 3) under an expression (E,), head units."""
        return self.native.sdf(points, z_exp)

    def canonical_sdf(
        self,
        points: torch.Tensor,
        *,
        z_exp: torch.Tensor | None = None,
        hyper: torch.Tensor | None = None,
        fade: bool = True,
    ) -> torch.Tensor:
        """Signed distances (N,) at canonical points (N, 3), head units.

        Args:
            points: (N, 3) float32.
            z_exp: (E,) where the identity field sees it; None is 0.
            hyper: (N, hyper_dim) likewise.
            fade: as the field does away from its anchors; False keeps a distance everywhere, of the same sign.
        """
        return self.native.canonical_sdf(points, z_exp=z_exp, hyper=hyper, fade=fade)

    def to_canonical(self, points: torch.Tensor, z_exp: torch.Tensor) -> torch.Tensor:
        """Posed points (N, 3) moved to canonical space."""
        return self.native.to_canonical(points, z_exp)

    def to_posed(self, points: torch.Tensor, z_exp: torch.Tensor) -> torch.Tensor:
        """Canonical points (N, 3) moved to the posed face."""
        return self.native.to_posed(points, z_exp)

    @property
    def anchors(self) -> torch.Tensor:
        """(num_anchors, 3) on the canonical face, head units."""
        return self.native.anchors
