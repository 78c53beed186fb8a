"""Builds the open corpus on disk, in the packed layout of :mod:`freetalk.data.pack`."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from freetalk.corpus import topologies
from freetalk.corpus.assets import FaceModel, load_face_model
from freetalk.corpus.plan import DISJOINT, SIZES, SPLITS, Size, all_jobs
from freetalk.corpus.sequences import FPS, Job, Made, Maker, voice_id
from freetalk.data.pack import FloatArray
from freetalk.data.pack_writer import PackWriter
from freetalk.data.pose import METRES

CONTENTS = 4  # rises when the same size and seed give other sequences
CHUNK = 12
CHUNK_TIMEOUT_S = 900
PROCESSES = 2
#: Full scale of the samples that are written.
_FULL_SCALE = 32767


def build_corpus(
    out: str | os.PathLike[str], size: str = "small", seed: int = 0, progress: bool = True
) -> Path:
    """Builds the open corpus: real and synthetic speech with face motion, identities and meshings.

    `out` appears when it is complete; a call that was stopped goes on when it is made again. A corpus of the same
    size and seed that is already there is kept.

    Args:
        out: folder to create; an existing dataset is replaced.
        size: "tiny" (tests), "small" (what the shipped weights were trained on) or "full".
        seed: of everything random; the same seed gives the same corpus.
        progress: show progress bars.

    Returns:
        The folder.

    Raises:
        ValueError: unknown size, or `out` exists and is no dataset.
        RuntimeError: espeak-ng or flite is missing.
    """
    if size not in SIZES:
        raise ValueError(f"size is {size!r}: use one of {', '.join(SIZES)}")
    out = Path(out)
    key = {"corpus": CONTENTS, "size": size, "seed": seed}
    with PackWriter(out, key, replace=True) as writer:
        if not writer.complete:
            _write(writer, size, seed, progress)
    return out


def _make_chunk(jobs: list[Job]) -> list[tuple[Made, FloatArray]]:
    """Sequences and their landmarks (T, 68, 3) m."""
    maker = Maker()
    basis = maker.model.landmark_basis.reshape(len(maker.model.expression_names), -1)
    made = [maker.make(job) for job in jobs]
    return [(one, (one.weights @ basis).reshape(-1, 68, 3)) for one in made]


def _made_in_order(jobs: list[Job], writer: PackWriter) -> Iterator[tuple[Made, FloatArray]]:
    """Makes the jobs in chunks, each in a fresh process: speech engines keep state, which must not leak.

    The pool forks while the caller goes on, so that the caller must not multiply matrices meanwhile: OpenBLAS
    would wait for ever for threads that it stops before a fork.
    """
    chunks = [jobs[i : i + CHUNK] for i in range(0, len(jobs), CHUNK)]
    chunks = [chunk for chunk in chunks if not all(writer.knows(job.id) for job in chunk)]
    context = multiprocessing.get_context("fork")
    with context.Pool(PROCESSES, maxtasksperchild=1) as pool:
        results = pool.imap(_make_chunk, chunks)
        for chunk in chunks:
            try:
                made = results.next(timeout=CHUNK_TIMEOUT_S)
            except multiprocessing.TimeoutError as error:
                names = f"{chunk[0].id} to {chunk[-1].id}"
                raise RuntimeError(f"a worker stopped while making {names}: build again") from error
            yield from (one for one in made if not writer.knows(one[0].job.id))
        # Leaving a pool terminates it, and one that replaces a worker meanwhile waits for it for ever.
        pool.close()
        pool.join()


def _write(writer: PackWriter, size: str, seed: int, progress: bool) -> None:
    model, plan = load_face_model(), SIZES[size]
    jobs = all_jobs(plan, seed)
    splits = np.repeat(SPLITS, plan.identities)
    faces = _faces_of(jobs, splits, seed)
    left = len(jobs) - len(writer.sequences)
    sequences = _made_in_order(jobs, writer)
    for made, landmarks in tqdm(sequences, "sequences", total=left, disable=not progress):
        job = made.job
        writer.add(
            {
                "id": job.id,
                "split": [job.split],
                "source": job.source,
                "take": job.take or "+".join(job.clips) or None,
                "emotion": job.emotion,
                "intensity": job.intensity,
                "identity": faces[job.id],
                "voice": voice_id(job),
                "text": job.text,
            },
            landmarks,
            made.weights,
            np.rint(made.audio * _FULL_SCALE).clip(-_FULL_SCALE - 1, _FULL_SCALE).astype(np.int16),
            sound=job.audio or "",
            phones=[[round(p.start_s, 4), round(p.end_s, 4), p.label] for p in made.phones],
        )
    meshings = _topologies(model, size, seed, progress)
    manifest = {
        "name": "open",
        "fps": FPS,
        "expressions": list(model.expression_names),
        "moves": "all",
        "splits": {
            "corpus": "unseen voices, sentences, takes, faces and meshings, as far as test_disjoint_by says"
        },
        "facts": {"kind": "open", "size": size, "seed": seed, **METRES.describe()},
        "identities": [
            {"name": str(index), "split": str(split), "origin": [0.0, 0.0, 0.0]}
            for index, split in enumerate(splits)
        ],
        "topologies": [entry for entry, _ in meshings],
        "test_disjoint_by": {source: list(fields) for source, fields in DISJOINT.items()},
    }
    arrays = {entry["name"]: own for entry, own in meshings}
    identities = _identities(model, plan, seed)
    writer.finish(manifest, identities, arrays, landmark_basis=model.landmark_basis)


def _identities(model: FaceModel, plan: Size, seed: int) -> np.ndarray:
    rng = np.random.default_rng([seed, 8])
    drawn = rng.normal(0, 0.85, (sum(plan.identities), len(model.identity_basis)))
    return np.clip(drawn, -2.2, 2.2).astype(np.float32)


def _topologies(
    model: FaceModel, size: str, seed: int, progress: bool
) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """Entries of the manifest with the arrays of the meshings."""
    chosen = [
        spec
        for spec in topologies.TOPOLOGIES
        if size != "tiny" or spec.name in topologies.TINY_TOPOLOGIES
    ]
    made = []
    for spec in tqdm(chosen, "topologies", disable=not progress):
        arrays = topologies.topology_arrays(model, spec, seed)
        entry = {
            "name": spec.name,
            "split": spec.split,
            "file": f"topologies/{spec.name}.npz",
            "num_vertices": len(arrays["neutral"]),
            "num_faces": len(arrays["faces"]),
            "description": spec.description,
        }
        made.append((entry, arrays))
    return made


def _faces_of(jobs: list[Job], splits: np.ndarray, seed: int) -> dict[str, int]:
    """The face that each sequence is shown on."""
    rng = np.random.default_rng([seed, 9])
    by_split = {split: np.flatnonzero(splits == split) for split in SPLITS}
    return {job.id: int(rng.choice(by_split[job.split])) for job in jobs}
