"""Videos of animations: H.264 with AAC sound in step, written by ffmpeg without a display."""

from __future__ import annotations

import os
import subprocess
import tempfile
import wave
from collections.abc import Iterable, Iterator
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freetalk._ffmpeg import find_ffmpeg
from freetalk._files import beside
from freetalk.viz.renderer import FaceRenderer, Image, View, check_off_screen
from freetalk.viz.sequence import Sequence, as_sequence

MAX_VIDEO_FPS = 60.0

#: Options of ffmpeg for picture, sound and file.
_CODECS: dict[str, tuple[list[str], list[str], list[str]]] = {
    ".mp4": (
        ["-c:v", "libx264", "-preset", "veryfast", "-crf", "18"],
        ["-c:a", "aac", "-b:a", "160k"],
        ["-movflags", "+faststart", "-f", "mp4"],
    ),
    ".webm": (
        [
            "-c:v",
            "libvpx-vp9",
            "-crf",
            "28",
            "-b:v",
            "0",
            "-deadline",
            "realtime",
            "-cpu-used",
            "6",
        ],
        ["-c:a", "libopus", "-b:a", "96k"],
        ["-f", "webm"],
    ),
}


def save_video(
    animation: Any,
    path: str | os.PathLike[str],
    fps: float | None = None,
    size: tuple[int, int] = (720, 720),
    view: View | None = None,
    progress: bool = True,
) -> Path:
    """Renders an animation to an ``.mp4`` (H.264, AAC) or ``.webm`` (VP9, Opus) with its sound; nothing is left behind if it fails.

    Args:
        animation: ``freetalk.Animation``, :class:`Sequence` or path of an animation ``.npz``.
        path: Where to write; must end in ``.mp4`` or ``.webm``.
        fps: Frames per second of the video. By default those of the animation, at most 60; other
            rates interpolate the motion linearly.
        size: (width, height) in pixels, even numbers.
        view: Camera and look.
        progress: Shows a progress bar on a terminal.

    Returns:
        The path written.

    Raises:
        ValueError: Arguments out of range.
        RuntimeError: No OpenGL or no ffmpeg, or ffmpeg failed.
    """
    sequence = as_sequence(animation)
    target = Path(path)
    rate = _video_rate(sequence, fps)
    if target.suffix.lower() not in _CODECS:
        raise ValueError(f"a video's name must end in .mp4 or .webm, found '{target.name}'")
    if min(size) < 16 or size[0] % 2 or size[1] % 2:
        raise ValueError(f"size must be even numbers of at least 16 pixels, found {size}")
    target.parent.mkdir(parents=True, exist_ok=True)
    count = max(1, round(sequence.duration_s * rate))
    with FaceRenderer(sequence, size, view) as renderer:
        times = (k / float(rate) for k in range(count))
        frames = (renderer.image(sequence.at_time(t), sequence.head_at(t)) for t in times)
        shown = _with_progress(frames, count, target.name, progress)
        write_video(target, shown, size, rate, count, sequence.samples, sequence.sample_rate_hz)
    return target


def check_video_support() -> None:
    """Makes sure, before long work, that a video can be rendered and written here.

    Raises:
        RuntimeError: No OpenGL or no ffmpeg was found; the message says what to install.
    """
    _ffmpeg()
    check_off_screen()


def write_video(
    target: Path,
    frames: Iterable[Image],
    size: tuple[int, int],
    rate: Fraction,
    count: int,
    samples: NDArray[np.float32],
    sample_rate_hz: int,
) -> None:
    """Encodes images and sound to ``target``, atomically.

    Sound is cut or padded with silence to the length of the pictures.

    Args:
        target: Where to write.
        frames: (height, width, 3) uint8 each.
        size: (width, height).
        rate: Frames per second.
        count: Number of frames, for the length of the sound.
        samples: (S,) float32 in [-1, 1]; may be empty.
        sample_rate_hz: Rate of ``samples``.
    """
    partial = beside(target)
    with tempfile.TemporaryDirectory(prefix="freetalk_video_") as folder:
        log = Path(folder) / "ffmpeg.log"
        sound: Path | None = None
        if len(samples):
            sound = Path(folder) / "sound.wav"
            _write_wav(sound, samples, sample_rate_hz, float(count / rate))
        command = _ffmpeg_command(size, rate, count, sound, partial)
        try:
            _encode(command, frames, log)
            partial.replace(target)
        finally:
            with suppress(FileNotFoundError):
                partial.unlink()


def _video_rate(sequence: Sequence, fps: float | None) -> Fraction:
    if fps is not None and not 0 < fps <= 240:
        raise ValueError(f"fps must be above 0 and at most 240, found {fps}")
    rate = fps if fps is not None else min(sequence.fps, MAX_VIDEO_FPS)
    return Fraction(rate).limit_denominator(1001)


def _with_progress(
    frames: Iterator[Image], count: int, name: str, progress: bool
) -> Iterable[Image]:
    from tqdm import tqdm

    hidden: bool | None = None if progress else True  # None: only on a terminal
    return tqdm(frames, total=count, desc=name, unit="frame", leave=False, disable=hidden)


def _ffmpeg_command(
    size: tuple[int, int], rate: Fraction, count: int, sound: Path | None, out: Path
) -> list[str]:
    video = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{size[0]}x{size[1]}"]
    command = [_ffmpeg(), "-y", "-loglevel", "error", *video, "-r", str(rate), "-i", "pipe:0"]
    picture, voice, container = _CODECS[out.suffix.lower()]
    if sound is not None:
        command += ["-i", str(sound), "-map", "0:v", "-map", "1:a", *voice]
    command += [*picture, "-pix_fmt", "yuv420p", "-frames:v", str(count)]
    return [*command, "-t", f"{float(count / rate):.6f}", *container, str(out)]


def _ffmpeg() -> str:
    program = find_ffmpeg()
    if program is None:
        advice = "pip install imageio-ffmpeg, or apt-get install ffmpeg"
        raise RuntimeError(f"cannot write a video: no ffmpeg was found; {advice}")
    return program


def _encode(command: list[str], frames: Iterable[Image], log: Path) -> None:
    with log.open("wb") as messages:
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=messages
        )
        assert process.stdin is not None
        try:
            for frame in frames:
                process.stdin.write(np.ascontiguousarray(frame).data)
        except BrokenPipeError:
            pass  # ffmpeg stopped; its message says why
        except BaseException:
            process.kill()
            raise
        finally:
            with suppress(BrokenPipeError):
                process.stdin.close()
            process.wait()
    if process.returncode != 0:
        lines = log.read_text(errors="replace").strip().splitlines() or ["no message"]
        raise RuntimeError(f"ffmpeg could not write {command[-1]}: {lines[-1]}")


def _write_wav(
    path: Path, samples: NDArray[np.float32], sample_rate_hz: int, duration_s: float
) -> None:
    """16-bit sound of exactly the given length."""
    wanted = round(duration_s * sample_rate_hz)
    fitted = np.zeros(wanted, dtype=np.float32)
    fitted[: min(wanted, len(samples))] = samples[:wanted]
    with wave.open(str(path), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(sample_rate_hz)
        file.writeframes((np.clip(fitted, -1, 1) * 32767).astype("<i2").tobytes())
