"""FaceTalk's Table 4 and Fig. 9: what the temporal term does to codes that are fitted to a sequence of scans.

Scans are drawn from a captured take on a held-out identity of the built-in face: other points in each frame, with noise,
as multi-view stereo gives them. The paper judges by steps between neighbouring codes (MAE, RMSE) and LSE-D; in place of
the latter, which needs rendered video and weights that are not free, stand the tracked lips against the true ones.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from freetalk._files import write_json, write_text
from freetalk._pretrained import PRETRAINED
from freetalk.corpus.assets import load_face_model
from freetalk.corpus.codes import distances_mm, outer_face
from freetalk.corpus.heads import HeadModel, PosedHead, head_model, held_out_identities
from freetalk.data import Dataset, lip_opening, open_dataset
from freetalk.data.landmarks import LIPS
from freetalk.head import (
    FitOptions,
    ParametricHead,
    PreparedHead,
    fit_expressions,
    track,
)
from freetalk.tables.papers import FACETALK_4

FloatArray = npt.NDArray[np.float64]

NAME = "facetalk_4"
_WITH, _WITHOUT = "temporal loss", "no temporal loss"
_LAGS = 12
#: Sizes: frames, points of a scan, then of Adam: points, steps, step size.
SIZES = {
    "tiny": (4, 200, 50, 2, 1e-2),
    "small": (72, 2000, 500, 150, 5e-3),
    "full": (240, 20000, 5000, 500, 1e-3),
}


@dataclass(frozen=True)
class Fitting:
    """How codes of a sequence move, and what they show.

    Attributes:
        mae: mean absolute step from frame to frame, the codes' unit.
        rmse: root mean square of it.
        surface_mm: mean distance of the true face from the codes' surface.
        opening_correlation: of the tracked lips' opening with the true one.
        opening_mm: mean error of it.
        jerk: mean absolute third difference of the tracked lips, relative to the true ones'.
        autocorrelation: of the codes at lags of 0, 1, ... frames, mean over channels by their variance.
    """

    mae: float
    rmse: float
    surface_mm: float
    opening_correlation: float
    opening_mm: float
    jerk: float
    autocorrelation: list[float]


class FittingTask:
    """Scans of a captured take, and what codes of them are compared with.

    Args:
        head: trained on the built-in face.
        corpus: its first captured take of the test split is shown.
        frames: of the take, from where the lips move most.
        points: of each scan.
        noise_mm: of the points.
        seed: of points and noise.

    Raises:
        ValueError: the corpus has no captured take with expressions in its test split.
    """

    def __init__(
        self,
        head: ParametricHead,
        corpus: Dataset,
        frames: int,
        points: int,
        noise_mm: float,
        seed: int = 0,
    ) -> None:
        self.head, rig = head, head_model()
        weights = self._take(corpus, list(rig.expression_names), frames)
        identity = held_out_identities()[0]
        posed = [PosedHead(rig, identity, row) for row in weights]
        rng = np.random.default_rng(seed)
        self.scans = []
        for one in posed:
            drawn = one.draw(rng, points, 1.0).of(one.vertices, one.faces)
            noisy = drawn + rng.normal(0, 1e-3 * noise_mm, drawn.shape)
            self.scans.append(noisy.astype(np.float32))
        seen = outer_face(rig)
        self.surfaces = [one.vertices[seen].astype(np.float32) for one in posed]
        at = _landmarks(rig)
        self.landmarks = np.stack([one.vertices[at] for one in posed]).astype(np.float32)
        with torch.no_grad():
            self.z_id = head.identity_code(torch.from_numpy(identity)[None])[0]
            self.known = head.expression_code(torch.from_numpy(weights))
        self._template = rig.vertices(identity, rig.canonical_weights)[at]

    @staticmethod
    def _take(corpus: Dataset, names: list[str], frames: int) -> npt.NDArray[np.float32]:
        """(T, E) weights of the part of a captured take in which the lips move most."""
        takes = [s for s in corpus.sequences("test") if s.source == "facegood"]
        if not takes or not corpus.expressions:
            raise ValueError(f"{corpus.name} has no captured take in its test split")
        at = corpus.select(takes[:1]).at(24.0)
        take = at.sequences()[0]
        opening = lip_opening(at.landmarks(take))
        frames = min(frames, len(opening))
        moves = np.convolve(np.abs(np.diff(opening, append=opening[-1])), np.ones(frames), "valid")
        first = int(moves.argmax())
        weights = np.zeros((frames, len(names)), np.float32)
        columns = [names.index(name) for name in corpus.expressions]
        weights[:, columns] = at.weights(take, first, first + frames)
        return weights

    def fit(self, options: FitOptions, seed: int = 0) -> torch.Tensor:
        """(T, Z) codes from the face at rest."""
        return fit_expressions(self.head, self.z_id, self.scans, options=options, seed=seed).z_exp

    def judged(self, codes: torch.Tensor) -> Fitting:
        """What codes (T, Z) show."""
        steps = codes.diff(dim=0).double()
        ready = PreparedHead(self.head, self.z_id)
        moved = track(ready, self._template, codes).numpy()
        opening, true = lip_opening(moved), lip_opening(self.landmarks)
        jerk, true_jerk = (
            float(np.abs(np.diff(points[:, LIPS], 3, axis=0)).mean())
            for points in (moved, self.landmarks)
        )
        return Fitting(
            mae=float(steps.abs().mean()),
            rmse=float(steps.square().mean().sqrt()),
            surface_mm=float(distances_mm(self.head, self.z_id, codes, self.surfaces).mean()),
            opening_correlation=float(np.corrcoef(opening, true)[0, 1]),
            opening_mm=1000 * float(np.abs(opening - true).mean()),
            jerk=jerk / max(true_jerk, 1e-12),
            autocorrelation=autocorrelation(codes.double().numpy()),
        )


def autocorrelation(codes: FloatArray) -> list[float]:
    """Of channels (T, Z) at lags of 0 to 12 frames, their mean by variance."""
    centred = codes - codes.mean(axis=0)
    power = np.square(centred).sum()
    lags = range(min(_LAGS, len(codes) - 1) + 1)
    return [float((centred[lag:] * centred[: len(codes) - lag]).sum() / power) for lag in lags]


def _landmarks(rig: HeadModel) -> npt.NDArray[np.int64]:
    """(68,) vertices of the closed head."""
    model = load_face_model()
    marks = model.neutral[model.landmarks68].astype(np.float64)
    away = np.square(rig.neutral[:, None] - marks).sum(axis=-1)
    return away.argmin(axis=0)


def main(arguments: Sequence[str] | None = None) -> int:
    """Fits, judges and writes the table."""
    given = _parser().parse_args(arguments)
    frames, points, adam_points, steps, step_size = SIZES[given.size]
    head = ParametricHead.from_pretrained(given.head).eval()
    task = FittingTask(head, open_dataset(given.data), frames, points, given.noise_mm, given.seed)
    adam = {"method": "adam", "adam_points": adam_points, "adam_iterations": steps}
    adam |= {"adam_decay": steps * 3 // 5, "learning_rate": step_size}
    methods: dict[str, dict[str, Any]] = {
        f"Adam [Eq. 16-18], {_WITHOUT}": {**adam, "lambda_temp": 0.0},
        f"Adam [Eq. 16-18], {_WITH}": adam,
        f"Gauss-Newton, {_WITHOUT}": {"temporal": 0.0},
        f"Gauss-Newton, {_WITH}": {},
    }
    rows = {}
    for name, fields in methods.items():
        rows[name] = task.judged(task.fit(FitOptions(**fields), given.seed))
        print(f"{name}: {rows[name].surface_mm:.2f} mm", flush=True)
    rows["the codes of the true weights"] = task.judged(task.known)
    about = f"{frames} frames, {points} points a scan with {given.noise_mm:g} mm of noise"
    write_json(
        given.out / f"{NAME}.json",
        {"size": given.size, "about": about, "rows": {n: asdict(row) for n, row in rows.items()}},
    )
    write_text(given.out / f"{NAME}.md", text(rows, given.size, about))
    draw(rows, given.out / f"{NAME}.png")
    print(f"wrote {given.out / NAME}.md, .json, .png")
    return 0


def text(rows: dict[str, Fitting], size: str, about: str) -> str:
    """The table as Markdown."""
    lines = [
        "# Expression fitting [FaceTalk, Table 4]",
        "",
        f"Size {size}: {about}. MAE and RMSE are of steps between neighbouring codes; the paper prints "
        f"{FACETALK_4[_WITHOUT][0]:g} and {FACETALK_4[_WITHOUT][1]:g} without, {FACETALK_4[_WITH][0]:g} and "
        f"{FACETALK_4[_WITH][1]:g} with its temporal loss, of another head's codes.",
        "",
        "| | MAE | RMSE | true face from surface, mm | lips' opening: correlation | error, mm | jerk / truth's | autocorrelation, 1 frame |",
        "|---|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {name} | {row.mae:.5f} | {row.rmse:.5f} | {row.surface_mm:.3f} | {row.opening_correlation:.3f} | "
        f"{row.opening_mm:.2f} | {row.jerk:.2f} | {row.autocorrelation[1]:.3f} |"
        for name, row in rows.items()
    ]
    return "\n".join([*lines, "", f"![Autocorrelation]({NAME}.png)", ""])


def draw(rows: dict[str, Fitting], path: Path) -> None:
    """Autocorrelation of the codes by lag [Fig. 9]."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    for name, row in rows.items():
        axis.plot(row.autocorrelation, label=name, linewidth=1.5)
    axis.set_xlabel("lag, frames at 24 fps")
    axis.set_ylabel("autocorrelation of codes")
    axis.legend(fontsize=7, frameon=False)
    axis.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="table_facetalk_4.py",
        description="FaceTalk's Table 4 and Fig. 9: codes fitted with and without a temporal term.",
    )
    parser.add_argument("--data", required=True, metavar="DIR", help="the open corpus")
    shipped = PRETRAINED / "open-small" / "head"
    parser.add_argument("--head", type=Path, default=shipped, help="folder of a head")
    parser.add_argument("--size", choices=tuple(SIZES), default="small")
    parser.add_argument("--noise-mm", type=float, default=0.5, help="of the scans' points")
    parser.add_argument("--out", type=Path, default=Path("results/open"), help="where results go")
    parser.add_argument("--seed", type=int, default=0, help="of points and noise")
    return parser
