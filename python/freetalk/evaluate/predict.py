"""Motion that a folder of weights predicts for a split of a dataset, one file a clip and performance."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from freetalk._files import content_hash, replacing, write_json
from freetalk.data import Dataset, MotionSequence
from freetalk.evaluate.dataset_truth import LANDMARKS
from freetalk.evaluate.pretrained import LandmarksToMesh, SpeechToMotion

FloatArray = npt.NDArray[np.float32]
RECORD = "prediction.json"


@dataclass(frozen=True)
class PredictOptions:
    """What is predicted.

    Attributes:
        split: of the dataset.
        topology: meshing that the faces have, or ``landmarks`` for the 68 points; ``None``: the split's only one.
        driver: ``speech``, or ``landmarks``: the recorded ones, which show the landmarks-to-mesh stage alone.
        samples: performances of each clip; recorded landmarks give one.
        seed: of the first performance of the first clip; every other has one of its own.
        sampling: fields of ``GenerateOptions`` that win over the weights' own.
    """

    split: str = "test"
    topology: str | None = None
    driver: str = "speech"
    samples: int = 1
    seed: int = 0
    sampling: Mapping[str, object] = field(default_factory=dict)


def predict(
    dataset: Dataset,
    pretrained: Path,
    out: Path,
    options: PredictOptions,
    *,
    device: str | None = None,
    batch: int = 0,
) -> int:
    """Writes ``NAME.npz``, or ``NAME_sampleK.npz`` of several performances, as ``evaluate --pred`` reads them.

    A file holds ``displacements`` (T, V, 3) float32 m in the axes of the dataset's files, ``fps`` (the clip's) and
    ``metres_per_unit``. Files that are there already are kept, so that a stopped call goes on.

    Args:
        dataset: whose clips they are.
        pretrained: folder of weights with ``speech`` and ``ats``, ``stm``, or all, as the options need.
        out: folder to write to.
        options: what is predicted.
        device: where it runs; ``None``: a GPU where there is one.
        batch: clips that are sampled together; 0: 16 on a GPU, else one.

    Returns:
        How many files the prediction has.

    Raises:
        ValueError: the split has no clip or several meshings, the weights do not know an emotion, or the
            folder holds another prediction.
        FileNotFoundError: weights that are needed are missing.
    """
    topology = options.topology or _only_topology(dataset, options.split)
    spoken = options.driver == "speech"
    clips = [c for c in dataset.sequences(options.split) if c.has_sound or not spoken]
    if not clips:
        what = "clip with sound" if spoken else "clip"
        raise ValueError(f"{dataset.name} has no {what} in its split {options.split!r}")
    needed = [*(("speech", "ats") if spoken else ()), *(("stm",) if topology != LANDMARKS else ())]
    _claim(out, dataset, {name: pretrained / name for name in needed}, topology, options)
    count = options.samples if spoken else 1
    wanted = {clip.id: _paths(out, clip.id, count) for clip in clips}
    seeds = {
        clip.id: list(range(options.seed + at * count, options.seed + (at + 1) * count))
        for at, clip in enumerate(clips)
    }
    left = [clip for clip in clips if not all(path.is_file() for path in wanted[clip.id])]
    mesh = LandmarksToMesh(pretrained / "stm", device) if "stm" in needed and left else None
    motions: Iterator[tuple[MotionSequence, FloatArray]]
    if spoken and left:
        speaker = SpeechToMotion.of(pretrained, options.sampling, device)
        motions = speaker.perform(dataset, left, [seeds[clip.id] for clip in left], batch)
    else:
        motions = ((clip, dataset.landmarks(clip)[None]) for clip in left)
    for clip, several in tqdm(motions, desc="predict", total=len(left), unit="clip"):
        for path, moved in zip(wanted[clip.id], several, strict=True):
            if mesh is not None:
                face = clip.topology or topology
                moved = mesh.vertices(dataset, clip.identity, face, moved).numpy()
            pose, _ = dataset.source_frame(clip)  # metres, in the axes of the source's files
            _write(path, moved @ pose.rotation, clip.fps)
    return count * len(clips)


def _only_topology(dataset: Dataset, split: str) -> str:
    known = dataset.topologies(split)
    if len(known) != 1:
        raise ValueError(
            f"{dataset.name} has the meshings {', '.join(known) or 'none'} in its split {split!r}: choose one "
            f"with --topology, or the 68 points with --topology {LANDMARKS}"
        )
    return known[0]


def _claim(
    out: Path,
    dataset: Dataset,
    weights: Mapping[str, Path],
    topology: str,
    options: PredictOptions,
) -> None:
    """Notes what the folder holds; refuses one that holds something else."""
    for name, folder in weights.items():
        if not (folder / "config.json").is_file():
            raise FileNotFoundError(f"{folder.parent} has no {name}, which this prediction needs")
    record = {
        "dataset": dataset.name,
        "fingerprint": dataset.fingerprint,
        "weights": {name: content_hash(folder) for name, folder in weights.items()},
        "options": {**asdict(options), "topology": topology, "sampling": dict(options.sampling)},
    }
    path = out / RECORD
    if path.is_file() and json.loads(path.read_text()) != json.loads(json.dumps(record)):
        raise ValueError(
            f"{out} holds another prediction ({RECORD}): of other data, weights or options; give another --out"
        )
    write_json(path, record)


def _paths(out: Path, name: str, samples: int) -> Sequence[Path]:
    if samples == 1:
        return [out / f"{name}.npz"]
    return [out / f"{name}_sample{number}.npz" for number in range(samples)]


def _write(path: Path, displacements: FloatArray, fps: float) -> None:
    with replacing(path) as temporary:
        np.savez(
            temporary,
            displacements=displacements.astype(np.float32),
            fps=np.float64(fps),
            metres_per_unit=np.float64(1.0),
        )
