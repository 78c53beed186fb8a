"""Splits of the papers, by name: which speaker, and where it matters which sentence, belongs where."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from freetalk.data.errors import DatasetError

SPLITS = ("train", "val", "test")

_VOCA = {
    "train": (
        "FaceTalk_170728_03272_TA", "FaceTalk_170904_00128_TA", "FaceTalk_170725_00137_TA",
        "FaceTalk_170915_00223_TA", "FaceTalk_170811_03274_TA", "FaceTalk_170913_03279_TA",
        "FaceTalk_170904_03276_TA", "FaceTalk_170912_03278_TA",
    ),
    "val": ("FaceTalk_170811_03275_TA", "FaceTalk_170908_03277_TA"),
    "test": ("FaceTalk_170809_00138_TA", "FaceTalk_170731_00024_TA"),
}  # fmt: skip
_BIWI = {
    "train": ("F1", "F2", "F3", "F4", "F5", "F6", "M1", "M2", "M3", "M4"),
    "val": ("F7", "M5"),
    "test": ("F8", "M6"),
}
_BIWI_FACEFORMER = {
    "train": ("F2", "F3", "F4", "M3", "M4", "M5"),
    "val": ("F2", "F3", "F4", "M3", "M4", "M5"),
    "test": ("F1", "F5", "F6", "F7", "F8", "M1", "M2", "M6"),
}
_MULTIFACE = {
    "train": (
        "20171024", "20180226", "20180227", "20180406", "20180418", "20180426", "20180510",
        "20180927", "20190529",
    ),
    "val": ("20190828", "20190521"),
    "test": ("20181017", "20180105"),
}  # fmt: skip


@dataclass(frozen=True)
class SplitScheme:
    """Who belongs to which split.

    Attributes:
        name: the name it is asked for by.
        source: whose it is.
        speakers: speakers of each split.
        sentences: first and last sentence of a split, where not all belong to it.
        variant: of the takes that belong to it, where a release has several (BIWI's emotional ``e``);
            ``None`` for all.
    """

    name: str
    source: str
    speakers: dict[str, tuple[str, ...]]
    sentences: dict[str, tuple[int, int]] = field(default_factory=dict)
    variant: str | None = None

    def of(self, speaker: str, sentence: int | None = None, variant: str = "") -> str | None:
        """The split of a sequence; ``None`` leaves it out."""
        if self.variant not in (None, variant):
            return None
        for split, speakers in self.speakers.items():
            if speaker not in speakers:
                continue
            first, last = self.sentences.get(split, (0, 10**9))
            if sentence is None or first <= sentence <= last:
                return split
        return None


_UNSEEN = {"train": (1, 40), "val": (21, 40), "test": (21, 40)}
#: Of each dataset, the first is the default.
SCHEMES: dict[str, tuple[SplitScheme, ...]] = {
    "vocaset": (
        SplitScheme("voca", "VOCA (Cudeiro et al. 2019), config_parser.py", _VOCA, _UNSEEN),
        SplitScheme("scantalk", "ScanTalk (Nocentini et al. 2024): all 40 sentences", _VOCA),
    ),
    "biwi": (
        SplitScheme(
            "scantalk", "ScanTalk (Nocentini et al. 2024): the neutral takes", _BIWI, variant=""
        ),
        SplitScheme(
            "faceformer",
            "FaceFormer (Fan et al. 2022): the emotional takes; speakers of train and val are the same",
            _BIWI_FACEFORMER,
            {"train": (1, 32), "val": (33, 36), "test": (37, 40)},
            "e",
        ),
    ),
    "multiface": (SplitScheme("scantalk", "ScanTalk (Nocentini et al. 2024)", _MULTIFACE),),
    "emovoca": (SplitScheme("emovoca", "EmoVOCA (Nocentini et al. 2025)", _VOCA),),
}


def schemes_of(
    kind: str, speakers: Iterable[str], directory: Path | None = None
) -> list[SplitScheme]:
    """The split schemes of a dataset, the default first.

    A ``splits.json`` in its folder (``{"train": [speakers], "val": [..], "test": [..]}``) comes first. MEAD
    knows ``freetalk``, the paper's 36 / 5 / 6 actors (which ones it does not say: ours are drawn by the hash of
    their names), and ``emote``, the first 70 % of the men and of the women in order, then 15 %, as EMOTE's code
    does it. Folders of one's own know ``speakers`` (8 : 1 : 1 of the speakers, at least one each, by the same
    hash).

    Args:
        kind: ``vocaset``, ``biwi``, ``multiface``, ``emovoca``, ``mead`` or another.
        speakers: all speakers of the dataset.
        directory: its folder.

    Raises:
        DatasetError: a ``splits.json`` that is none.
    """
    everyone = sorted(set(speakers))
    own = None if directory is None else directory / "splits.json"
    schemes = [] if own is None or not own.is_file() else [_own_scheme(own)]
    if kind == "mead":
        source = "sizes of FreeTalk 4.1; the actors are drawn by hash, the paper names none"
        schemes.append(SplitScheme("freetalk", source, _drawn(everyone, 36, 5)))
        source = "EMOTE (Danecek et al. 2023), random_by_identityV2_sorted_70_15_15"
        schemes.append(SplitScheme("emote", source, _by_order(everyone)))
    elif kind not in SCHEMES:
        source = "8 : 1 : 1 of the speakers, drawn by hash"
        schemes.append(SplitScheme("speakers", source, _drawn(everyone, 8, 1, 10)))
    return [*schemes, *SCHEMES.get(kind, ())]


def _own_scheme(path: Path) -> SplitScheme:
    content = json.loads(path.read_text())
    if not isinstance(content, dict) or not set(content) <= set(SPLITS):
        raise DatasetError(f"{path} must map train, val and test to lists of speakers")
    speakers = {split: tuple(map(str, content.get(split, ()))) for split in SPLITS}
    return SplitScheme("splits.json", str(path), speakers)


def _drawn(
    speakers: list[str], train: int, val: int, total: int = 47
) -> dict[str, tuple[str, ...]]:
    """Speakers in the order of their names' hashes, cut in proportion; every split gets one first."""
    order = sorted(speakers, key=lambda name: hashlib.sha256(name.encode()).hexdigest())
    count = len(order)
    held = max(1, round(count * val / total)) if count > 1 else 0
    tested = max(1, round(count * (total - train - val) / total)) if count > 2 else 0
    return {
        "train": tuple(order[: count - held - tested]),
        "val": tuple(order[count - held - tested : count - tested]),
        "test": tuple(order[count - tested :]),
    }


def _by_order(speakers: list[str]) -> dict[str, tuple[str, ...]]:
    found: dict[str, list[str]] = {split: [] for split in SPLITS}
    for letter in ("M", "W"):
        group = [name for name in speakers if name.startswith(letter)]
        first, second = int(len(group) * 0.70), int(len(group) * 0.85)
        for split, part in zip(SPLITS, (group[:first], group[first:second], group[second:])):
            found[split] += part
    return {split: tuple(names) for split, names in found.items()}
