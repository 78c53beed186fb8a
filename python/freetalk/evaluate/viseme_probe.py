"""How much of the lips a speech encoder hears: a linear probe of viseme classes, frame by frame.

The probe is multinomial logistic regression on one hidden state of one frame, standardised: no context, no hidden layer, the
encoder left as it is. Whatever accuracy it reaches is linearly there in the features.

The twelve classes are those of Jeffers and Barley (Speechreading, 1971) in ARPABET, silence among them: of the published
maps the one that kept most of visual speech apart in Cappelletta and Harte (2012). The map holds schwa and AH in one class,
which the aligner's dictionary does not tell apart; HH, which has no lip shape of its own, counts with the open vowels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional
from tqdm import tqdm

from freetalk.audio import load_audio
from freetalk.corpus.alignment import aligned_files
from freetalk.corpus.phones import Phone
from freetalk.data import Dataset
from freetalk.speech import SAMPLE_RATE_HZ, EncodeOptions, SpeechEncoder, encode_speech

VISEMES: dict[str, tuple[str, ...]] = {
    "p b m": ("P", "B", "M"),
    "f v": ("F", "V"),
    "th dh": ("TH", "DH"),
    "t d n l": ("T", "D", "N", "L"),
    "s z": ("S", "Z"),
    "sh zh ch jh": ("SH", "ZH", "CH", "JH"),
    "k g ng": ("K", "G", "NG"),
    "r w uw uh ow er": ("R", "W", "UW", "UH", "OW", "ER"),
    "ao oy": ("AO", "OY"),
    "aw": ("AW",),
    "open vowels": ("AA", "AE", "AH", "AX", "AY", "EH", "EY", "IH", "IY", "Y", "HH"),
    "silence": ("sil",),
}
"""Class to phones."""
SILENCE = list(VISEMES).index("silence")
_CLASS_OF = {phone: i for i, phones in enumerate(VISEMES.values()) for phone in phones}

Labels = npt.NDArray[np.int64]
Confusion = npt.NDArray[np.int64]
#: A recording: samples (S,) at 16 kHz and its phones.
Recording = tuple[npt.NDArray[np.float32], Sequence[Phone]]

_PENALTY = 1e-4  # of the squared weights, which standardised features make comparable
_STEPS = 60


@dataclass(frozen=True)
class LinearProbe:
    """``argmax((x - mean) / spread @ weight + bias)``; mean and spread (C,), weight (C, K), bias (K,)."""

    mean: Tensor
    spread: Tensor
    weight: Tensor
    bias: Tensor

    def predict(self, features: Tensor) -> Labels:
        """(N, C) to the class of each frame, (N,)."""
        scores = (features.float() - self.mean) / self.spread @ self.weight + self.bias
        return scores.argmax(dim=1).numpy()


def viseme_labels(phones: Sequence[Phone], times_s: npt.ArrayLike) -> Labels:
    """Class of each moment; silence outside all phones.

    Args:
        phones: in order of time.
        times_s: (N,) moments in seconds.
    """
    times = np.asarray(times_s, dtype=np.float64)
    if not phones:
        return np.full(len(times), SILENCE, dtype=np.int64)
    starts = np.array([phone.start_s for phone in phones])
    ends = np.array([phone.end_s for phone in phones])
    classes = np.array([_CLASS_OF[phone.label] for phone in phones], dtype=np.int64)
    index = np.clip(np.searchsorted(starts, times, side="right") - 1, 0, None)
    return np.where((times >= starts[index]) & (times < ends[index]), classes[index], SILENCE)


def fit_probe(
    features: Tensor, labels: Labels, weights: Tensor | None = None, num_classes: int = len(VISEMES)
) -> LinearProbe:
    """Logistic regression by L-BFGS: the optimum of a convex loss, with no chance in it.

    Args:
        features: (N, C).
        labels: (N,) in [0, num_classes).
        weights: (N,) of the frames in the loss, all alike by default.
        num_classes: K.
    """
    share = torch.ones(len(labels)) if weights is None else weights.float()
    share = share / share.sum()
    values = features.float()
    mean = share @ values
    spread = (share @ (values - mean).square()).sqrt().clamp_min(1e-6)
    values = (values - mean) / spread
    weight = torch.zeros(values.shape[1], num_classes, requires_grad=True)
    bias = torch.zeros(num_classes, requires_grad=True)
    target = torch.from_numpy(labels)
    optimizer = torch.optim.LBFGS(
        [weight, bias], max_iter=_STEPS, history_size=10, line_search_fn="strong_wolfe"
    )

    def loss() -> Tensor:
        optimizer.zero_grad()
        entropy = functional.cross_entropy(values @ weight + bias, target, reduction="none")
        total = share @ entropy + _PENALTY * weight.square().sum()
        total.backward()  # type: ignore[no-untyped-call]
        return total

    optimizer.step(loss)  # type: ignore[arg-type]
    return LinearProbe(mean, spread, weight.detach(), bias.detach())


def confusion_matrix(
    truth: Labels, predicted: Labels, num_classes: int = len(VISEMES)
) -> Confusion:
    """(K, K) counts, a row for each true class."""
    counts = np.zeros((num_classes, num_classes), dtype=np.int64)
    np.add.at(counts, (truth, predicted), 1)
    return counts


def scores_of(counts: Confusion) -> dict[str, Any]:
    """Accuracy over all frames and over those of speech, recall of each class, and the counts.

    ``largest_class`` is the accuracy of always answering with the most frequent class, for comparison.
    """
    speech = np.delete(counts, SILENCE, axis=0)
    correct = np.diagonal(counts)
    recall = correct / np.maximum(counts.sum(axis=1), 1)
    return {
        "frames": int(counts.sum()),
        "accuracy": float(correct.sum() / max(1, counts.sum())),
        "accuracy_speech": float((correct.sum() - correct[SILENCE]) / max(1, speech.sum())),
        "largest_class": float(counts.sum(axis=1).max() / max(1, counts.sum())),
        "recall": {name: float(value) for name, value in zip(VISEMES, recall)},
        "confusion": counts.tolist(),
    }


def corpus_recordings(corpus: Dataset, split: str, limit: int = 0) -> dict[str, Recording]:
    """Synthetic speech of a split with its engine's own phone timings, evenly thinned to `limit`.

    Raises:
        ValueError: the split has none.
    """
    found = [s for s in corpus.sequences(split, ["synthetic"]) if corpus.phones(s)]
    if not found:
        raise ValueError(f"the corpus has no synthetic {split} sequence with phones")
    if 0 < limit < len(found):
        found = [found[k * len(found) // limit] for k in range(limit)]
    return {s.id: (corpus.audio(s), [Phone(*row) for row in corpus.phones(s)]) for s in found}


def aligned_recordings(path: Path) -> dict[str, Recording]:
    """The recordings of an alignment file; raises as :func:`freetalk.corpus.alignment.aligned_files`."""
    return {
        name: (np.array(load_audio(file).samples, np.float32), phones)
        for name, (file, phones) in aligned_files(path).items()
    }


def frames_of(
    encoder: SpeechEncoder, recordings: Mapping[str, Recording], layer: int
) -> dict[str, tuple[Tensor, Labels]]:
    """Features (n, C) float16 and classes (n,) of the encoder's own frames, each recording by itself."""
    timing = encoder.timing
    options = EncodeOptions(layer=layer)
    result = {}
    bar = tqdm(recordings.items(), desc="encoding", delay=2.0, leave=False, disable=None)
    for name, (samples, phones) in bar:
        features = encode_speech(encoder, samples, None, options=options).cpu().half()
        times = timing.offset_s + np.arange(len(features)) / timing.rate_hz
        inside = times < len(samples) / SAMPLE_RATE_HZ
        result[name] = (features[torch.from_numpy(inside)], viseme_labels(phones, times[inside]))
    return result


def probe_layer(
    encoder: SpeechEncoder,
    layer: int,
    synthetic: Mapping[str, Recording],
    recorded: Mapping[str, Recording],
    held_out: Mapping[str, Mapping[str, Recording]],
) -> dict[str, Any]:
    """Fits the probe on one hidden state and scores it.

    Args:
        encoder: left as it was.
        layer: hidden state, -1 the last, 0 what the first layer gets.
        synthetic: synthetic speech to fit on.
        recorded: aligned recordings to fit on; together they count as much as the synthetic speech.
        held_out: name of a set to its recordings, none of them fitted on.

    Returns:
        JSON values: ``layer``, ``fitted_on`` (frames) and for each set :func:`scores_of` it and the accuracy of each
        of its recordings.
    """
    parts = [frames_of(encoder, part, layer) for part in (synthetic, recorded) if part]
    counts = [sum(len(labels) for _, labels in part.values()) for part in parts]
    rows = [row for part in parts for row in part.values()]
    weights = torch.cat([torch.full((count,), 1.0 / count) for count in counts])
    probe = fit_probe(
        torch.cat([features for features, _ in rows]),
        np.concatenate([labels for _, labels in rows]),
        weights,
    )
    sets: dict[str, Any] = {}
    for name, recordings in held_out.items():
        single = {
            key: confusion_matrix(labels, probe.predict(features))
            for key, (features, labels) in frames_of(encoder, recordings, layer).items()
        }
        sets[name] = scores_of(np.sum(list(single.values()), axis=0))
        sets[name]["recordings"] = {
            key: float(np.trace(own) / max(1, own.sum())) for key, own in single.items()
        }
    fitted = dict(zip(("synthetic", "recorded"), [*counts, 0]))
    return {"layer": layer, "fitted_on": fitted, "sets": sets}


def draw_confusions(result: Mapping[str, Any], path: Path) -> None:
    """The confusion matrix of each set of :func:`probe_layer`, rows in percent, as a picture."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    sets = result["sets"]
    figure = Figure(figsize=(7.0 * len(sets), 6.4), layout="constrained")
    FigureCanvasAgg(figure)
    names = list(VISEMES)
    for panel, (name, scores) in zip(figure.subplots(1, len(sets), squeeze=False)[0], sets.items()):
        counts = np.array(scores["confusion"])
        percent = 100 * counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
        panel.imshow(percent, cmap="Blues", vmin=0, vmax=100)
        for row, column in np.ndindex(*percent.shape):
            if percent[row, column] >= 1:
                colour = "white" if percent[row, column] > 55 else "black"
                text = f"{percent[row, column]:.0f}"
                panel.text(column, row, text, ha="center", va="center", fontsize=8, color=colour)
        panel.set_xticks(range(len(names)), names, rotation=45, ha="right", fontsize=8)
        panel.set_yticks(range(len(names)), names, fontsize=8)
        panel.set_xlabel("probe")
        panel.set_ylabel("true class, % of its frames")
        panel.set_title(
            f"{name}: {100 * scores['accuracy']:.1f} % of {scores['frames']} frames, "
            f"{100 * scores['accuracy_speech']:.1f} % in speech",
            fontsize=10,
        )
    figure.savefig(path, dpi=110)
