"""``freetalk live``: speech as it is spoken, from a microphone, a pipe or a paced recording."""

from __future__ import annotations

import argparse
import queue
import sys
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from freetalk._pretrained import find_weights
from freetalk.cli.animate import Report, built_in_face
from freetalk.cli.live_out import PacedFrames
from freetalk.cli.mesh_options import preparation
from freetalk.cli.outputs import check_readable
from freetalk.cli.weights import check_emotion, check_intensity

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from freetalk.talker import Face, LiveFrame
    from freetalk.talker.senders import Sender

RATE_HZ = 16000
BLOCK_S = 0.02


def run(arguments: argparse.Namespace) -> None:
    """Feeds a live stream and prints frames per second and latency once a second."""
    weights = find_weights(arguments.pretrained)
    check_intensity(arguments.intensity, weights)
    check_emotion(arguments.emotion, weights)
    mesh_file = None
    if arguments.mesh is not None:
        mesh_file = check_readable(arguments.mesh, "a mesh (OBJ, PLY, OFF, STL or glTF)")
    blocks = open_source(arguments.audio)

    import freetalk
    from freetalk.talker.senders import open_sender

    senders = [open_sender(address) for address in arguments.to]

    report = Report(quiet=False)
    mesh = freetalk.load_mesh(mesh_file) if mesh_file is not None else built_in_face()
    landmarks = arguments.landmarks and check_readable(arguments.landmarks, "landmarks")
    face = freetalk.Talker.from_pretrained(weights).prepare(
        mesh, landmarks=landmarks, **preparation(arguments)
    )
    for notice in face.report.notices:
        report.line("note", notice, timed=False)
    found = face.report
    text = f"{len(mesh.vertices)} vertices; {found.alignment.summary}; {found.parts}"
    report.line("prepared", text)
    try:
        play(face, blocks, arguments, report, senders)
    except KeyboardInterrupt:
        report.line("stopped", "from the keyboard", timed=False)


def play(
    face: Face,
    blocks: Iterator[NDArray[np.float32]],
    arguments: argparse.Namespace,
    report: Report,
    senders: list[Sender],
) -> None:
    """Runs the stream until the source ends."""
    names = ("emotion", "intensity", "seed", "articulation", "blinks")
    live = face.live(**{name: getattr(arguments, name) for name in names})
    meter = Meter(report, live.latency_s)
    out = PacedFrames(senders, face.rig(), live.latency_s) if senders else None

    def use(frames: list[LiveFrame]) -> None:
        if out is not None:
            out.add(frames)
        meter.made([frame.time_s for frame in frames])

    try:
        for block in blocks:
            meter.heard(len(block) / RATE_HZ)
            if out is not None:
                out.heard(len(block) / RATE_HZ)
            frames = live.push(block)
            if arguments.vertices:
                for frame in frames:
                    live.decode(frame)
            use(frames)
        use(live.finish())
    finally:
        if out is not None:
            out.close()
    meter.end()


class Meter:
    """Frames per second, latency and load of a stream, a line a second.

    A frame's latency is the time from the moment of its speech to the moment it is there; load is the share of
    the time that is spent in the stream.
    """

    def __init__(self, report: Report, promised_s: float) -> None:
        self._report = report
        self._promised_s = promised_s
        self._start: float | None = None
        self._busy = 0.0
        self._last = time.perf_counter()
        self._latencies: list[float] = []
        self._frames = 0
        self._worst = self._heard_s = 0.0
        self._next_line = 1.0

    def heard(self, seconds: float) -> None:
        """A block of speech is there."""
        now = time.perf_counter()
        if self._start is None:
            self._start = now - seconds  # its first sample was spoken a block ago
        self._heard_s += seconds
        self._last = now

    def made(self, times: list[float]) -> None:
        """Frames of these moments are there."""
        now = time.perf_counter()
        self._busy += now - self._last
        self._last = now
        if self._start is None:
            return
        self._latencies += [now - self._start - moment for moment in times]
        if now - self._start >= self._next_line:
            self._print(now - self._start)
            self._next_line += 1.0

    def end(self) -> None:
        """Prints what there was in all."""
        if self._start is None:
            self._report.line("done", "nothing was heard", timed=False)
            return
        passed = time.perf_counter() - self._start
        if self._latencies:
            self._print(passed)
        text = (
            f"{self._frames} frames of {self._heard_s:.1f} s of speech, {self._frames / passed:.1f} frames/s, "
            f"latency at most {self._worst:.2f} s ({self._promised_s:.2f} s and the computing), "
            f"load {100 * self._busy / passed:.0f} %"
        )
        self._report.line("done", text, timed=False)

    def _print(self, passed: float) -> None:
        done, self._latencies = self._latencies, []
        self._frames += len(done)
        worst = max(done, default=0.0)
        self._worst = max(self._worst, worst)
        text = (
            f"{passed:6.1f} s  {self._frames / passed:5.1f} frames/s  latency {np.mean(done or [0]):.2f} s, "
            f"at most {worst:.2f} s  load {100 * self._busy / passed:.0f} %"
        )
        self._report.line("live", text, timed=False)


def open_source(name: str | None) -> Iterator[NDArray[np.float32]]:
    """Blocks of mono speech at 16 kHz: of a file in its own time, of stdin ("-"), or of the microphone.

    Raises:
        ValueError: no such file, or no microphone; the message says what to do.
    """
    if name == "-":
        return from_pcm(sys.stdin.buffer)
    if name is not None:
        return from_file(str(check_readable(name, "a recording of speech")))
    return from_microphone()


def from_pcm(stream: BinaryIO) -> Iterator[NDArray[np.float32]]:
    """Blocks of a pipe of signed 16-bit little-endian samples."""
    size = 2 * int(BLOCK_S * RATE_HZ)
    while block := stream.read(size):
        yield np.frombuffer(block[: len(block) // 2 * 2], "<i2").astype(np.float32) / np.float32(
            32768
        )


def from_file(path: str) -> Iterator[NDArray[np.float32]]:
    """Blocks of a recording, each when it would have been spoken."""
    import freetalk

    samples: NDArray[np.float32] = np.asarray(freetalk.load_audio(path).samples, np.float32)
    size = int(BLOCK_S * RATE_HZ)
    start = time.perf_counter()
    for first in range(0, len(samples), size):
        block = samples[first : first + size]
        time.sleep(max(0.0, start + (first + len(block)) / RATE_HZ - time.perf_counter()))
        yield block


def from_microphone() -> Iterator[NDArray[np.float32]]:
    """Blocks of the default microphone.

    Raises:
        ValueError: the package sounddevice, its library PortAudio or a microphone is missing.
    """
    other = "give a recording with --audio FILE, or pipe 16-bit samples at 16 kHz into --audio -"
    try:
        import sounddevice
    except (ImportError, OSError) as error:
        raise ValueError(
            f"no microphone without sounddevice (pip install 'freetalk[live]', apt install libportaudio2): "
            f"{error}; or {other}"
        ) from None
    heard: queue.Queue[NDArray[np.float32]] = queue.Queue()

    def take(block: Any, *_: Any) -> None:
        heard.put(block[:, 0].copy())

    try:
        stream = sounddevice.InputStream(
            RATE_HZ, int(BLOCK_S * RATE_HZ), channels=1, dtype="float32", callback=take
        )
    except (sounddevice.PortAudioError, ValueError) as error:
        raise ValueError(f"no microphone that can be opened ({error}); {other}") from None

    def blocks() -> Iterator[NDArray[np.float32]]:
        with stream:
            while True:
                yield heard.get()

    return blocks()
