"""Training of the landmarks-to-mesh network [FreeTalk 3.2-3.3, supp. 2-3]."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from freetalk._native.core import default_cache_dir
from freetalk.data import Dataset
from freetalk.stm import Stm, StmOptions
from freetalk.train.checkpoint import export_model
from freetalk.train.config import TrainingConfig
from freetalk.train.losses import MILLIMETRES, motion_loss, vertex_errors
from freetalk.train.previews import Sample
from freetalk.train.sequences import Epochs
from freetalk.train.stm_cuts import FaceCuts
from freetalk.train.stm_landmarks import FaceLandmarks
from freetalk.train.stm_meshes import (
    Placement,
    PreparedFaces,
    PreparedMesh,
    prepare_mesh,
    random_placement,
)
from freetalk.train.stm_scans import chamfer_loss, scan_errors
from freetalk.train.stm_sculpts import Sculpts
from freetalk.train.stm_windows import FaceWindows, Window
from freetalk.train.task_options import StmTaskOptions

_VALIDATION_SEED = 40
_VALIDATION_MESHES = 4
#: Frames of a sample to look at.
_SAMPLE_FRAMES = 90
#: Mean square displacement (mm^2) below which a window counts as this much.
_RELATIVE_FLOOR = 1.0
#: Rounds the cone of the vertex error's norm off (mm).
_NORM_FLOOR = 0.01
#: Mean displacement (mm) below which a window counts as this much.
_MOTION_FLOOR = 0.2


class StmTask:
    """Windows of consecutive frames on randomly placed faces of many meshings."""

    def __init__(
        self, config: TrainingConfig, corpus: Dataset, out: Path, device: torch.device
    ) -> None:
        assert isinstance(config.task, StmTaskOptions)
        self.options = config.task
        self.corpus = corpus
        self.batch_size = config.loop.batch_size
        self.device = device
        self.model = Stm(StmOptions.from_dict(config.model)).to(device)
        least = self.model.options.k_eig
        cuts = FaceCuts(self.options.crops, self.options.missing_faces, least)
        o = self.options
        known = self.model.options.follows_landmarks or o.bends > 0 or o.sculpts > 0
        self.landmarks = FaceLandmarks(corpus) if known else None
        self.meshes = self._prepare(
            "train", self.options.num_meshes, self.options.max_vertices, cuts
        )
        self._held_out_meshes = self._prepare("val", _VALIDATION_MESHES, 0)
        shares, frames = self.options.source_weights, self.options.frames
        sculpts = None
        if self.landmarks is not None and o.sculpts > 0:
            sculpts = Sculpts(corpus, self.landmarks)
        faces = self.meshes.faces
        self.windows = FaceWindows(corpus, faces, "train", shares, frames, sculpts, o.sculpts)
        self.epochs = Epochs(self.windows.sampler.sequences, frames, config.loop.seed)
        self._in_epochs = config.loop.epochs > 0
        self.held_out = FaceWindows(corpus, self._held_out_meshes.faces, "val", {}, frames)

    def item(self, rng: np.random.Generator, number: int) -> dict[str, Any]:
        """A face, its place, and a window of motion."""
        if self._in_epochs:
            sequence, start = self.epochs.window(number)
            window = self.windows.on_any(sequence, rng, start)
        else:
            window = self.windows.draw(rng)
        placement = random_placement(
            rng,
            self.options.rotation_deg,
            self.options.translation_m,
            self.options.scale_range,
            torch.device("cpu"),
        )
        noise = rng.standard_normal(window.landmarks.shape) * self.options.landmark_noise_m
        return {
            "mesh": window.mesh,
            "rotation": placement.rotation,
            "translation": placement.translation,
            "scale": placement.scale,
            "landmarks": torch.from_numpy((window.landmarks + noise).astype(np.float32)),
            "target": torch.from_numpy(window.target),
            "scan": torch.from_numpy(window.scan),
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
            prediction, plain = self._predict(mesh, item["landmarks"], placement)
            terms = self._terms(mesh, prediction, item, placement)
            if plain is not prediction and self.options.plain_weight > 0:
                terms["plain"] = self._terms(mesh, plain, item, placement)["loss"]
                terms["loss"] = terms["loss"] + self.options.plain_weight * terms["plain"]
            for name, value in terms.items():
                totals[name] = totals.get(name, torch.zeros((), device=self.device)) + value
        return {name: value / len(batch["items"]) for name, value in totals.items()}

    def validate(self, part: int, parts: int) -> list[tuple[int, Any]]:
        """Windows on faces and meshings not trained on: errors, and the motion that they are errors of."""
        per_mesh = max(1, self.options.validation_windows // len(self._held_out_meshes))
        still = Placement(torch.eye(3, device=self.device), torch.zeros(3, device=self.device), 1.0)
        records: list[tuple[int, Any]] = []
        for number in range(part, per_mesh * len(self._held_out_meshes), parts):
            mesh = self._held_out_meshes[number // per_mesh]
            rng = np.random.default_rng([_VALIDATION_SEED, number])
            window = self.held_out.draw_on(number // per_mesh, rng)
            landmarks = torch.from_numpy(window.landmarks).to(self.device)
            prediction, _ = self._predict(mesh, landmarks, still)
            if window.scan.shape[1] > 0:
                records.append((number, self._scan_record(mesh, prediction, window)))
                continue
            target = torch.from_numpy(window.target).to(self.device)
            lips = mesh.lip_mask.nonzero()[:, 0]
            sums = [(prediction - target).norm(dim=-1), target.norm(dim=-1)]
            on_lips = [float(one[:, lips].mean()) if len(lips) else 0.0 for one in sums]
            errors = vertex_errors(prediction, target, lips)
            records.append((number, [*(float(one.mean()) for one in sums), *on_lips, *errors]))
        return records

    def _scan_record(self, mesh: PreparedMesh, prediction: Tensor, window: Window) -> list[float]:
        """As of a registered window, by distances of scans to the surface; no vertex has an error."""
        assert mesh.landmarks is not None
        marks = mesh.positions[mesh.landmarks].cpu() + torch.from_numpy(window.landmarks)
        moved, scans = mesh.positions + prediction, torch.from_numpy(window.scan)
        distances = scan_errors(moved, mesh.positions, mesh.faces, scans, marks)
        return [*distances, math.nan, math.nan]

    def scores(self, records: list[Any]) -> dict[str, float]:
        """Mean error (of vertices, or distance of scans) relative to the zero motion's, of face and lips; LVE and MVE."""
        values = np.array(records)
        error, motion, lip_error, lip_motion = values[:, :4].sum(axis=0)
        relative = float(error / max(motion, 1e-12))
        relative_lips = float(lip_error / max(lip_motion, 1e-12))
        known, moved = (column[np.isfinite(column)] for column in values[:, 4:6].T)
        return {
            "relative_error": relative,
            "relative_lip_error": relative_lips,
            "lve_mm2": float(known.mean()) if len(known) else math.nan,
            "mve_mm": float(moved.mean()) if len(moved) else math.nan,
            "score": 0.5 * (relative + relative_lips),
        }

    def export(self, directory: Path, training: dict[str, Any]) -> None:
        """Weights and options."""
        config = {
            "format": "freetalk-stm",
            "version": 1,
            "options": self.model.options.to_dict(),
            "training": {**training, "data": self.corpus.describe()},
        }
        export_model(directory, config, dict(self.model.state_dict()))

    def sample(self) -> Sample:
        """The first held-out face moving as the first held-out take, and as it should."""
        mesh = self._held_out_meshes[0]
        sequence = self.held_out.first_on(0)
        frames = min(_SAMPLE_FRAMES, sequence.num_frames)
        landmarks = torch.from_numpy(self.corpus.landmarks(sequence, 0, frames)).to(self.device)
        still = Placement(torch.eye(3, device=self.device), torch.zeros(3, device=self.device), 1.0)
        parts = [
            self._predict(mesh, part, still)[0] for part in landmarks.split(self.options.frames)
        ]
        face = self.corpus.mesh(mesh.face.identity, mesh.face.topology)
        rate = self.corpus.sample_rate_hz
        audio = self.corpus.audio(sequence) if sequence.has_sound else np.zeros(0, np.float32)
        return Sample(
            vertices=face.vertices,
            faces=face.faces,
            predicted=torch.cat(parts).cpu().numpy(),
            true=None
            if self.corpus.scans(sequence, 0, 1).shape[1] > 0
            else self.corpus.vertex_displacements(mesh.face.topology, sequence, 0, frames),
            fps=sequence.fps,
            audio=audio[: round(frames / sequence.fps * rate)],
            sample_rate_hz=rate,
        )

    def _predict(
        self, mesh: PreparedMesh, landmarks: Tensor, placement: Placement
    ) -> tuple[Tensor, Tensor]:
        """Displacements of a window, (T, V, 3) m, of landmarks (T, 68, 3) m in place; and what the decoder gives.

        The two are one unless the model follows its landmarks.
        """
        moving = placement.turned(landmarks)
        plain: Tensor = self.model(
            placement.moved(mesh.positions), placement.operators(mesh.operators), moving
        ).float()
        if mesh.follower is None or not self.model.options.follows_landmarks:
            return plain, plain
        with torch.autocast(plain.device.type, enabled=False):
            return mesh.follower.apply(plain, moving), plain

    def _terms(
        self,
        mesh: PreparedMesh,
        prediction: Tensor,
        item: dict[str, Any],
        placement: Placement,
    ) -> dict[str, Tensor]:
        """The loss of a prediction (T, V, 3), m, and what it consists of."""
        if item["scan"].shape[1] > 0:
            return self._scan_terms(mesh, prediction, item, placement)
        o = self.options
        prediction = MILLIMETRES * prediction
        target = MILLIMETRES * placement.turned(item["target"])
        weights = None
        if o.lip_weight != 1.0:
            weights = 1.0 + (o.lip_weight - 1.0) * mesh.lip_mask.float()
            weights = weights / weights.mean()
        terms = motion_loss(
            prediction, target, None, o.lambda_velocity, o.lambda_acceleration, weights
        )
        error = prediction - target
        terms["error_mm"] = error.detach().norm(dim=-1).mean()
        if o.relative:
            size = target.square().sum(dim=-1).mean().clamp_min(_RELATIVE_FLOOR)
            terms["loss"] = terms["loss"] / size
        if o.error_weight > 0:
            norms = (error.square().sum(dim=-1) + _NORM_FLOOR**2).sqrt()
            norms = norms if weights is None else norms * weights
            motion = target.norm(dim=-1).mean().clamp_min(_MOTION_FLOOR)
            terms["relative_error"] = norms.mean() / motion
            terms["loss"] = terms["loss"] + o.error_weight * terms["relative_error"]
        return terms

    def _scan_terms(
        self,
        mesh: PreparedMesh,
        prediction: Tensor,
        item: dict[str, Any],
        placement: Placement,
    ) -> dict[str, Tensor]:
        """Likewise where frames are scans: landmarks by Eq. 15, and the distance of the surfaces."""
        o = self.options
        assert mesh.landmarks is not None  # the import sees to it
        told = MILLIMETRES * placement.turned(item["landmarks"])
        made = MILLIMETRES * prediction[:, mesh.landmarks]
        terms = motion_loss(made, told, None, o.lambda_velocity, o.lambda_acceleration)
        moved = MILLIMETRES * (placement.moved(mesh.positions) + prediction)
        scans = MILLIMETRES * placement.moved(item["scan"])
        terms["loss"] = o.landmark_weight * terms["loss"]
        if o.chamfer_weight > 0:
            terms["chamfer"] = chamfer_loss(moved, mesh.faces, scans)
            terms["loss"] = terms["loss"] + o.chamfer_weight * terms["chamfer"]
        if o.relative:
            size = told.square().sum(dim=-1).mean().clamp_min(_RELATIVE_FLOOR)
            terms["loss"] = terms["loss"] / size
        return terms

    def _prepare(
        self, split: str, count: int, max_vertices: int, cuts: FaceCuts | None = None
    ) -> PreparedFaces:
        options = self.model.options
        cache = Path(
            self.options.operator_cache or Path(default_cache_dir()) / "training-operators"
        )
        cache.mkdir(parents=True, exist_ok=True)
        prepare = partial(
            prepare_mesh,
            self.corpus,
            length_scale=options.length_scale,
            k_eig=options.k_eig,
            cache_dir=cache,
            device=self.device,
            cuts=cuts,
            landmarks=self.landmarks,
            bends=self.options.bends if cuts is not None else 0.0,
        )
        most_bytes = int(self.options.operator_memory_gb * 1e9)
        return PreparedFaces(self.corpus, split, count, max_vertices, prepare, most_bytes)
