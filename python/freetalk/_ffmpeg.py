"""Where ffmpeg is: sound and video that libsndfile can't read or nothing else here can write."""

from __future__ import annotations

import shutil


def find_ffmpeg() -> str | None:
    """The program that comes with ``imageio-ffmpeg``, or the system's; None without either."""
    try:
        import imageio_ffmpeg

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        return shutil.which("ffmpeg")
