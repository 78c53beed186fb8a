"""What the audio stage is trained on: the sequences it can hear, at one frame rate, through one speech encoder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from freetalk._pretrained import PRETRAINED
from freetalk.data import Dataset, MotionSequence
from freetalk.train.initial import initial_weights
from freetalk.train.task_options import AtsTaskOptions, DenoisingTaskOptions


def audible(sequences: list[MotionSequence]) -> list[MotionSequence]:
    """Sequences with sound, and those whose silence is meant."""
    return [s for s in sequences if s.has_sound or s.source == "rest"]


def frame_rate(model: dict[str, Any], source_weights: dict[str, float], corpus: Dataset) -> float:
    """The model's frame rate: ``model.fps``, else the one that all sequences share.

    Raises:
        ValueError: they have several.
    """
    if "fps" in model:
        return float(model["fps"])
    taken = corpus.sequences("train")
    rates: dict[float, set[str]] = {}
    for s in [s for s in taken if source_weights.get(s.source, 0) > 0] or taken:
        rates.setdefault(s.fps, set()).add(s.source)
    if len(rates) > 1:
        found = "; ".join(f"{', '.join(sorted(who))}: {fps:g}" for fps, who in rates.items())
        raise ValueError(
            f"the sequences of {corpus.name} have several frame rates ({found}) and a model has one; "
            "name it as model.fps=RATE, and all motion is resampled to it"
        )
    return next(iter(rates), corpus.fps)


def named_encoder(name: str) -> Path:
    """The folder of a speech encoder: `name` itself, or that of installed weights of this name."""
    shipped = PRETRAINED / name / "speech"
    return shipped if not Path(name).exists() and shipped.is_dir() else Path(name)


def speech_encoder(options: DenoisingTaskOptions, out: Path) -> Path:
    """Folder of the speech encoder that the options name or imply, never one that nobody named.

    Raises:
        FileNotFoundError: none is named, and none lies where one would.
    """
    if options.speech_encoder:
        return named_encoder(options.speech_encoder)
    beside = [out / "speech"]
    kind = "ats" if isinstance(options, AtsTaskOptions) else "facetalk"
    if options.init:
        beside.append(initial_weights(options.init, kind).parent / "speech")
    for folder in beside:
        if (folder / "config.json").is_file():
            return folder
    raise FileNotFoundError(
        f"no speech encoder: there is none in {' or '.join(map(str, beside))}. Name one as "
        "task.speech_encoder=DIR (HuBERT or wav2vec 2.0 as transformers saves it, or what "
        "`freetalk train speech` wrote), or the shipped small one as task.speech_encoder=open-small"
    )
