"""Other sculpts of the faces that the landmarks-to-mesh stage sees: other neutral shapes, other expressions.

All faces of the open corpus share one artist's expressions. A network that sees no others learns them by heart and
drops what landmarks of another rig do beside. Here expressions fall into groups that are changed apart: regional gains,
turned directions, spread or sharpened over the surface, a jaw about other hinges. Neutral faces are bent by a smooth
map of space. Landmarks are read from the result, so they always tell what happened.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from freetalk.data import Dataset, FaceMesh
from freetalk.data.triangles import Places
from freetalk.geometry import cotan_laplacian, lumped_mass
from freetalk.train.stm_landmarks import FaceLandmarks, Points

FloatArray = npt.NDArray[np.float32]

_WAVES = 24  # of a random field
_WAVELENGTH_M = (0.04, 0.20)
_MOST_GROUPS = 4  # of expressions that are changed apart
_GAIN = 0.45  # standard deviations of a group's log gain over the face,
_TURN_RAD = 0.30  # of its turns about each axis,
_ALL = 0.2  # and of its log gain as a whole
_STRONGEST = 1.4  # factor of the first two that is drawn at most
_SPREAD_SHARE = 0.6  # of the groups that are spread or sharpened,
_RADII_M = (0.006, 0.012, 0.024)  # by a diffusion over so much,
_SHARPEN = 0.6  # at most
_HINGED_SHARE = 0.5  # of the windows whose jaw turns about a drawn hinge
_OPEN_RAD = 0.35  # of a jaw that is opened by weight 1
_HINGE_M = (0.0, 0.015, 0.02)  # standard deviations of the hinge
_BEND_M = 0.007  # standard deviation of the map of space that bends neutral faces,
_STRETCH = 0.10  # and of the logarithms of its scales along the axes


class RandomField:
    """A smooth random function of space with C values of standard deviation one: a sum of waves."""

    def __init__(self, rng: np.random.Generator, channels: int) -> None:
        shortest, longest = np.log(_WAVELENGTH_M)
        length = np.exp(rng.uniform(shortest, longest, _WAVES))
        directions = rng.standard_normal((_WAVES, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        self._waves = 2 * np.pi * directions.T / length
        self._phases = rng.uniform(0, 2 * np.pi, _WAVES)
        self._sizes = rng.standard_normal((_WAVES, channels)) * np.sqrt(2.0 / _WAVES)

    def __call__(self, points: npt.NDArray[Any]) -> Points:
        """(..., C) at points (..., 3), m."""
        return np.asarray(np.cos(points @ self._waves + self._phases) @ self._sizes)


class Bend:
    """A smooth map of space that gives a neutral face other proportions, in the size and place that it had.

    Args:
        rng: draws the map.
        landmarks: (68, 3) of the face, m: their spread stays, and their mean comes to the origin.
    """

    def __init__(self, rng: np.random.Generator, landmarks: Points) -> None:
        self.landmarks = landmarks
        self._field = RandomField(rng, 3)
        self._size = _BEND_M * rng.uniform(0.3, 1.5)
        self._scales, self._shift = np.exp(_STRETCH * rng.standard_normal(3)), np.zeros(3)
        bent = self(landmarks)
        factor = np.sqrt(landmarks.var(axis=0).sum() / bent.var(axis=0).sum())
        self._scales, self._shift = factor * self._scales, -factor * bent.mean(axis=0)

    def __call__(self, points: npt.NDArray[Any]) -> Points:
        """Points (..., 3) at their new places."""
        bent = (points + self._size * self._field(points)) * self._scales + self._shift
        return np.asarray(bent)

    def motion(self, rest: npt.NDArray[Any], moved: npt.NDArray[Any]) -> Points:
        """What displacements (T, V, 3) of points (V, 3) become, m."""
        return self(rest + moved) - self(rest)


@dataclass(frozen=True)
class _Surface:
    """A whole meshing: mass (V,), the solver of each radius's diffusion, and how far a jaw's opening moves it."""

    mass: Points
    diffusions: tuple[Any, ...]
    jaw_share: Points


class Sculpts:
    """Draws windows of motion as another sculpt of the same expressions has them.

    Args:
        corpus: a dataset whose faces any weights of named expressions move.
        landmarks: of its faces.

    Raises:
        ValueError: it has no such faces.
    """

    def __init__(self, corpus: Dataset, landmarks: FaceLandmarks) -> None:
        found = corpus.drawn()
        if found is None:
            raise ValueError(
                f"task.sculpts changes what weights of expressions do, which {corpus.name} does not have"
            )
        self._corpus, self._landmarks = corpus, landmarks
        self.dataset, names, self._basis = found
        self._jaw = names.index("jawOpen") if "jawOpen" in names else -1
        self._surface = lru_cache(maxsize=None)(self._prepared)

    def motion(
        self,
        rng: np.random.Generator,
        topology: str,
        mesh: FaceMesh,
        weights: FloatArray,
    ) -> tuple[Points, Points]:
        """Motion of a drawn sculpt.

        Args:
            rng: draws the changes.
            topology: whole meshing.
            mesh: a face of it, as the corpus has it.
            weights: (T, E) of the expressions.

        Returns:
            Displacements of landmarks (T, 68, 3) and vertices (T, V, 3), m.
        """
        marks = self._landmarks.on(topology, mesh)
        points = mesh.vertices.astype(np.float64)
        groups = rng.integers(0, int(rng.integers(1, _MOST_GROUPS + 1)), (weights.shape[1],))
        hinged = self._jaw >= 0 and rng.random() < _HINGED_SHARE
        if hinged:
            groups[self._jaw] = -1
        motion = np.zeros((len(weights), *points.shape))
        missed = np.zeros((len(weights), *self._basis.shape[1:]))  # by the meshing, at landmarks
        for group in np.unique(groups):
            part = np.where(groups == group, weights, 0.0).astype(np.float32)
            if not part.any():
                continue
            moved = self._corpus.displacements_of(topology, part).astype(np.float64)
            missed += np.tensordot(part, self._basis, axes=1) - marks.of(moved)
            if group < 0:
                moved = self._hinged(rng, topology, points, marks, part[:, self._jaw], moved)
            motion += self._changed(rng, topology, points, moved)
        return marks.of(motion) + missed, motion

    def _changed(
        self, rng: np.random.Generator, topology: str, points: Points, moved: Points
    ) -> Points:
        """Motion (T, V, 3) with other gains and directions, spread or sharpened."""
        shape = RandomField(rng, 4)(points)
        gain = np.exp(rng.uniform(0, _STRONGEST) * _GAIN * shape[:, 0] + _ALL * rng.normal())
        turn = rng.uniform(0, _STRONGEST) * _TURN_RAD * shape[:, 1:]
        result = gain[:, None] * (moved + np.cross(turn, moved))
        if rng.random() < _SPREAD_SHARE:
            spread = self._spread(topology, result, int(rng.integers(len(_RADII_M))))
            result = result + rng.uniform(-_SHARPEN, 1.0) * (spread - result)
        return np.asarray(result)

    def _hinged(
        self,
        rng: np.random.Generator,
        topology: str,
        points: Points,
        marks: Places,
        opening: FloatArray,
        moved: Points,
    ) -> Points:
        """The jaw's motion (T, V, 3), in part that of a rigid jaw about a drawn hinge."""
        share = self._surface(topology).jaw_share ** rng.uniform(0.4, 2.0)
        ears = marks.of(points)[[1, 15]].mean(axis=0)
        hinge = ears + _HINGE_M * rng.standard_normal(3)
        axis = np.array([1.0, *(0.1 * rng.standard_normal(2))])
        turned = np.cross(axis, points - hinge) * share[:, None]
        rigid = rng.uniform(0.4, 1.3) * _OPEN_RAD * opening[:, None, None] * turned
        mix = rng.uniform(0.2, 1.0)
        return np.asarray((1 - mix) * moved + mix * rigid)

    def _spread(self, topology: str, values: Points, radius: int) -> Points:
        """Values (T, V, 3) after diffusion over the surface."""
        surface = self._surface(topology)
        flat = values.transpose(1, 0, 2).reshape(len(surface.mass), -1)
        solved = surface.diffusions[radius].solve(surface.mass[:, None] * flat)
        return np.asarray(solved.reshape(len(flat), len(values), 3).transpose(1, 0, 2))

    def _prepared(self, topology: str) -> _Surface:
        data = self._corpus.meshing(topology)
        neutral = data.neutral(np.zeros(0, np.float32)).astype(np.float64)
        mass, laplacian = lumped_mass(neutral, data.faces), cotan_laplacian(neutral, data.faces)
        share = np.zeros(len(neutral))
        if self._jaw >= 0:
            size = np.linalg.norm(data.expression_basis[self._jaw], axis=1)
            share = np.minimum(size / max(float(np.quantile(size, 0.98)), 1e-9), 1.0)
        systems = (sp.diags(mass) + 0.25 * radius**2 * laplacian for radius in _RADII_M)
        return _Surface(mass, tuple(splu(sp.csc_matrix(system)) for system in systems), share)
