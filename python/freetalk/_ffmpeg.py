"""What recordings end in, and where ffmpeg is, which reads and writes what nothing else here can."""

from __future__ import annotations

import shutil

#: What libsndfile reads; sound, and video, whose sound ffmpeg reads.
SNDFILE_SUFFIXES = (
    *(".wav", ".flac", ".ogg", ".opus", ".mp3"),
    *(".aiff", ".aif", ".au", ".caf", ".w64"),
)
AUDIO_SUFFIXES = (*SNDFILE_SUFFIXES, ".m4a", ".aac", ".wma", ".amr")
VIDEO_SUFFIXES = (".mp4", ".mov", ".mkv", ".webm", ".avi", ".mpg", ".mpeg", ".m4v", ".3gp")


def find_ffmpeg() -> str | None:
    """The program that comes with ``imageio-ffmpeg``, or the system's; None without either."""
    try:
        import imageio_ffmpeg

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        return shutil.which("ffmpeg")
