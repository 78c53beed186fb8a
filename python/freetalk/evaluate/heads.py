"""How well a trained neural parametric head shows faces that it has not seen: held-out identities and expressions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch

from freetalk.corpus.heads import HeadModel, PosedHead, head_model, held_out_identities
from freetalk.data import Dataset
from freetalk.evaluate.surfaces import SurfaceScores, surface_scores
from freetalk.geometry import SurfaceTree, sample_template
from freetalk.head import FitOptions, ParametricHead, PreparedHead, extract, fit_identity, track
from freetalk.train.head_options import HeadTaskOptions
from freetalk.train.head_samples import Expressions

Points = npt.NDArray[np.floating]
Mesh = tuple[Points, npt.NDArray[np.integer]]

REGIONS = ("face", "lips", "head")
_SEED = 18
_MILLIMETRES = 1e3
_THRESHOLDS_MM = (1.0, 5.0)
#: Of scans from one side: the camera's largest turn, its pixels, the flattest skin it sees, its holes and their radius.
_TURN_DEG, _PIXEL_M, _LEAST_COSINE, _HOLES, _HOLE_M = 40.0, 0.0015, 0.25, 4, 0.012


@dataclass(frozen=True)
class HeadScores:
    """Scores by region (``face``, ``lips``, ``head``), mm; means over what was judged.

    Attributes:
        canonical: the identity's surface with the mouth a little open, found from the rig's code.
        posed: that surface moved by the forward deformation, under held-out expressions.
        one_view: identity and expression found from a scan of one side (:func:`seen_from`); empty unless asked for.
        heads: identities times expressions.
    """

    canonical: dict[str, SurfaceScores]
    posed: dict[str, SurfaceScores]
    one_view: dict[str, SurfaceScores]
    heads: int


def evaluate_head(
    head: ParametricHead,
    corpus: Dataset,
    *,
    identities: int = 8,
    expressions: int = 2,
    num_points: int = 50_000,
    one_view: bool = False,
) -> HeadScores:
    """Scores of a head with maps of the built-in face's rig.

    Args:
        head: in eval mode, on the CPU, with a forward deformation.
        corpus: whose test split the expressions are frames of.
        identities: held-out ones, at most 32.
        expressions: of each.
        num_points: sampled on each surface; NPHM's scores are of 250,000.
        one_view: also fit the head to scans of the posed heads from one side.

    Raises:
        ValueError: the corpus has other expressions or no test split.
        RuntimeError: the head has no surface in its box.
    """
    rig = head_model()
    sequences = corpus.sequences("test")
    if not sequences:
        raise ValueError(f"{corpus.name} has no test split")
    drawn = Expressions(corpus, sequences, HeadTaskOptions(mixtures=0))
    rng = np.random.default_rng(_SEED)
    neutral = torch.zeros(head.options.expression_dim)
    canonical: list[dict[str, SurfaceScores]] = []
    posed: list[dict[str, SurfaceScores]] = []
    fitted: list[dict[str, SurfaceScores]] = []
    for coefficients in held_out_identities()[:identities]:
        code = head.identity_code(torch.from_numpy(coefficients)[None])[0].detach()
        prepared = PreparedHead(head, code)
        surface = extract(prepared, neutral)
        truth = PosedHead(rig, coefficients, rig.canonical_weights)
        canonical.append(
            _by_region(rig, truth, (_MILLIMETRES * surface.vertices, surface.faces), num_points)
        )
        for _ in range(expressions):
            weights = drawn.draw(rng)
            z_exp = head.expression_code(torch.from_numpy(weights)[None])[0].detach()
            moved = track(prepared, surface.vertices, z_exp[None])[0].numpy()
            truth = PosedHead(rig, coefficients, weights)
            posed.append(_by_region(rig, truth, (_MILLIMETRES * moved, surface.faces), num_points))
            if one_view:
                scan = seen_from(truth, rng.uniform(-_TURN_DEG, _TURN_DEG), rng)
                fit = fit_identity(head, [scan], options=FitOptions(points=0))
                found = extract(PreparedHead(head, fit.z_id), fit.z_exp[0])
                mesh = (_MILLIMETRES * found.vertices, found.faces)
                fitted.append(_by_region(rig, truth, mesh, num_points))
    return HeadScores(
        canonical=_means(canonical),
        posed=_means(posed),
        one_view=_means(fitted) if fitted else {},
        heads=len(posed),
    )


def seen_from(
    truth: PosedHead,
    turn_deg: float,
    rng: np.random.Generator,
    *,
    points: int = 2500,
    noise_m: float = 3e-4,
) -> npt.NDArray[np.float64]:
    """What a depth camera sees of a head (points, 3), m: one side of it, with noise and four holes.

    Args:
        truth: the head.
        turn_deg: of the camera about the vertical axis; 0 looks at the face.
        rng: of the points, their noise and the holes.
        points: kept, or fewer where fewer are seen.
        noise_m: spread of each coordinate.
    """
    outer = truth.faces[truth.is_outer()]
    drawn, normals = sample_template(
        truth.vertices, outer, 24 * points, seed=int(rng.integers(1 << 30))
    )
    turn = np.radians(turn_deg)
    toward = np.array([np.sin(turn), 0.0, np.cos(turn)])
    across = np.stack([drawn @ [np.cos(turn), 0.0, -np.sin(turn)], drawn[:, 1]], axis=1)
    cells = np.unique(np.floor(across / _PIXEL_M), axis=0, return_inverse=True)[1].reshape(-1)
    nearest = np.full(cells.max() + 1, -np.inf)
    np.maximum.at(nearest, cells, drawn @ toward)
    seen = (normals @ toward > _LEAST_COSINE) & (drawn @ toward > nearest[cells] - 2 * _PIXEL_M)
    for hole in drawn[seen][rng.integers(seen.sum(), size=_HOLES)]:
        seen &= np.linalg.norm(drawn - hole, axis=1) > _HOLE_M
    kept = rng.permutation(np.flatnonzero(seen))[:points]
    return np.asarray(drawn[kept] + rng.normal(scale=noise_m, size=(len(kept), 3)))


def table(scores: HeadScores) -> str:
    """Scores as lines of text, mm."""
    lines = [f"{'':18s}  p2s   Chamfer  floor    NC    F@1    F@5"]
    kinds = {"canonical": scores.canonical, "posed": scores.posed, "one view": scores.one_view}
    for kind, regions in kinds.items():
        for region, one in regions.items():
            f_scores = " ".join(f"{one.f_scores[t]:6.3f}" for t in _THRESHOLDS_MM)
            lines.append(
                f"{kind:10s}{region:8s} {one.point_to_surface:5.2f}   {one.chamfer_l1:6.2f}  "
                f"{one.sampling_floor:5.2f}  {one.normal_consistency:5.3f} {f_scores}"
            )
    return "\n".join(lines)


def _by_region(
    rig: HeadModel, truth: PosedHead, found: Mesh, num_points: int
) -> dict[str, SurfaceScores]:
    """Scores of a surface, mm, where it is nearest to a region of the true one that can be seen.

    What lies nearest to the inside of the mouth or to the back of the eyes does not count: scores are of renderings
    where others state them, and the true surface has no points there.
    """
    vertices = truth.vertices * _MILLIMETRES
    outer = truth.is_outer()
    tree = SurfaceTree(vertices, truth.faces)
    skin = len(rig.neutral)
    of_vertices = {
        "face": np.append(rig.is_face, np.ones(len(vertices) - skin, bool)),
        "lips": np.append(rig.is_lips, np.zeros(len(vertices) - skin, bool)),
        "head": np.ones(len(vertices), bool),
    }
    scores = {}
    for region in REGIONS:
        chosen: npt.NDArray[np.bool_] = outer & of_vertices[region][truth.faces].all(axis=1)

        def keep(points: Points, chosen: npt.NDArray[np.bool_] = chosen) -> npt.NDArray[np.bool_]:
            return chosen[tree.nearest(points)[2]]

        target = (vertices, truth.faces[outer])
        scores[region] = surface_scores(
            found, target, thresholds=_THRESHOLDS_MM, num_points=num_points, keep=keep
        )
    return scores


def _means(records: list[dict[str, SurfaceScores]]) -> dict[str, SurfaceScores]:
    return {
        region: _mean([record[region] for record in records])
        for region in (REGIONS if records else ())
    }


def _mean(scores: list[SurfaceScores]) -> SurfaceScores:
    def of(value: Callable[[SurfaceScores], float]) -> float:
        return float(np.mean([value(one) for one in scores]))

    return SurfaceScores(
        point_to_surface=of(lambda one: one.point_to_surface),
        chamfer_l1=of(lambda one: one.chamfer_l1),
        normal_consistency=of(lambda one: one.normal_consistency),
        f_scores={t: of(lambda one, t=t: one.f_scores[t]) for t in _THRESHOLDS_MM},  # type: ignore[misc]
        sampling_floor=of(lambda one: one.sampling_floor),
    )
