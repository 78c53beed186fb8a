"""Options of the training of a neural parametric head."""

from __future__ import annotations

from dataclasses import dataclass, field

from freetalk.train.task_options import require, require_positive, require_shares


@dataclass
class HeadTaskOptions:
    """Samples and losses of a neural parametric head; see ``freetalk.train.head``.

    Attributes:
        init: weights to start from; empty starts from random ones.
        source_weights: share of each source of the corpus among the expressions, as in the other tasks.
        mixtures: share of the expressions that are random mixtures instead of frames of the corpus.
        canonical_share: of the heads that are the canonical face itself, which the deformations leave where it is.
        identity_share: of the steps that train the identity field alone.
        deformation_share: of the steps after them that train the deformations alone; the rest trains both.
        gradient_share: last part of the identity stage with NPHM's loss on gradients, instead of differences along
            normals.
        points: of each kind that a step sees of each head.
        pool_points: of each kind that are drawn of each head of the bank.
        bank: heads that are kept at a time.
        reuse: items that each of them serves, in the mean.
        face_share: of the surface points, on the front of the face.
        far_share: of the points with distances, anywhere around the head.
        near_spread_m: standard deviation of the others' distance to the surface.
        pair_spread_m: likewise of points that correspond.
        normal_step_m: from the surface, of differences along normals.
        clamp_m: distances count up to this.
        distance_weight: weight of the difference of distances [NPHM: 2].
        normal_weight: weight of the gradient's difference to the normal [NPHM: 0.3].
        eikonal_weight: weight of the gradient's length [NPHM: 0.1].
        anchor_weight: weight of the anchors [NPHM: 7.5].
        code_weight: weight of the identity code's square [NPHM: 0.01].
        symmetry_weight: weight of the difference of mirrored local codes [NPHM: 0.01].
        pair_weight: weight of points that correspond [NPHM: 100].
        cycle_weight: weight of the way to the canonical face and back.
        expression_code_weight: weight of the expression code's square [NPHM: 5e-5].
        validation_identities: held-out identities that are scored, at most 32.
    """

    init: str = ""
    source_weights: dict[str, float] = field(default_factory=dict)
    mixtures: float = 0.25
    canonical_share: float = 0.05
    identity_share: float = 0.5
    deformation_share: float = 0.25
    gradient_share: float = 0.2
    points: int = 1000
    pool_points: int = 8000
    bank: int = 64
    reuse: int = 16
    face_share: float = 0.75
    far_share: float = 0.15
    near_spread_m: float = 0.004
    pair_spread_m: float = 0.0025
    normal_step_m: float = 0.0005
    clamp_m: float = 0.025
    distance_weight: float = 2.0
    normal_weight: float = 0.3
    eikonal_weight: float = 0.1
    anchor_weight: float = 7.5
    code_weight: float = 0.01
    symmetry_weight: float = 0.01
    pair_weight: float = 100.0
    cycle_weight: float = 20.0
    expression_code_weight: float = 5e-5
    validation_identities: int = 8

    def check(self) -> None:
        """Raises ValueError where a value is out of range."""
        require_shares(
            self,
            "mixtures",
            "canonical_share",
            "identity_share",
            "deformation_share",
            "gradient_share",
        )
        require_positive(self, "points", "pool_points", "bank", "reuse")
        require_positive(self, "near_spread_m", "pair_spread_m", "normal_step_m", "clamp_m")
        require(
            self.identity_share + self.deformation_share <= 1,
            "task.identity_share and task.deformation_share must be at most 1 together",
            self.identity_share + self.deformation_share,
        )
        require(
            1 <= self.validation_identities <= 32,
            "task.validation_identities must be in [1, 32]",
            self.validation_identities,
        )
