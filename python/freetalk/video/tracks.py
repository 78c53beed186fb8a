"""Tracked face points of video clips: read from disk, or made by MediaPipe; by talker."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from freetalk._ffmpeg import VIDEO_SUFFIXES
from freetalk.video.points import LANDMARK_POINTS, NUM_MESH_POINTS

FloatArray = npt.NDArray[np.float32]
_SOUNDS = (".flac", ".wav")


@dataclass(frozen=True)
class FaceTrack:
    """The 68 landmarks of one clip as a tracker saw them.

    Attributes:
        name: of the clip.
        talker: whose face it is.
        points: (T, 68, 3) px: +X right, +Y up, +Z towards the camera (the tracker's estimate).
        found: (T,) bool; where False the points are meaningless.
        fps: frames per second.
        media: file that holds the sound, a recording or the video.
        text: transcript where known.
        words: (start in s, end in s, word), empty where not known.
    """

    name: str
    talker: str
    points: FloatArray
    found: npt.NDArray[np.bool_]
    fps: float
    media: Path
    text: str | None = None
    words: tuple[tuple[float, float, str], ...] = field(default=())


def read_tracks(directory: Path, talker: str = "") -> list[FaceTrack]:
    """Clips of a folder with ``tracks.npz`` beside ``audio/NAME.flac`` (or ``.wav``).

    ``tracks.npz`` holds ``names`` (N,), ``frames`` (N,), ``points`` (P,) indices into MediaPipe's 478, ``fps``, and
    ``delta`` (sum of frames, P, 3) int16: differences in time in 1/16 px, the first frame of a clip absolute, x to
    the right, y down, z away from the camera. ``words.json`` (NAME -> [[start_s, end_s, word], …]) and
    ``transcripts.json`` (NAME -> text) may lie beside it.

    Args:
        directory: the folder.
        talker: whose face all clips show; empty makes every clip a talker of its own.

    Raises:
        FileNotFoundError: no tracks, or a clip without sound.
        ValueError: the tracks lack a landmark or disagree with themselves.
    """
    path = directory / "tracks.npz"
    if not path.is_file():
        raise FileNotFoundError(f"{directory} holds no tracks.npz and no videos")
    with np.load(path, allow_pickle=False) as archive:
        names = [str(name) for name in archive["names"]]
        frames = archive["frames"].astype(int)
        points, fps, delta = archive["points"].tolist(), float(archive["fps"]), archive["delta"]
    missing = sorted(set(LANDMARK_POINTS) - set(points))
    if missing:
        raise ValueError(f"{path} lacks MediaPipe's points {missing}, which are landmarks")
    if len(names) != len(frames) or frames.sum() != len(delta) or delta.shape[1] != len(points):
        raise ValueError(f"{path}: names, frames, points and delta disagree")
    columns = [points.index(index) for index in LANDMARK_POINTS]
    words, texts = _json(directory / "words.json"), _json(directory / "transcripts.json")
    tracks = []
    for name, clip in zip(names, np.split(delta, np.cumsum(frames)[:-1]), strict=True):
        places = np.cumsum(clip[:, columns], axis=0, dtype=np.int32) / np.float32(16)
        spoken = tuple((float(a), float(b), str(word)) for a, b, word in words.get(name, ()))
        text = texts.get(name) or " ".join(w for _, _, w in spoken if w != "sil") or None
        tracks.append(
            FaceTrack(
                name,
                talker or name,
                _upright(places),
                np.ones(len(places), bool),
                fps,
                _sound(directory / "audio", name),
                text,
                spoken,
            )
        )
    return tracks


def track_videos(
    paths: Sequence[Path], talkers: Mapping[Path, str], progress: bool = True
) -> Iterator[FaceTrack]:
    """Tracks the one face of each video with MediaPipe.

    Args:
        paths: videos, any that OpenCV reads.
        talkers: whose face each shows.
        progress: show a progress bar.

    Raises:
        RuntimeError: MediaPipe is not installed.
        ValueError: a file is no video.
    """
    try:
        import cv2
        import mediapipe
    except ImportError as error:
        raise RuntimeError(
            "tracking faces in videos needs MediaPipe: pip install 'freetalk[faces]'"
        ) from error
    from tqdm import tqdm

    for path in tqdm(paths, "videos", disable=not progress):
        capture = cv2.VideoCapture(str(path))
        fps = float(capture.get(cv2.CAP_PROP_FPS))
        places, found = [], []
        with mediapipe.solutions.face_mesh.FaceMesh(
            max_num_faces=1, refine_landmarks=True, min_tracking_confidence=0.5
        ) as mesh:
            while True:
                more, image = capture.read()
                if not more:
                    break
                height, width = image.shape[:2]
                faces = mesh.process(cv2.cvtColor(image, cv2.COLOR_BGR2RGB)).multi_face_landmarks
                found.append(bool(faces))
                here = np.zeros((NUM_MESH_POINTS, 3), np.float32)
                if faces:
                    here[:] = [(p.x * width, p.y * height, p.z * width) for p in faces[0].landmark]
                places.append(here[list(LANDMARK_POINTS)])
        capture.release()
        if not places or fps <= 0:
            raise ValueError(f"{path} is no video that can be read")
        yield FaceTrack(
            path.stem, talkers[path], _upright(np.stack(places)), np.array(found), fps, path
        )


def _upright(places: npt.NDArray[Any]) -> FloatArray:
    """The image's axes (y down, z away) as ours."""
    return (places * np.array([1, -1, -1])).astype(np.float32)


def _sound(folder: Path, name: str) -> Path:
    for suffix in _SOUNDS:
        if (folder / f"{name}{suffix}").is_file():
            return folder / f"{name}{suffix}"
    raise FileNotFoundError(f"{folder} holds no sound of {name} ({', '.join(_SOUNDS)})")


def _json(path: Path) -> dict[str, Any]:
    return dict(json.loads(path.read_text())) if path.is_file() else {}


TALKERS = ("folder", "file")


def tracks_by_talker(
    sources: Sequence[Path], talkers: str = "folder", progress: bool = True
) -> dict[str, list[FaceTrack]]:
    """Clips by talker, in the order of the sources.

    Args:
        sources: videos, folders of videos, and folders with ``tracks.npz``.
        talkers: ``folder``: all clips of a folder show the talker that it is named after; ``file``: every clip
            shows another talker.
        progress: show a progress bar.

    Raises:
        FileNotFoundError: a source is missing, or a folder holds neither tracks nor videos.
        ValueError: two clips have one name, or tracks and videos are not readable.
        RuntimeError: videos are given and MediaPipe is not installed.
    """
    if talkers not in TALKERS:
        raise ValueError(f"talkers is {talkers!r}: use one of {', '.join(TALKERS)}")
    found: dict[str, list[FaceTrack]] = {}
    for source in sources:
        for track in _tracks(source.resolve(), talkers == "folder", progress):
            own = found.setdefault(track.talker, [])
            if any(track.name == other.name for other in own):
                raise ValueError(f"two clips of {track.talker} are called {track.name}")
            own.append(track)
    return found


def _tracks(source: Path, shared: bool, progress: bool) -> list[FaceTrack]:
    if (source / "tracks.npz").is_file():
        return read_tracks(source, source.name if shared else "")
    if source.is_dir():
        paths = sorted(p for p in source.rglob("*") if p.suffix.lower() in VIDEO_SUFFIXES)
        if not paths:
            raise FileNotFoundError(f"{source} holds neither tracks.npz nor videos")
    elif source.is_file():
        paths = [source]
    else:
        raise FileNotFoundError(f"{source} does not exist")
    names = {path: path.parent.name if shared else path.stem for path in paths}
    return list(track_videos(paths, names, progress))
