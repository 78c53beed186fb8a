"""Training of a neural parametric head on watertight heads of the built-in face [NPHM; FaceTalk 3].

Three stages in one run: the identity field from signed distances of canonical heads; the deformations from points that
correspond, with the identity field frozen; both together from signed distances of posed heads. Codes are those of the
face's rig: z_id of identity coefficients, z_exp of expression weights, through maps that are trained along.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from freetalk.corpus.heads import head_model, held_out_identities
from freetalk.data import Dataset
from freetalk.head import HeadOptions, ParametricHead
from freetalk.train.checkpoint import NO_VALIDATION, export_model
from freetalk.train.config import TrainingConfig
from freetalk.train.head_options import HeadTaskOptions
from freetalk.train.head_samples import Expressions, HeadBank, HeadSampler

STAGES = ("identity", "deformation", "joint")
_VALIDATION_SEED = 18
_NEAR_M = 0.005  # distances that are scored
_CODES = 512  # random identities whose codes' mean and spread are stored
_MILLIMETRES = 1e3


class HeadTask:
    """Heads of random identities and expressions; points around them with their signed distances."""

    epochs = None
    #: A stage leaves the other stages' parameters out.
    skips_parameters = True

    def __init__(
        self, config: TrainingConfig, corpus: Dataset, out: Path, device: torch.device
    ) -> None:
        assert isinstance(config.task, HeadTaskOptions)
        self.options = config.task
        self.corpus = corpus
        self.batch_size = config.loop.batch_size
        self.device = device
        rig = head_model()
        held_out = corpus.sequences("val")
        if not held_out:
            raise ValueError(NO_VALIDATION.format(corpus.name, "sequences"))
        options = HeadOptions.from_dict(
            {
                **config.model,
                "num_coefficients": len(rig.identity_basis),
                "num_weights": len(rig.expression_basis),
                "expressions": list(rig.expression_names),
            }
        )
        self.model = ParametricHead(options).to(device)
        self.unit = options.units_per_metre
        sampler = HeadSampler(rig, self.options, self.unit)
        with torch.no_grad():
            neutral = rig.vertices(np.zeros(len(rig.identity_basis)), rig.canonical_weights)
            anchors = torch.from_numpy(neutral[rig.anchors] * self.unit)
            self.model.get_buffer("identity.anchors").copy_(anchors)
            self.model.get_buffer("canonical_weights").copy_(
                torch.from_numpy(rig.canonical_weights)
            )
        train = Expressions(corpus, corpus.sequences("train"), self.options)
        self._bank = HeadBank(sampler, train, self.options, config.loop.seed)
        self._validation = _validation_items(
            sampler, Expressions(corpus, held_out, self.options), self.options
        )
        shares = [self.options.identity_share, self.options.deformation_share]
        self._ends = np.cumsum(shares) * config.loop.max_steps

    def item(self, rng: np.random.Generator, number: int) -> dict[str, Any]:
        """Samples of one head for the stage that the step belongs to."""
        step = number // self.batch_size
        stage = STAGES[int(np.searchsorted(self._ends, step, side="right"))]
        gradients = step >= (1 - self.options.gradient_share) * self._ends[0]
        return {
            "stage": stage,
            "gradients": bool(stage == "identity" and gradients),
            **self._bank.item(stage, rng, number),
        }

    def collate(self, items: list[dict[str, Any]]) -> dict[str, Any]:
        """One batch; items of a step share its stage."""
        first = items[0]
        return {
            key: torch.from_numpy(np.stack([one[key] for one in items]))
            if isinstance(value, np.ndarray)
            else value
            for key, value in first.items()
        }

    def loss(self, batch: dict[str, Any], generator: torch.Generator) -> dict[str, Tensor]:
        """The terms of the batch's stage."""
        for name, parameter in self.model.named_parameters():
            if name.startswith("identity"):  # with the anchors, which deformations see
                parameter.requires_grad_(batch["stage"] != "deformation")
        z_id = self.model.identity_code(batch["coefficients"])
        terms: dict[str, Tensor] = {}
        if batch["stage"] != "deformation":
            self._identity_terms(batch, z_id, terms)
        if batch["stage"] != "identity":
            z_exp = self.model.expression_code(batch["weights"])
            self._deformation_terms(batch, z_id, z_exp, terms)
            if batch["stage"] == "joint":
                terms["posed_distance"] = self._distance(
                    self.model(batch["posed_points"], z_id, z_exp), batch["posed_distances"]
                )
        weights = {
            "distance": self.options.distance_weight,
            "posed_distance": self.options.distance_weight,
            "normals": self.options.normal_weight,
            "eikonal": self.options.eikonal_weight,
            "anchors": self.options.anchor_weight,
            "identity_code": self.options.code_weight,
            "symmetry": self.options.symmetry_weight,
            "pairs": self.options.pair_weight,
            "cycle": self.options.cycle_weight,
            "expression_code": self.options.expression_code_weight,
        }
        terms["loss"] = torch.stack([weights[name] * term for name, term in terms.items()]).sum()
        return terms

    def validate(self, part: int, parts: int) -> list[tuple[int, Any]]:
        """Errors of held-out identities under held-out expressions, mm."""
        return [
            (number, self._errors(self._validation[number]))
            for number in range(part, len(self._validation), parts)
        ]

    def scores(self, records: list[Any]) -> dict[str, float]:
        """Means; ``score`` is their sum."""
        means = {name: float(np.mean([one[name] for one in records])) for name in records[0]}
        return {**means, "score": sum(means.values())}

    def export(self, directory: Path, training: dict[str, Any]) -> None:
        """Weights and options, with the codes of the closed mouth and of the mean identity."""
        model = self.model
        with torch.no_grad():
            seeds = torch.Generator().manual_seed(_VALIDATION_SEED)
            drawn = torch.randn((_CODES, model.options.num_coefficients), generator=seeds)
            codes = model.identity_code(drawn.to(self.device))
            model.get_buffer("identity_mean").copy_(codes.mean(dim=0))
            model.get_buffer("identity_scale").copy_(codes.std(dim=0))
            rest = torch.zeros((1, model.options.num_weights), device=self.device)
            model.get_buffer("rest_expression").copy_(model.expression_code(rest)[0])
        config = {
            "format": ParametricHead._format,
            "version": 1,
            "options": model.options.to_dict(),
            "training": {**training, "data": self.corpus.describe()},
        }
        export_model(
            directory, config, dict(model.state_dict()), keep_float32=("identity.anchors",)
        )

    def _distance(self, found: Tensor, true: Tensor) -> Tensor:
        """Mean difference of distances, both clamped where only the sign matters."""
        far = self.options.clamp_m * self.unit
        return (found.clamp(-far, far) - true.clamp(-far, far)).abs().mean()

    def _identity_terms(
        self, batch: dict[str, Any], z_id: Tensor, terms: dict[str, Tensor]
    ) -> None:
        step = self.options.normal_step_m * self.unit
        surface, normals = batch["surface"], batch["normals"]
        count = surface.shape[1]
        if batch["gradients"]:
            points = torch.cat([surface, batch["points"]], dim=1).requires_grad_()
            found = self.model.canonical_sdf(points, z_id)
            (slope,) = torch.autograd.grad(found.sum(), points, create_graph=True)
            true = torch.cat([torch.zeros_like(found[:, :count]), batch["distances"]], dim=1)
            terms["distance"] = self._distance(found, true)
            terms["normals"] = (slope[:, :count] - normals).norm(dim=-1).mean()
            terms["eikonal"] = (slope[:, count:].norm(dim=-1) - 1).abs().mean()
        else:
            around = [surface + step * normals, surface - step * normals, batch["points"]]
            found = self.model.canonical_sdf(torch.cat(around, dim=1), z_id)
            above, below, _ = found.split([count, count, len(batch["points"][0])], dim=1)
            ahead = torch.full_like(above, step)
            true = torch.cat([ahead, -ahead, batch["distances"]], dim=1)
            terms["distance"] = self._distance(found, true)
            terms["normals"] = ((above - below) / (2 * step) - 1).abs().mean()
        terms["anchors"] = (self.model.anchors(z_id) - batch["anchors"]).square().mean()
        terms["identity_code"] = z_id.square().mean()
        terms["symmetry"] = self.model.symmetry_distance(z_id)

    def _deformation_terms(
        self, batch: dict[str, Any], z_id: Tensor, z_exp: Tensor, terms: dict[str, Tensor]
    ) -> None:
        canonical, posed = batch["canonical"], batch["posed"]
        errors = []
        if self.model.options.direction != "forward":
            back, _ = self.model.to_canonical(posed, z_id, z_exp)
            errors.append((back - canonical).square().mean())
        if self.model.options.direction != "backward":
            errors.append((self.model.to_posed(canonical, z_id, z_exp) - posed).square().mean())
        if self.model.options.direction == "both":
            terms["cycle"] = (self.model.to_posed(back, z_id, z_exp) - posed).square().mean()
        terms["pairs"] = torch.stack(errors).sum()
        terms["expression_code"] = z_exp.square().mean()

    def _errors(self, item: dict[str, Any]) -> dict[str, float]:
        batch = {key: torch.from_numpy(value)[None].to(self.device) for key, value in item.items()}
        z_id = self.model.identity_code(batch["coefficients"])
        z_exp = self.model.expression_code(batch["weights"])
        scale = _MILLIMETRES / self.unit
        near = batch["distances"].abs() < _NEAR_M * self.unit
        found = self.model.canonical_sdf(batch["points"], z_id)
        errors = {"identity_mm": (found - batch["distances"])[near].abs().mean()}
        if self.model.options.direction != "forward":
            back, _ = self.model.to_canonical(batch["posed"], z_id, z_exp)
            errors["backward_mm"] = (back - batch["canonical"]).norm(dim=-1).mean()
        if self.model.options.direction != "backward":
            ahead = self.model.to_posed(batch["canonical"], z_id, z_exp)
            errors["forward_mm"] = (ahead - batch["posed"]).norm(dim=-1).mean()
        return {name: scale * float(value) for name, value in errors.items()}


def _validation_items(
    sampler: HeadSampler, expressions: Expressions, options: HeadTaskOptions
) -> list[dict[str, Any]]:
    """Each held-out identity under an expression."""
    rng = np.random.default_rng(_VALIDATION_SEED)
    return [
        sampler.taken(sampler.samples("validation", one, expressions.draw(rng), rng), rng)
        for one in held_out_identities()[: options.validation_identities]
    ]
