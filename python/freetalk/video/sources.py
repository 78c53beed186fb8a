"""What a user names, as tracked clips by talker: videos, folders of videos, folders of tracks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from freetalk.video.tracks import VIDEO_SUFFIXES, FaceTrack, read_tracks, track_videos

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
