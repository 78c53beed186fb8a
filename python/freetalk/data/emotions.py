"""The emotion vocabulary, and how each dataset's labels map onto it."""

from __future__ import annotations

from freetalk._native import ats as _native
from freetalk.data.errors import LabelError

#: Canonical order of the affect vocabulary, the model's own default; emotion codes index into it.
EMOTIONS: tuple[str, ...] = tuple(_native.AtsOptions().emotions)

#: Levels of intensity that datasets record.
INTENSITIES = (1, 2, 3)

#: Labels of EmoVOCA's files in the order of their numbers (its generator's table).
EMOVOCA_LABELS: tuple[str, ...] = (
    "Afraid", "Disgust", "Irritated1", "Sad1", "Smile2", "Drunk2", "Ill", "Moody", "Pleased",
    "Suspicious", "Upset",
)  # fmt: skip

#: Each dataset's label to ours. EmoVOCA's "Moody" takes the place of "ashamed": the other ten of its
#: eleven files pair off with the eleven emotions that FreeTalk (4.1) lists for it, these two are left.
LABELS: dict[str, dict[str, str]] = {
    "emovoca": {
        "Afraid": "afraid", "Disgust": "disgust", "Irritated1": "angry", "Sad1": "sad", "Smile2": "happy",
        "Drunk2": "drunk", "Ill": "ill", "Moody": "ashamed", "Pleased": "pleased", "Suspicious": "suspicious",
        "Upset": "upset",
    },
    "mead": {
        "neutral": "neutral", "angry": "angry", "contempt": "contempt", "disgusted": "disgust", "fear": "afraid",
        "happy": "happy", "sad": "sad", "surprised": "surprise",
    },
}  # fmt: skip
#: Other words for ours, in labels of a user's own data.
SYNONYMS: dict[str, str] = {
    "anger": "angry", "calm": "neutral", "contemptuous": "contempt", "disgusted": "disgust", "fear": "afraid",
    "fearful": "afraid", "happiness": "happy", "joy": "happy", "none": "neutral", "sadness": "sad",
    "surprised": "surprise",
}  # fmt: skip


def emotion_of(label: str, table: str | None = None, where: str = "a label") -> str:
    """Our name of a dataset's emotion.

    Args:
        label: as the dataset spells it.
        table: one of ``LABELS``; without it our names and their synonyms are understood.
        where: what messages call the file or row.

    Raises:
        LabelError: the label is not in the table; lists it.
    """
    if table is not None:
        known = LABELS[table]
        if label in known:
            return known[label]
        raise LabelError(
            f"{where} has the emotion {label!r}; {table} knows {', '.join(sorted(known))}"
        )
    name = SYNONYMS.get(label.strip().lower(), label.strip().lower())
    if name not in EMOTIONS:
        raise LabelError(
            f"{where} has the emotion {label!r}; known are {', '.join(EMOTIONS)} and "
            f"{', '.join(sorted(SYNONYMS))}"
        )
    return name


def intensity_of(value: object, where: str = "a label") -> float:
    """An intensity in [1, 3].

    Raises:
        LabelError: it is no number, or outside.
    """
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        number = float("nan")
    if not INTENSITIES[0] <= number <= INTENSITIES[-1]:
        raise LabelError(f"{where} has the intensity {value!r}; it must be a number from 1 to 3")
    return number
