"""A table: rows of trainings and scores, each stored as a JSON as soon as it is done."""

from __future__ import annotations

import hashlib
import json
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from tqdm import tqdm

from freetalk._files import content_hash, write_json
from freetalk.data import Dataset, MotionSequence
from freetalk.evaluate import PredictionSettings, score_predictions
from freetalk.evaluate.dataset_truth import DatasetTruth
from freetalk.evaluate.facetalk import SpeechToCodes
from freetalk.evaluate.metric_specs import spec_of
from freetalk.evaluate.pretrained import LandmarksToMesh, SpeechToMotion
from freetalk.tables.claims import Claim
from freetalk.tables.scoring import (
    ROUGHNESS,
    ClipScores,
    FloatArray,
    code_scores,
    encoder_folder,
    landmark_scores,
    mesh_scores,
    spoken,
    still_face,
)
from freetalk.tables.sets import Catalogue
from freetalk.tables.training import Trained, Training, train
from freetalk.tables.views import ViewOptions, faces_of
from freetalk.train.checkpoint import git_commit

#: Changes when stored rows are no longer comparable.
_VERSION = 2
RowResult = dict[str, Any]


@dataclass(frozen=True)
class Row:
    """A row that is trained here.

    Attributes:
        name: as printed.
        stm: of the landmarks-to-mesh stage; ``None`` scores landmarks.
        ats: of the audio-to-landmarks stage; ``None`` moves meshes by true landmarks. A row without
            either is a face that does not move.
        paper: what the paper prints, by dataset (``all`` for one number) and metric.
        facetalk: of FaceTalk's denoiser, in place of both stages; its landmarks are scored.
    """

    name: str
    stm: Training | None
    ats: Training | None
    paper: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    facetalk: Training | None = None

    def again(self, seed: int) -> Row:
        """The same row trained with another seed."""

        def seeded(training: Training | None) -> Training | None:
            if training is None:
                return None
            return replace(training, overrides=(*training.overrides, f"loop.seed={seed}"))

        name = f"{self.name}, seed {seed}"
        trainings = seeded(self.stm), seeded(self.ats), self.paper, seeded(self.facetalk)
        return Row(name, *trainings)

    def trainings(self) -> dict[str, Training]:
        """What is trained for it, by kind."""
        kinds = {"stm": self.stm, "ats": self.ats, "facetalk": self.facetalk}
        return {kind: training for kind, training in kinds.items() if training is not None}


@dataclass(frozen=True)
class Table:
    """A table of a paper, or one of ours.

    Attributes:
        name: of its files, such as ``supp_1``.
        title: its heading.
        rows: top to bottom.
        tests: datasets whose test split is scored.
        view: clips that are scored.
        metrics: left to right.
        claims: what the paper says of it.
        notes: what a reader must know, a sentence each.
        pooled: one number over all test sets, instead of one a set.
    """

    name: str
    title: str
    rows: tuple[Row, ...]
    tests: tuple[str, ...]
    view: ViewOptions
    metrics: tuple[str, ...]
    claims: tuple[Claim, ...] = ()
    notes: tuple[str, ...] = ()
    pooled: bool = False


class TableRun:
    """Makes the rows of a table one after the other.

    Args:
        table: what is made.
        catalogue: the datasets.
        work: folder of trainings and rows, which a later call goes on from.
        encoder: folder of the speech encoder; empty: the shipped one.
        sampler: fields of ``GenerateOptions``.
        device: where rows are scored; ``None``: a GPU where there is one.

    Raises:
        ValueError: a test set is not given, or lacks a mask.
    """

    def __init__(
        self,
        table: Table,
        catalogue: Catalogue,
        work: Path,
        encoder: str = "",
        sampler: Mapping[str, object] | None = None,
        device: str | None = None,
    ) -> None:
        self.table, self.catalogue, self.work = table, catalogue, work
        self._encoder, self._sampler, self._device = encoder, dict(sampler or {}), device
        self._views = {name: catalogue.view(name, table.view) for name in table.tests}
        self._fingerprints = {name: view.fingerprint for name, view in self._views.items()}
        for name, view in self._views.items():
            if not faces_of(view, "test"):
                raise ValueError(f"{name} has no test clip; {catalogue.describe().get(name, name)}")
        if any(row.stm is not None for row in table.rows):
            self._check_masks()
        self._made: dict[tuple[str, str], dict[str, FloatArray]] = {}

    def rows(self, only: Sequence[str] = (), seeds: Sequence[int] = (0,)) -> list[RowResult]:
        """Results of all rows, or of those named, averaged over seeds; finished ones are read back.

        Args:
            only: names of rows; empty: all.
            seeds: the first is that of the table's trainings, the others are trained besides.

        Raises:
            ValueError: no row is called so.
        """
        known = [row.name for row in self.table.rows]
        unknown = [name for name in only if name not in known]
        if unknown:
            raise ValueError(f"no row {unknown[0]!r} in this table; rows: {', '.join(known)}")
        wanted = [row for row in self.table.rows if not only or row.name in only]
        runs: dict[str, list[RowResult]] = {row.name: [] for row in wanted}
        for turn, seed in enumerate(seeds):
            for row in wanted:
                if turn == 0:
                    runs[row.name].append(self._row(row))
                elif row.trainings():
                    runs[row.name].append(self._row(row.again(seed)))
        return [merged(name, own) for name, own in runs.items()]

    def stored(self, row: Row) -> RowResult | None:
        """A row that was made before with the same trainings and scores."""
        path = self._path(row)
        return json.loads(path.read_text()) if path.is_file() else None

    def predictions(self, folders: Sequence[tuple[str, Path]]) -> list[RowResult]:
        """Rows of other systems, from their predictions of the test clips on the tables' meshings.

        Args:
            folders: (name, folder) of each; with several test sets, a folder of each set's name below.

        Raises:
            ValueError, OSError: what is missing or wrong.
        """
        results = []
        for name, directory in folders:
            scores = {}
            for test, view in self._views.items():
                folder = directory / test if len(self._views) > 1 else directory
                truth = DatasetTruth(view, "test", view.topologies("test")[0])
                names = [metric for metric in self.table.metrics if metric != ROUGHNESS]
                found = score_predictions(
                    [(name, folder)],
                    truth,
                    truth.masks,
                    truth.lip_pairs,
                    PredictionSettings(metrics=names),
                )
                values = {metric: found.values[metric][name] for metric in names}
                scores[test] = ClipScores(values, found.frames, found.origins).to_dict()
            run = {"predictions": str(directory), "trainings": [], "scores": scores}
            run |= {"commit": git_commit(), "fingerprints": self._fingerprints}
            results.append(merged(name, [run]))
        return results

    def _check_masks(self) -> None:
        """Says before a training that a metric has no vertices."""
        wanted = {spec_of(name).mask for name in self.table.metrics if name != ROUGHNESS} - {"all"}
        for name, view in self._views.items():
            _, identity, topology = faces_of(view, "test")[0]
            mesh = view.mesh(identity, topology)
            found = {"lips": mesh.lip_mask.any(), "upper": mesh.upper_face_mask.any()}
            lacking = sorted(mask for mask in wanted if not found[mask])
            if lacking:
                raise ValueError(
                    f"{name} has no mask of the {' and the '.join(lacking)} (docs/datasets.md says where it goes)"
                )

    def _row(self, row: Row) -> RowResult:
        found = self.stored(row)
        if found is not None:
            tqdm.write(f"{self.table.name}: {row.name} is done already", file=sys.stderr)
            return found
        tqdm.write(f"{self.table.name}: {row.name}", file=sys.stderr)
        trained = {
            kind: train(training, self.catalogue, self.work)
            for kind, training in row.trainings().items()
        }
        began = time.perf_counter()
        scores = {name: self._scores(row, trained, view) for name, view in self._views.items()}
        result = {
            "key": self._key(row),
            "name": row.name,
            "trainings": [one.record for one in trained.values()],
            "scores": {name: own.to_dict() for name, own in scores.items()},
            "scoring_minutes": round((time.perf_counter() - began) / 60, 2),
            "commit": git_commit(),
            "fingerprints": self._fingerprints,
        }
        path = self._path(row)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, result)
        return result

    def _scores(self, row: Row, trained: Mapping[str, Trained], view: Dataset) -> ClipScores:
        names = self.table.metrics
        if not trained:
            return still_face(view, names, all(one.stm is None for one in self.table.rows))
        if "facetalk" in trained:
            where, encoder = trained["facetalk"].directory, encoder_folder(self._encoder)
            model = SpeechToCodes(encoder, where, self._sampler, self._device)
            return code_scores(model, view, names)
        made = self._spoken(trained["ats"].directory, view) if "ats" in trained else None

        def landmarks(clip: MotionSequence) -> FloatArray:
            return view.landmarks(clip) if made is None else made[clip.id]

        if "stm" not in trained:
            return landmark_scores(view, names, landmarks)
        return mesh_scores(
            LandmarksToMesh(trained["stm"].directory, self._device), view, names, landmarks
        )

    def _spoken(self, directory: Path, view: Dataset) -> dict[str, FloatArray]:
        """Landmarks of a view's test clips, made once for all rows that share the weights."""
        key = (str(directory), view.name)
        if key not in self._made:
            encoder = encoder_folder(self._encoder)
            model = SpeechToMotion(encoder, directory, self._sampler, self._device)
            self._made[key] = spoken(model, view)
        return self._made[key]

    def _path(self, row: Row) -> Path:
        name = "".join(c if c.isalnum() else "_" for c in row.name).strip("_")
        return self.work / "rows" / self.table.name / f"{name}-{self._key(row)}.json"

    def _key(self, row: Row) -> str:
        hears = row.ats is not None or row.facetalk is not None
        content = {
            "version": _VERSION,
            "trainings": [t.key(self.catalogue) for t in row.trainings().values()],
            "tests": self._fingerprints,
            "metrics": list(self.table.metrics),
            "sampler": self._sampler if hears else {},
            "encoder": content_hash(encoder_folder(self._encoder)) if hears else "",
        }
        text = json.dumps(content, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:12]


def merged(name: str, runs: Sequence[RowResult]) -> RowResult:
    """A row of several runs: the mean of their values clip by clip, and the runs."""
    first = runs[0]["scores"]
    return {
        "name": name,
        "runs": list(runs),
        "scores": {
            test: {
                "frames": own["frames"],
                "origins": own.get("origins", {}),
                "values": {
                    metric: {
                        clip: sum(run["scores"][test]["values"][metric][clip] for run in runs)
                        / len(runs)
                        for clip in values
                    }
                    for metric, values in own["values"].items()
                },
            }
            for test, own in first.items()
        },
    }
