"""What a dataset consists of: the takes that a packed folder lists, with their frames, and neutral faces."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from freetalk.data.emotions import EMOTIONS
from freetalk.data.errors import DatasetError
from freetalk.data.pack import SAMPLE_RATE_HZ, FloatArray, Pack
from freetalk.data.resampling import resample_frames
from freetalk.data.splits import SPLITS

BoolArray = npt.NDArray[np.bool_]
#: Takes that are kept after they were resampled.
_KEPT = 32
#: Frame numbers this close to a whole one count as it: they come from divisions.
_WHOLE = 1e-6


@dataclass(frozen=True)
class MotionSequence:
    """One take, or a clip of one: where its frames lie, what is heard and which affect it shows.

    Attributes:
        id: unique name within the dataset.
        split: ``train``, ``val`` or ``test``.
        source: where the motion comes from, e.g. ``facegood``, ``synthetic``, ``rom``, ``rest``, ``biwi``.
        take: recording that the sequence was cut from.
        start_frame: first frame of the take in the packed arrays.
        stored_frames: frames of the take there, at the pack's rate.
        num_frames: number of frames T, at `fps`.
        first_sample: where its sound begins in the packed samples.
        num_samples: samples of its sound; 0 where there is none.
        emotion: index into the dataset's ``emotions``.
        intensity: real number in [1, 3].
        identity: index of the face that was recorded or drawn.
        voice: speaker.
        text: transcript where known.
        fps: frames per second.
        topology: meshing that it was recorded on, the only one whose vertices it moves (of
            ``identity``); ``None`` where it moves every face of its dataset.
        dataset: name of the dataset that it belongs to.
        name: its id in the packed folder.
        offset: frames of the take, at `fps`, before the first one of the clip.
    """

    id: str
    split: str
    source: str
    take: str
    start_frame: int
    stored_frames: int
    num_frames: int
    first_sample: int
    num_samples: int
    emotion: int
    intensity: float
    identity: int
    voice: str | None
    text: str | None
    fps: float = 30.0
    topology: str | None = None
    dataset: str = ""
    name: str = ""
    offset: int = 0

    @property
    def has_sound(self) -> bool:
        """Whether anything was recorded."""
        return self.num_samples > 0

    def at(self, fps: float) -> MotionSequence:
        """The same at another frame rate; a clip begins with the first of its new frames, and its sound with it."""
        if fps == self.fps:
            return self
        offset = math.ceil(self.offset * fps / self.fps - _WHOLE)
        late = offset / fps - self.offset / self.fps  # s
        last = (self.offset + self.num_frames - 1) / self.fps
        skipped = min(round(late * SAMPLE_RATE_HZ), self.num_samples)
        return dataclasses.replace(
            self,
            fps=fps,
            offset=offset,
            num_frames=max(1, math.floor(last * fps + _WHOLE) + 1 - offset),
            first_sample=self.first_sample + skipped,
            num_samples=self.num_samples - skipped,
        )

    def clip(self, name: str, first: int, num_frames: int) -> MotionSequence:
        """Frames [first, first + num_frames) as a sequence of its own."""
        samples = [
            round(frame / self.fps * SAMPLE_RATE_HZ) for frame in (first, first + num_frames)
        ]
        begin, end = (min(sample, self.num_samples) for sample in samples)
        return dataclasses.replace(
            self,
            id=name,
            offset=self.offset + first,
            num_frames=num_frames,
            first_sample=self.first_sample + begin,
            num_samples=end - begin,
        )


@dataclass(frozen=True)
class FaceMesh:
    """A neutral face in the canonical frame, with the regions that the metrics need.

    Attributes:
        name: ``identity/topology``, for messages.
        vertices: (V, 3) float32, m.
        faces: (F, 3) int64.
        lip_mask: (V,) bool.
        upper_face_mask: (V,) bool.
        dataset: name of the dataset; its sequences move this face.
        landmarks: (68,) nearest vertices, where they are known.
    """

    name: str
    vertices: FloatArray
    faces: npt.NDArray[np.int64]
    lip_mask: BoolArray
    upper_face_mask: BoolArray
    dataset: str = ""
    landmarks: npt.NDArray[np.int64] | None = None


@dataclass(frozen=True)
class FaceEntry:
    """A face or a meshing of a dataset.

    Attributes:
        dataset: its name.
        own: index or name of the face or meshing there.
        splits: that it belongs to.
        identity: index of the only face that a meshing has, where it is a scan.
    """

    dataset: str
    own: int | str
    splits: frozenset[str]
    identity: int | None = None


def faces_of(
    pack: Pack, name: str, sequences: list[MotionSequence]
) -> tuple[list[FaceEntry], dict[str, FaceEntry]]:
    """Faces and meshings, in the splits that they name, or those of the sequences recorded on them."""
    shown: dict[int, set[str]] = {}
    for s in sequences:
        shown.setdefault(s.identity, set()).add(s.split)
    faces = []
    for index, entry in enumerate(pack.manifest["identities"]):
        own = [entry["split"]] if pack.moves_all else shown.get(index, ())
        faces.append(FaceEntry(name, index, frozenset(own)))
    everywhere = frozenset(s.split for s in sequences)
    meshings = {}
    for entry in pack.manifest["topologies"]:
        splits = frozenset([entry["split"]]) if pack.moves_all else everywhere
        meshings[entry["name"]] = FaceEntry(name, entry["name"], splits, entry.get("identity"))
    return faces, meshings


def sequences_of(pack: Pack, name: str, scheme: int) -> list[MotionSequence]:
    """The sequences of a packed folder that a split scheme uses.

    Args:
        pack: the folder.
        name: what the dataset is called.
        scheme: index of the split scheme in the manifest.

    Raises:
        DatasetError: unknown split or emotion.
    """
    topologies = pack.manifest["topologies"]
    own = None if pack.moves_all or not topologies else str(topologies[0]["name"])
    scanned = {entry["identity"]: str(entry["name"]) for entry in topologies if "identity" in entry}
    found = []
    for entry in pack.manifest["sequences"]:
        split = entry["split"][scheme]
        if split is None:
            continue
        if split not in SPLITS or entry["emotion"] not in EMOTIONS:
            raise DatasetError(
                f"{pack.directory}: sequence {entry['id']} has the split {split!r} and the emotion "
                f"{entry['emotion']!r}; known: {', '.join(SPLITS)}; {', '.join(EMOTIONS)}"
            )
        found.append(
            MotionSequence(
                id=entry["id"],
                split=split,
                source=entry["source"],
                take=entry["take"] or entry["id"],
                start_frame=entry["start_frame"],
                stored_frames=entry["num_frames"],
                num_frames=entry["num_frames"],
                first_sample=entry["first_sample"],
                num_samples=entry["num_samples"],
                emotion=EMOTIONS.index(entry["emotion"]),
                intensity=float(entry["intensity"]),
                identity=entry["identity"],
                voice=entry["voice"],
                text=entry["text"],
                fps=pack.fps,
                topology=scanned.get(entry["identity"], own),
                dataset=name,
                name=entry["id"],
            )
        )
    return found


def read_frames(
    pack: Pack, name: str, sequence: MotionSequence, start: int, stop: int | None
) -> FloatArray:
    """Frames [start, stop) of ``landmarks``, ``motion``, ``scans`` or ``codes``, at the sequence's rate."""
    stop = sequence.num_frames if stop is None else min(stop, sequence.num_frames)
    start, stop = start + sequence.offset, stop + sequence.offset
    first = sequence.start_frame
    if sequence.fps != pack.fps:
        if name == "scans" and pack.scans is not None:
            raise ValueError(f"scans are of {pack.fps:g} frames a second, not {sequence.fps:g}")
        last = first + sequence.stored_frames
        return _resampled(pack, name, first, last, sequence.fps)[start:stop].copy()
    return _stored(pack, name, first + start, first + stop)


@lru_cache(maxsize=_KEPT)
def _resampled(pack: Pack, name: str, first: int, stop: int, fps: float) -> FloatArray:
    """A take at another rate."""
    return resample_frames(_stored(pack, name, first, stop), pack.fps, fps)


def _stored(pack: Pack, name: str, first: int, stop: int) -> FloatArray:
    stored = {k: getattr(pack, k) for k in ("landmarks", "motion", "codes", "scans")}
    rows = stored[name]
    if rows is None and name == "scans":
        return np.zeros((stop - first, 0, 3), np.float32)
    if rows is None:
        lacking = "corresponding vertices" if name == "motion" else name
        raise ValueError(f"{pack.directory} has no {lacking} of its frames")
    return np.asarray(rows.read(first, stop), np.float32)
