"""Builds the open corpus on disk."""

from __future__ import annotations

import json
import multiprocessing
import os
import shutil
import uuid
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from freetalk.corpus import topologies
from freetalk.corpus.assets import FaceModel, load_face_model
from freetalk.corpus.emotion import EMOTIONS
from freetalk.corpus.plan import DISJOINT, SIZES, SPLITS, Size, all_jobs
from freetalk.corpus.sequences import FPS, SAMPLE_RATE_HZ, Job, Made, Maker, voice_id

FORMAT = "freetalk-open-corpus"
VERSION = 1
CONTENTS = 3  # rises when the same size and seed give other sequences
CHUNK = 12
CHUNK_TIMEOUT_S = 900
PROCESSES = 2


def build_corpus(
    out: str | os.PathLike[str], size: str = "small", seed: int = 0, progress: bool = True
) -> Path:
    """Builds the open corpus: real and synthetic speech with face motion, identities and meshings.

    The corpus is written next to `out` and renamed when complete, so `out` is never half-written. A corpus of the same
    size and seed that is already there is kept.

    Args:
        out: folder to create; an existing corpus of another size or seed is replaced.
        size: "tiny" (tests), "small" (what the shipped weights were trained on) or "full".
        seed: of everything random; the same seed gives the same corpus.
        progress: show progress bars.

    Returns:
        The folder.

    Raises:
        ValueError: unknown size, or `out` exists and is not a corpus.
        RuntimeError: espeak-ng or flite is missing.
    """
    if size not in SIZES:
        raise ValueError(f"size is {size!r}: use one of {', '.join(SIZES)}")
    out = Path(out)
    if _is_complete(out, size, seed):
        return out
    if out.exists() and any(out.iterdir()) and not (out / "manifest.json").is_file():
        raise ValueError(f"{out} exists and is not a corpus: choose another folder")
    work = out.parent / f".{out.name}.{uuid.uuid4().hex[:8]}.partial"
    (work / "audio").mkdir(parents=True)
    (work / "topologies").mkdir()
    try:
        _write(work, size, seed, progress)
        if out.exists():
            shutil.rmtree(out)
        work.rename(out)
    finally:
        shutil.rmtree(work, ignore_errors=True)
    return out


def _is_complete(out: Path, size: str, seed: int) -> bool:
    try:
        manifest = json.loads((out / "manifest.json").read_text())
    except (OSError, ValueError):
        return False
    wanted = {
        "format": FORMAT,
        "version": VERSION,
        "contents": CONTENTS,
        "size": size,
        "seed": seed,
    }
    return all(manifest.get(key) == value for key, value in wanted.items())


def _make_chunk(out: Path, jobs: list[Job]) -> list[Made]:
    maker = Maker(out)
    return [maker.make(job) for job in jobs]


def _made_in_order(work: Path, jobs: list[Job]) -> Iterator[Made]:
    """Makes the jobs in chunks, each in a fresh process: speech engines keep state, which must not leak."""
    chunks = [jobs[i : i + CHUNK] for i in range(0, len(jobs), CHUNK)]
    context = multiprocessing.get_context("fork")
    with context.Pool(PROCESSES, maxtasksperchild=1) as pool:
        results = pool.imap(partial(_make_chunk, work), chunks)
        for chunk in chunks:
            try:
                yield from results.next(timeout=CHUNK_TIMEOUT_S)
            except multiprocessing.TimeoutError as error:
                names = f"{chunk[0].id} to {chunk[-1].id}"
                raise RuntimeError(f"a worker stopped while making {names}: build again") from error


def _write(work: Path, size: str, seed: int, progress: bool) -> None:
    model = load_face_model()
    plan = SIZES[size]
    jobs = all_jobs(plan, seed)
    made = list(
        tqdm(_made_in_order(work, jobs), "sequences", total=len(jobs), disable=not progress)
    )
    weights = np.concatenate([m.weights for m in made])
    basis = model.landmark_basis.reshape(len(model.expression_names), -1)
    np.save(work / "weights.npy", weights)
    np.save(work / "landmarks.npy", (weights @ basis).reshape(-1, 68, 3).astype(np.float32))
    phones = {
        m.job.audio: [[round(p.start_s, 4), round(p.end_s, 4), p.label] for p in m.phones]
        for m in made
        if m.phones
    }
    (work / "phones.json").write_text(json.dumps(phones))
    identities = _identities(work, model, plan, seed)
    meshes = _topologies(work, model, size, seed, progress)
    manifest = {
        "format": FORMAT,
        "version": VERSION,
        "contents": CONTENTS,
        "size": size,
        "seed": seed,
        "fps": FPS,
        "sample_rate_hz": SAMPLE_RATE_HZ,
        "emotions": list(EMOTIONS),
        "expressions": list(model.expression_names),
        "sequences": _sequence_entries(made, identities, seed),
        "identities": identities,
        "topologies": meshes,
        "test_disjoint_by": {source: list(fields) for source, fields in DISJOINT.items()},
    }
    (work / "manifest.json").write_text(json.dumps(manifest, indent=1))


def _identities(work: Path, model: FaceModel, plan: Size, seed: int) -> list[dict[str, object]]:
    rng = np.random.default_rng([seed, 8])
    count = sum(plan.identities)
    coefficients = np.clip(rng.normal(0, 0.85, (count, len(model.identity_basis))), -2.2, 2.2)
    np.save(work / "identities.npy", coefficients.astype(np.float32))
    splits = np.repeat(SPLITS, plan.identities)
    return [{"index": i, "split": str(split)} for i, split in enumerate(splits)]


def _topologies(
    work: Path, model: FaceModel, size: str, seed: int, progress: bool
) -> list[dict[str, object]]:
    chosen = [
        spec
        for spec in topologies.TOPOLOGIES
        if size != "tiny" or spec.name in topologies.TINY_TOPOLOGIES
    ]
    entries: list[dict[str, object]] = []
    for spec in tqdm(chosen, "topologies", disable=not progress):
        arrays: dict[str, Any] = dict(topologies.topology_arrays(model, spec, seed))
        file = f"topologies/{spec.name}.npz"
        np.savez(work / file, **arrays)
        entries.append(
            {
                "name": spec.name,
                "split": spec.split,
                "file": file,
                "num_vertices": len(arrays["neutral"]),
                "num_faces": len(arrays["faces"]),
                "description": spec.description,
            }
        )
    return entries


def _sequence_entries(
    made: list[Made], identities: list[dict[str, object]], seed: int
) -> list[dict[str, object]]:
    rng = np.random.default_rng([seed, 9])
    by_split = {s: [k for k, i in enumerate(identities) if i["split"] == s] for s in SPLITS}
    entries: list[dict[str, object]] = []
    start = 0
    for item in made:
        job = item.job
        entries.append(
            {
                "id": job.id,
                "split": job.split,
                "source": job.source,
                "take": job.take or "+".join(job.clips) or None,
                "audio": job.audio,
                "start_frame": start,
                "num_frames": len(item.weights),
                "emotion": job.emotion,
                "intensity": job.intensity,
                "identity": int(rng.choice(by_split[job.split])),
                "voice": voice_id(job),
                "text": job.text,
            }
        )
        start += len(item.weights)
    return entries
