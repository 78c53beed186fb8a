"""The opening of the lips as a linear function of expression weights, and edits that control it.

Opening = vertical displacement of the upper minus the lower inner lip (landmarks 62 and 66), in metres; zero is the neutral
face, whose lips are closed up to 0.76 mm. The pairs 61-67 and 63-65 are watched as well, against interpenetration.
"""

from __future__ import annotations

import numpy as np

from freetalk.corpus.assets import Array, FaceModel

PAIRS = ((62, 66), (61, 67), (63, 65))
FLOOR_M = -0.0004
"""The least opening at any pair: presses the lips together without letting them pass through each other."""
KNEE_M = 0.011
LIMIT_M = 0.0195
"""Openings above the knee are compressed smoothly towards the limit, what loud running speech reaches."""
OPENERS = (
    "jawOpen", "mouthFunnel", "mouthLowerDown_L", "mouthLowerDown_R", "mouthUpperUp_L", "mouthUpperUp_R",
    "mouthShrugUpper",
)  # fmt: skip


class Lips:
    """Reads and edits the opening of expression weights (T, E)."""

    def __init__(self, model: FaceModel) -> None:
        basis = model.landmark_basis[..., 1].astype(np.float64)
        self.per_pair = np.stack([basis[:, upper] - basis[:, lower] for upper, lower in PAIRS])
        self._close = model.index("mouthClose")
        self._jaw = model.index("jawOpen")
        self._lower = [model.index("mouthLowerDown_L"), model.index("mouthLowerDown_R")]
        self._openers = [model.index(name) for name in OPENERS]

    def opening(self, weights: Array) -> np.ndarray:
        """(T,) opening in metres at the middle of the lips."""
        return weights.astype(np.float64) @ self.per_pair[0]

    def narrowest(self, weights: Array) -> np.ndarray:
        """(T,) the least opening of the three pairs."""
        return (weights.astype(np.float64) @ self.per_pair.T).min(axis=-1)

    def set_opening(self, weights: Array, target_m: np.ndarray) -> Array:
        """Weights whose middle opening equals the target: closes with mouthClose, opens with lower lip and jaw."""
        edited = weights.astype(np.float64).copy()
        delta = np.asarray(target_m) - edited @ self.per_pair[0]
        close_gain = -self.per_pair[0][self._close]
        released = np.minimum(np.maximum(delta, 0) / close_gain, edited[:, self._close])
        edited[:, self._close] += np.maximum(-delta, 0) / close_gain - released
        rest = np.maximum(delta, 0) - released * close_gain
        lower_gain = float(self.per_pair[0][self._lower].sum())
        lowered = np.minimum(rest / lower_gain, 0.5)
        edited[:, self._lower] += lowered[:, None]
        edited[:, self._jaw] += (rest - lowered * lower_gain) / self.per_pair[0][self._jaw]
        return edited.astype(np.float32)

    def without_interpenetration(self, weights: Array) -> Array:
        """Raises the opening where any pair lies below the floor."""
        missing = np.maximum(FLOOR_M - self.narrowest(weights), 0)
        return self.set_opening(weights, self.opening(weights) + missing)

    def limited(self, weights: Array, gain: float = 1.0) -> Array:
        """Scales the opening shapes so that the opening follows gain, knee and limit; closed stays closed."""
        opening = np.maximum(self.opening(weights), 0)
        wanted = gain * opening
        span = LIMIT_M - KNEE_M
        above = np.maximum(wanted - KNEE_M, 0)
        wanted = np.minimum(wanted, KNEE_M) + span * (1 - np.exp(-above / span))
        edited = weights.copy()
        factor = np.where(opening > 1e-6, wanted / np.maximum(opening, 1e-6), gain)
        edited[:, self._openers] *= factor[:, None].astype(np.float32)
        return edited
