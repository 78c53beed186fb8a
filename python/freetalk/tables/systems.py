"""FaceTalk's Table 1: whole systems on held-out speech, by rendered mouths and by lips.

Each system moves one face of the test split. FID and KID are of grey pictures of the mouth against those of the true
motion. LSE-D needs the user's SyncNet, FIQA and VQA the user's functions, and published FIDs the user's Inception.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import freetalk
from freetalk import metrics
from freetalk._files import write_json, write_text
from freetalk._pretrained import find_weights
from freetalk.corpus.linear_face import built_in_face
from freetalk.data import Dataset, MotionSequence, lip_opening, open_dataset
from freetalk.data.landmark_transfer import propose_landmarks
from freetalk.evaluate.clusters import clusters_of
from freetalk.evaluate.crops import (
    ClipScore,
    clip_score,
    dct_features,
    face_frames,
    mouth_frames,
    network_features,
)
from freetalk.evaluate.dataset_truth import origin_of
from freetalk.evaluate.generated import Features, features_of, frechet_distance, kernel_distance
from freetalk.evaluate.report import StatisticsSettings, pooled
from freetalk.evaluate.syncnet import SyncNet, lip_sync_error
from freetalk.evaluate.writers import number
from freetalk.tables.papers import FACETALK_1
from freetalk.train.checkpoint import git_commit
from freetalk.viz import Sequence as Moving

FloatArray = npt.NDArray[np.float32]
#: A clip to vertex displacements (T, V, 3) m at the clip's rate.
System = Callable[[MotionSequence], FloatArray]
#: ``mean`` and, where clips have values of their own, ``low``, ``high`` and ``per_sequence``.
Score = Mapping[str, Any]

NAME = "facetalk_1"
#: Clips and frames of each at most.
SIZES = {"tiny": (1, 12), "small": (20, 150), "full": (100, 300)}
#: The meshing whose count of vertices is nearest to this is shown.
_VERTICES = 8000
_SOURCES = ("running", "facegood", "synthetic", "emodb")
_MOTIONS = {"facetalk": "FaceTalk", "ats": "ATS"}
_LABELS = {
    "fid": "FID",
    "kid": "KID",
    "lve": "LVE, mm²",
    "opening": "lips' opening: correlation",
    "mtm": "MTM, ms",
    "lse_d": "LSE-D",
}


class SystemsTask:
    """Clips, the face that is moved, and scores.

    Args:
        corpus: the open corpus.
        clips: how many of its test split with sound.
        frames: of each at most.
        features: of pictures of the mouth.
        net: the user's SyncNet; ``None`` leaves LSE-D out.
        scores: the user's scores of rendered clips, by name.

    Raises:
        ValueError: the corpus has no such clip, or no meshing in its test split.
    """

    def __init__(
        self,
        corpus: Dataset,
        clips: int,
        frames: int,
        features: Features,
        net: SyncNet | None = None,
        scores: Mapping[str, ClipScore] | None = None,
    ) -> None:
        spoken = [s for s in corpus.sequences("test") if s.has_sound and s.source in _SOURCES]
        meshings = corpus.topologies("test")
        if not spoken or not meshings:
            raise ValueError(f"{corpus.name} has no speech or no face in its test split")
        order = np.random.default_rng(0).permutation(len(spoken))[:clips]
        self.clips = [
            spoken[i].clip(f"{spoken[i].id}", 0, min(frames, spoken[i].num_frames)) for i in order
        ]
        self.corpus = corpus.select(self.clips)
        unit, self._clusters = clusters_of({clip.id: origin_of(clip) for clip in self.clips})
        self.drawn = f"{len(set(self._clusters.values()))} {unit}"
        self.topology = max(meshings, key=lambda m: -abs(corpus.num_vertices(m) - _VERTICES))
        self.mesh = corpus.mesh(corpus.identities("test")[0], self.topology)
        face = propose_landmarks(self.mesh.vertices, self.mesh.faces, built_in_face())
        self._landmarks = face.indices
        self._features, self._net, self._scores = features, net, dict(scores or {})
        self._true = {clip.id: self.truth(clip) for clip in self.clips}
        self._seen = self._pictures(self._true)

    def truth(self, clip: MotionSequence) -> FloatArray:
        """The recorded motion."""
        return self.corpus.vertex_displacements(self.topology, clip)

    def still(self, clip: MotionSequence) -> FloatArray:
        """A face that does not move."""
        return np.zeros((clip.num_frames, *self.mesh.vertices.shape), np.float32)

    def talker(self, talker: freetalk.Talker, engine: str) -> Mapping[str, System]:
        """The mesh moved by a talker's engine, ``stm`` or ``head``: by ``facetalk`` and by ``ats``."""
        mesh = freetalk.Mesh(self.mesh.vertices, self.mesh.faces.tolist())
        face = talker.prepare(mesh, engine=engine, progress=False)

        def speaks(motion: str) -> System:
            def speak(clip: MotionSequence) -> FloatArray:
                audio = freetalk.Audio(self.corpus.audio(clip), 16000)
                animation = face.animate(
                    audio, motion=motion, blinks=False, fps=clip.fps, progress=False
                )
                return np.asarray(animation.displacements)

            return speak

        return {motion: speaks(motion) for motion in ("facetalk", "ats")}

    def predicted(self, folder: Path) -> System:
        """Another system's motion on this face, ``CLIP.npy`` (T, V, 3) m."""

        def read(clip: MotionSequence) -> FloatArray:
            path = folder / f"{clip.id}.npy"
            motion = np.load(path, allow_pickle=False)
            if motion.ndim != 3 or motion.shape[1:] != self.mesh.vertices.shape:
                raise ValueError(
                    f"{path} is {motion.shape}; expected (T, {len(self.mesh.vertices)}, 3)"
                )
            return motion.astype(np.float32)

        return read

    def judged(self, system: System) -> dict[str, Score]:
        """Scores of a system, without those that no clip has.

        FID and KID compare all frames at once and have a mean alone; the others are means over clips with
        their bootstrap intervals, drawn by speakers or takes (``drawn``), and the clips' values.
        """
        made = {clip.id: system(clip) for clip in self.clips}
        seen = self._pictures(made)
        found: dict[str, dict[str, float]] = {}
        for clip in self.clips:
            for name, value in self._by_clip(clip, made[clip.id]).items():
                if np.isfinite(value):
                    found.setdefault(name, {})[clip.id] = value
        return {
            "fid": {"mean": frechet_distance(seen, self._seen)},
            "kid": {"mean": kernel_distance(seen, self._seen)},
            **{
                name: pooled(
                    values, dict.fromkeys(values, 1.0), self._clusters, StatisticsSettings()
                )
                for name, values in found.items()
            },
        }

    def _by_clip(self, clip: MotionSequence, motion: FloatArray) -> dict[str, float]:
        true = self._true[clip.id]
        count = min(len(true), len(motion))
        lips = np.flatnonzero(self.mesh.lip_mask)
        opening, recorded = (lip_opening(one[:count, self._landmarks]) for one in (motion, true))
        moves = opening.std() > 1e-6 and recorded.std() > 1e-6
        values = {
            "lve": 1e6
            * float(metrics.vertex_metric("lve", motion[:count], true[:count], vertices=lips)),
            "opening": float(np.corrcoef(opening, recorded)[0, 1]) if moves else np.nan,
            "mtm": metrics.temporal_misalignment(opening, recorded, clip.fps) if moves else np.nan,
        }
        if self._net is not None or self._scores:
            frames = face_frames(self._moving(motion, clip.fps))
            if self._net is not None:
                values["lse_d"] = lip_sync_error(
                    self._net, frames, self.corpus.audio(clip)
                ).distance
            values |= {name: float(score(frames, 25.0)) for name, score in self._scores.items()}
        return values

    def _pictures(self, motions: Mapping[str, FloatArray]) -> npt.NDArray[np.float64]:
        rates = {clip.id: clip.fps for clip in self.clips}
        frames = [mouth_frames(self._moving(own, rates[name])) for name, own in motions.items()]
        return features_of((picture for clip in frames for picture in clip), self._features)

    def _moving(self, motion: FloatArray, fps: float) -> Moving:
        return Moving(self.mesh.vertices, self.mesh.faces, motion, fps, located=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Moves, renders, judges and writes the table."""
    given = _parser().parse_args(arguments)
    clips, frames = SIZES[given.size]
    features = dct_features if given.features is None else network_features(given.features)
    net = None if given.syncnet is None else SyncNet.from_file(given.syncnet)
    scores = dict(clip_score(spec) for spec in given.score)
    corpus = open_dataset(given.data)
    task = SystemsTask(corpus, clips, frames, features, net, scores)
    weights = find_weights(given.pretrained)
    talker = freetalk.Talker.from_pretrained(weights)
    systems: dict[str, System] = {}
    for engine, label in (("stm", "STM"), ("head", "parametric head")):
        if engine == "head" and not (weights / "head").is_dir():
            continue
        for motion, system in task.talker(talker, engine).items():
            systems[f"{_MOTIONS[motion]}, {label}"] = system
    for spec in given.pred:
        name, _, folder = spec.partition("=")
        systems[name] = task.predicted(Path(folder))
    systems["still face"] = task.still
    if net is not None or scores:  # all else is of its difference from the truth
        systems["the true motion"] = task.truth
    rows = {}
    for name, system in systems.items():
        rows[name] = task.judged(system)
        print(f"{name}: " + ", ".join(f"{k} {_cell(v)}" for k, v in rows[name].items()), flush=True)
    seen = "a user's network" if given.features else "low frequencies of the pictures, no network"
    typed = list(sys.argv[1:] if arguments is None else arguments)
    result = {
        "size": given.size,
        "command": f"python scripts/table_{NAME}.py {shlex.join(typed)}",
        "commit": git_commit(),
        "data_fingerprint": corpus.fingerprint,
        "about": f"{len(task.clips)} clips of the test split, {frames / corpus.fps:.3g} s of each at most, on "
        f"{task.mesh.name} ({len(task.mesh.vertices)} vertices). Features of FID and KID: {seen}",
        "drawn": task.drawn,
        "rows": rows,
    }
    write_json(given.out / f"{NAME}.json", result)
    write_text(given.out / f"{NAME}.md", text(result))
    print(f"wrote {given.out / NAME}.md, .json")
    return 0


def text(result: Mapping[str, Any]) -> str:
    """The table as Markdown."""
    rows: Mapping[str, Mapping[str, Score]] = result["rows"]
    names = list(dict.fromkeys(name for row in rows.values() for name in row))
    printed = "; ".join(
        f"{n}: LSE-D {v[0]:g}, FID {v[1]:g}, KID {v[2]:g}" for n, v in FACETALK_1.items()
    )
    lines = [
        "# Systems [FaceTalk, Table 1]",
        "",
        f"- command: `{result['command']}`",
        f"- size {result['size']}, commit {result['commit'][:12]}, data {result['data_fingerprint']}",
        f"- {result['about']}",
        "- FID and KID are of grey mouths, rendered on the same face, against the true motion's; the paper's are "
        f"against video of people ({printed})",
        f"- [low, high]: 95 % bootstrap interval (BCa) over the clips' {result['drawn']}",
        "",
        "| | " + " | ".join(_LABELS.get(name, name) for name in names) + " |",
        "|---" * (len(names) + 1) + "|",
    ]
    for name, row in rows.items():
        cells = [_cell(row[key]) if key in row else "–" for key in names]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join([*lines, ""])


def _cell(score: Score) -> str:
    mean = number(score["mean"], 3)
    if score.get("low") is None:
        return mean
    return f"{mean} [{number(score['low'], 3)}, {number(score['high'], 3)}]"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="table_facetalk_1.py",
        description="FaceTalk's Table 1: systems by rendered mouths and by lips.",
    )
    parser.add_argument("--data", required=True, metavar="DIR", help="the open corpus")
    parser.add_argument("--pretrained", default="open-small", help="weights with facetalk/")
    parser.add_argument("--size", choices=tuple(SIZES), default="small")
    parser.add_argument("--out", type=Path, default=Path("results/open"), help="where results go")
    parser.add_argument(
        "--pred",
        action="append",
        default=[],
        metavar="NAME=DIR",
        help="another system's motion of the clips on the same face: CLIP.npy (T, V, 3) m; repeatable",
    )
    parser.add_argument(
        "--features", metavar="FILE", help="your TorchScript network, such as FID's Inception"
    )
    parser.add_argument("--syncnet", metavar="FILE", help="your SyncNet, for LSE-D")
    parser.add_argument(
        "--score",
        action="append",
        default=[],
        metavar="NAME=MODULE:FUNCTION",
        help="your score of rendered frames (T, 224, 224, 3) at 25 fps, such as FIQA or VQA; repeatable",
    )
    return parser
