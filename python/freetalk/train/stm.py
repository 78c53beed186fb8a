"""Training of the landmarks-to-mesh network [FreeTalk 3.2-3.3, supp. 2-3]."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freetalk.data import OpenCorpus
from freetalk.stm import Stm, StmOptions
from freetalk.train.checkpoint import export_model
from freetalk.train.config import StmTaskOptions, TrainingConfig
from freetalk.train.losses import motion_loss
from freetalk.train.sampling import SequenceSampler
from freetalk.train.stm_meshes import (
    Placement,
    PreparedMesh,
    prepare_meshes,
    random_placement,
    random_weights,
)

_VALIDATION_SEED = 40
_VALIDATION_MESHES = 4
#: Mean square displacement (m^2) below which a window counts as this much: 1 mm.
_RELATIVE_FLOOR = 0.001**2
#: Rounds the cone of the vertex error's norm off (m).
_NORM_FLOOR = 1e-5
#: Mean displacement (m) below which a window counts as this much.
_MOTION_FLOOR = 2e-4


class StmTask:
    """Windows of consecutive frames on randomly placed faces of many meshings."""

    def __init__(
        self, config: TrainingConfig, corpus: OpenCorpus, out: Path, device: torch.device
    ) -> None:
        assert isinstance(config.task, StmTaskOptions)
        self.options = config.task
        self.corpus = corpus
        self.batch_size = config.loop.batch_size
        self.device = device
        weights = dict(self.options.source_weights)
        total = sum(weights.values())
        self._random_share = weights.pop("random", 0.0) / total if total else 0.0
        self.sampler = SequenceSampler(corpus.sequences("train"), weights)
        self.held_out = SequenceSampler(corpus.sequences("val"), {})
        self._landmark_basis, determined = corpus.landmark_basis()
        self._drawable = np.flatnonzero(determined)
        self.model = Stm(StmOptions.from_dict(config.model)).to(device)
        self.meshes = self._prepare("train", self.options.num_meshes, self.options.max_vertices)
        self._held_out_meshes = self._prepare("val", _VALIDATION_MESHES, 0)

    def item(self, rng: np.random.Generator) -> dict[str, Any]:
        """A face, its place, and a window of motion."""
        mesh = int(rng.integers(len(self.meshes)))
        placement = random_placement(
            rng,
            self.options.rotation_deg,
            self.options.translation_m,
            self.options.scale_range,
            torch.device("cpu"),
        )
        weights, landmarks = self._window(rng)
        noise = rng.standard_normal(landmarks.shape) * self.options.landmark_noise_m
        true = self.corpus.displacements_of(self.meshes[mesh].topology, weights)
        return {
            "mesh": mesh,
            "rotation": placement.rotation,
            "translation": placement.translation,
            "scale": placement.scale,
            "landmarks": torch.from_numpy((landmarks + noise).astype(np.float32)),
            "target": torch.from_numpy(true),
        }

    def collate(self, items: list[dict[str, Any]]) -> dict[str, Any]:
        """Faces of different sizes side by side."""
        return {"items": items}

    def loss(self, batch: dict[str, Any], generator: torch.Generator) -> dict[str, Tensor]:
        """Eq. 15 over vertices, averaged over the batch's faces."""
        totals: dict[str, Tensor] = {}
        for item in batch["items"]:
            mesh = self.meshes[item["mesh"]]
            placement = Placement(item["rotation"], item["translation"], item["scale"])
            prediction = self._predict(mesh, item["landmarks"], placement)
            target = placement.turned(item["target"])
            for name, value in self._terms(mesh, prediction, target).items():
                totals[name] = totals.get(name, torch.zeros((), device=self.device)) + value
        return {name: value / len(batch["items"]) for name, value in totals.items()}

    def validate(self) -> dict[str, float]:
        """Mean vertex error relative to the zero motion's, on faces and meshings not trained on."""
        rng = np.random.default_rng(_VALIDATION_SEED)
        sums = np.zeros(4)
        per_mesh = max(1, self.options.validation_windows // len(self._held_out_meshes))
        still = Placement(torch.eye(3, device=self.device), torch.zeros(3, device=self.device), 1.0)
        for mesh in self._held_out_meshes:
            for _ in range(per_mesh):
                sequence = self.held_out.draw(rng)
                start = int(rng.integers(0, max(1, sequence.num_frames - self.options.frames)))
                stop = start + self.options.frames
                landmarks = torch.from_numpy(self.corpus.landmarks(sequence, start, stop))
                true = self.corpus.vertex_displacements(mesh.topology, sequence, start, stop)
                prediction = self._predict(mesh, landmarks.to(self.device), still)
                target = torch.from_numpy(true).to(self.device)
                error, motion = (prediction - target).norm(dim=-1), target.norm(dim=-1)
                lips = mesh.lip_mask
                sums += [
                    float(error.mean()),
                    float(motion.mean()),
                    float(error[:, lips].mean()) if bool(lips.any()) else 0.0,
                    float(motion[:, lips].mean()) if bool(lips.any()) else 0.0,
                ]
        relative, relative_lips = (float(sums[at] / max(sums[at + 1], 1e-12)) for at in (0, 2))
        return {
            "relative_error": relative,
            "relative_lip_error": relative_lips,
            "score": 0.5 * (relative + relative_lips),
        }

    def export(self, directory: Path, training: dict[str, Any]) -> None:
        """Weights and options."""
        config = {
            "format": "freetalk-stm",
            "version": 1,
            "options": self.model.options.to_dict(),
            "training": training,
        }
        export_model(directory, config, dict(self.model.state_dict()))

    def _predict(self, mesh: PreparedMesh, landmarks: Tensor, placement: Placement) -> Tensor:
        """Predicted displacements of a window, (T, V, 3) m, of landmarks (T, 68, 3) m in place."""
        prediction: Tensor = self.model(
            placement.moved(mesh.positions),
            placement.operators(mesh.operators),
            placement.turned(landmarks),
        )
        return prediction.float()

    def _terms(self, mesh: PreparedMesh, prediction: Tensor, target: Tensor) -> dict[str, Tensor]:
        o = self.options
        weights = None
        if o.lip_weight != 1.0:
            weights = 1.0 + (o.lip_weight - 1.0) * mesh.lip_mask.float()
            weights = weights / weights.mean()
        terms = motion_loss(
            prediction, target, None, o.lambda_velocity, o.lambda_acceleration, weights
        )
        error = prediction - target
        terms["error_mm"] = 1000 * error.detach().norm(dim=-1).mean()
        if o.relative:
            size = target.square().sum(dim=-1).mean().clamp_min(_RELATIVE_FLOOR)
            terms["loss"] = terms["loss"] / size
        else:
            terms["loss"] = terms["loss"] * 1e6  # mm^2: keeps gradients clear of Adam's epsilon
        if o.error_weight > 0:
            norms = (error.square().sum(dim=-1) + _NORM_FLOOR**2).sqrt()
            norms = norms if weights is None else norms * weights
            motion = target.norm(dim=-1).mean().clamp_min(_MOTION_FLOOR)
            terms["relative_error"] = norms.mean() / motion
            terms["loss"] = terms["loss"] + o.error_weight * terms["relative_error"]
        return terms

    def _window(
        self, rng: np.random.Generator
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        frames = self.options.frames
        if rng.random() < self._random_share:
            weights = random_weights(rng, frames, len(self.corpus.expressions), self._drawable)
            return weights, np.tensordot(weights, self._landmark_basis, axes=1)
        sequence = self.sampler.draw(rng)
        start = int(rng.integers(0, max(1, sequence.num_frames - frames + 1)))
        return (
            self.corpus.weights(sequence, start, start + frames),
            self.corpus.landmarks(sequence, start, start + frames),
        )

    def _prepare(self, split: str, count: int, max_vertices: int) -> list[PreparedMesh]:
        options = self.model.options
        return prepare_meshes(
            self.corpus,
            split,
            count,
            max_vertices,
            options.length_scale,
            options.k_eig,
            self.options.operator_cache,
            self.device,
        )
