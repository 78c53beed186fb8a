"""What the training of a head sees: points around random heads, in head units."""

from __future__ import annotations

from typing import Any

import numpy as np

from freetalk.corpus.assets import load_face_model
from freetalk.corpus.curves import combined_shapes
from freetalk.corpus.heads import (
    Array,
    HeadModel,
    Points,
    PosedHead,
    draw_identity,
    draw_pairs,
    head_model,
)
from freetalk.corpus.lips import Lips
from freetalk.data import Dataset, MotionSequence
from freetalk.train.head_options import HeadTaskOptions
from freetalk.train.sequences import SequenceSampler, present_weights

# Frames of a random mixture, of which one is taken.
_MIXED_FRAMES = 40
# Room around a head where distances are drawn at random.
_MARGIN_M = 0.02

#: Samples of one head by name; see HeadSampler.samples.
Samples = dict[str, Any]
#: Those that a head has many of.
_POOLS = (("surface", "normals"), ("points", "distances"), ("posed_points", "posed_distances"))
_PAIRS = ("canonical", "posed")


class Expressions:
    """Expression weights (E,): frames of a corpus, and random mixtures.

    Args:
        corpus: whose weights move the built-in face.
        sequences: of it, that frames are drawn from.
        options: shares of sources and mixtures.

    Raises:
        ValueError: the corpus has expressions that the built-in face lacks, or none.
    """

    def __init__(
        self, corpus: Dataset, sequences: list[MotionSequence], options: HeadTaskOptions
    ) -> None:
        self._corpus, self._mixtures = corpus, options.mixtures
        names = load_face_model().expression_names
        if not corpus.expressions or set(corpus.expressions) - set(names):
            raise ValueError(
                f"a head needs expressions of the built-in face, which {corpus.name} does not have: make a corpus "
                "with 'freetalk corpus build'"
            )
        self._columns = [names.index(name) for name in corpus.expressions]
        shares = present_weights((s.source for s in sequences), options.source_weights)
        self._sampler = SequenceSampler(sequences, shares)
        self._model = load_face_model()
        self._lips = Lips(self._model)

    def draw(self, rng: np.random.Generator) -> Array:
        """One expression; lips do not pass through each other."""
        if rng.random() < self._mixtures:
            mixed = combined_shapes(self._model, _MIXED_FRAMES, rng)
            frame = mixed[rng.integers(_MIXED_FRAMES), None]
        else:
            sequence = self._sampler.draw(rng)
            start = int(rng.integers(sequence.num_frames))
            frame = np.zeros((1, len(self._model.expression_names)), np.float32)
            frame[:, self._columns] = self._corpus.weights(sequence, start, start + 1)
        return self._lips.without_interpenetration(frame)[0].astype(np.float32)


class HeadSampler:
    """Draws what a stage needs of one head.

    Args:
        rig: the closed surface.
        options: counts and spreads.
        unit: head units in a metre.
    """

    def __init__(self, rig: HeadModel, options: HeadTaskOptions, unit: float) -> None:
        self._rig, self._options, self._unit = rig, options, unit

    def samples(
        self, stage: str, coefficients: Array, weights: Array, rng: np.random.Generator
    ) -> Samples:
        """Samples of a head.

        Args:
            stage: ``identity``, ``deformation``, ``joint`` or ``validation``: all but the posed distances.
            coefficients: (100,) of the identity.
            weights: (E,) of the expression.
            rng: what is drawn from.

        Returns:
            ``coefficients``, ``weights`` and, by stage: ``anchors`` (39, 3), ``surface`` and ``normals`` (N, 3),
            ``points`` (M, 3) with ``distances`` (M,) of the canonical head; ``canonical`` and ``posed`` (P, 3) that
            correspond; ``posed_points`` and ``posed_distances`` of the posed head.
        """
        count = self._options.pool_points
        head = PosedHead(self._rig, coefficients, self._rig.canonical_weights)
        found: dict[str, Points] = {}
        if stage != "deformation":
            found["anchors"] = head.vertices[self._rig.anchors] * self._unit
            drawn = head.draw(rng, count, self._options.face_share)
            found["surface"] = head.place(drawn, np.zeros(len(drawn.faces))) * self._unit
            found["normals"] = head.normal(drawn)
            found["points"], found["distances"] = self._around(head, rng, count)
        if stage != "identity":
            moved = PosedHead(self._rig, coefficients, weights)
            canonical, posed = draw_pairs(head, moved, rng, count, self._options.pair_spread_m)
            found["canonical"], found["posed"] = canonical * self._unit, posed * self._unit
            if stage == "joint":
                near = self._around(moved, rng, count)
                found["posed_points"], found["posed_distances"] = near
        packed = {name: value.astype(np.float32) for name, value in found.items()}
        return {"coefficients": coefficients, "weights": weights, **packed}

    def taken(self, samples: Samples, rng: np.random.Generator) -> Samples:
        """As many of a head's samples as a step sees."""
        taken = dict(samples)
        for names in (*_POOLS, _PAIRS):
            if names[0] in samples:
                which = rng.integers(len(samples[names[0]]), size=self._options.points)
                taken |= {name: samples[name][which] for name in names}
        return taken

    def _around(
        self, head: PosedHead, rng: np.random.Generator, count: int
    ) -> tuple[Points, Points]:
        """Points near a head's surface and anywhere around it, with their distances, in head units."""
        drawn = head.draw(
            rng, round(count * (1 - self._options.far_share)), self._options.face_share
        )
        near = head.place(drawn, rng.normal(size=len(drawn.faces)) * self._options.near_spread_m)
        low, high = head.vertices.min(axis=0) - _MARGIN_M, head.vertices.max(axis=0) + _MARGIN_M
        far = rng.uniform(low, high, (round(count * self._options.far_share), 3))
        points = np.concatenate([near, far])
        return points * self._unit, head.signed_distance(points) * self._unit


class HeadBank:
    """Heads that several steps draw from: each serves ``task.reuse`` items before others take its place.

    What an item sees depends on the seed and its own number alone.
    """

    def __init__(
        self,
        sampler: HeadSampler,
        expressions: Expressions,
        options: HeadTaskOptions,
        seed: int,
    ) -> None:
        self._sampler, self._expressions = sampler, expressions
        self._size, self._reuse, self._seed = options.bank, options.reuse, seed
        self._canonical_share = options.canonical_share
        self._era: tuple[str, int] = ("", -1)
        self._heads: dict[int, Samples] = {}

    def item(self, stage: str, rng: np.random.Generator, number: int) -> Samples:
        """Samples of a head of the bank."""
        era = (stage, number // (self._size * self._reuse))
        if era != self._era:
            self._era, self._heads = era, {}
        slot = int(rng.integers(self._size))
        if slot not in self._heads:
            own = np.random.default_rng([self._seed, era[1], slot])
            coefficients, weights = draw_identity(own), self._expressions.draw(own)
            if own.random() < self._canonical_share:
                weights = head_model().canonical_weights
            self._heads[slot] = self._sampler.samples(stage, coefficients, weights, own)
        return self._sampler.taken(self._heads[slot], rng)
