"""``freetalk animate``: the main job, from recordings and meshes to files."""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from freetalk._ffmpeg import AUDIO_SUFFIXES, VIDEO_SUFFIXES
from freetalk._pretrained import find_weights
from freetalk.cli.app import describe
from freetalk.cli.mesh_options import preparation
from freetalk.cli.motion_options import diffusion_options
from freetalk.cli.outputs import (
    MESH_SUFFIXES,
    RIG_FORMATS,
    VIDEO_FORMATS,
    Output,
    check_kept,
    check_readable,
    inputs,
    parse_outputs,
)
from freetalk.cli.weights import check_emotion, check_intensity

if TYPE_CHECKING:
    import freetalk
    from freetalk.ats import Emotion


@dataclass(frozen=True)
class Job:
    """One recording on one mesh.

    Attributes:
        audio: the recording.
        mesh: the mesh; ``None``: the built-in mean face.
        outputs: where its animation goes.
    """

    audio: Path
    mesh: Path | None
    outputs: list[Output]


def run(arguments: argparse.Namespace) -> None:
    """Animates meshes; every input and output is checked before the work begins.

    Raises:
        RuntimeError: some of several animations failed; the message names them, the others are written.
    """
    jobs = plan(arguments)
    weights = find_weights(arguments.pretrained)
    check_intensity(arguments.intensity, weights)
    check_emotion(arguments.emotion, weights)
    check_support({output.format for job in jobs for output in job.outputs})
    report = Report(arguments.quiet)

    import freetalk
    from freetalk.talker.voice import AUTO, summary

    @cache
    def talker() -> freetalk.Talker:
        return freetalk.Talker.from_pretrained(weights, device=arguments.device)

    failed: list[str] = []
    faces: dict[Path | None, freetalk.Face] = {}
    for job in jobs:
        try:
            audio = freetalk.load_audio(job.audio)
            if job.mesh not in faces:
                faces = {job.mesh: prepare(talker, job.mesh, arguments, report)}
            seconds = len(audio.samples) / audio.sample_rate_hz
            report.line("speech", f"{job.audio.name}: {seconds:.2f} s")
            emotion = arguments.emotion
            if emotion == AUTO:
                emotion = talker().read_emotion(audio)
                report.line("emotion", f"of the voice: {summary(emotion)}")
            animation = animate(faces[job.mesh], audio, emotion, arguments, report)
            write_all(animation, job, arguments, report)
        except (ValueError, RuntimeError, OSError) as error:
            if len(jobs) == 1:
                raise
            mesh = "" if job.mesh is None else f" on {job.mesh.name}"
            failed.append(f"{job.audio.name}{mesh}: {describe(error)}")
            report.line("failed", failed[-1])
    report.total()
    if failed:
        raise RuntimeError(f"{len(failed)} of {len(jobs)} animations failed: {'; '.join(failed)}")


def plan(arguments: argparse.Namespace) -> list[Job]:
    """Every recording on every mesh, a mesh after the other, with outputs that can be written.

    Raises:
        ValueError: outputs have no ``{name}`` for several animations, or one for a single animation.
        OSError: an input is missing, or an output cannot be written.
    """
    parse_outputs([text.replace("{name}", "name") for text in arguments.out])
    sounds = inputs(arguments.audio, (*AUDIO_SUFFIXES, *VIDEO_SUFFIXES), "a recording of speech")
    meshes: list[Path | None] = [None]
    if arguments.mesh is not None:
        wanted = "a mesh (OBJ, PLY, OFF, STL or glTF)"
        meshes = list(inputs(arguments.mesh, MESH_SUFFIXES, wanted))
    check_identity(arguments)
    several = [Path(given).is_dir() for given in (arguments.audio, arguments.mesh or "")]
    if arguments.mesh is None:
        several[1] = False
    wrong = [text for text in arguments.out if ("{name}" in text) != any(several)]
    if wrong and any(several):
        raise ValueError(
            f"'{wrong[0]}' is one place for many animations: write {{name}} in it, '{{name}}.glb'"
        )
    if wrong:
        raise ValueError(f"'{wrong[0]}': {{name}} stands for the files of a folder; none was given")
    jobs = []
    for mesh in meshes:
        for sound in sounds:
            stems = [sound.stem] * several[0] + ([mesh.stem] if mesh and several[1] else [])
            texts = [text.replace("{name}", "_".join(stems)) for text in arguments.out]
            jobs.append(Job(sound, mesh, parse_outputs(texts)))
            check_kept(jobs[-1].outputs, [sound] if mesh is None else [sound, mesh])
    paths = [output.path.absolute() for job in jobs for output in job.outputs]
    if len(set(paths)) < len(paths):
        twice = next(path for path in paths if paths.count(path) > 1)
        raise ValueError(
            f"two animations would be {twice}: files of one folder differ in suffix alone"
        )
    return jobs


def check_identity(arguments: argparse.Namespace) -> None:
    """Makes sure that an identity is one, and is asked for where a head shows it.

    Raises:
        ValueError: it is not.
        OSError: its file is missing.
    """
    identity = arguments.identity
    if identity is None:
        return
    if arguments.engine != "head" or arguments.mesh is not None:
        raise ValueError(
            "--identity chooses a head that no mesh is given for: use it with --engine head, without --mesh"
        )
    kind, _, number = identity.partition(":")
    if kind == "sample" and number.isdecimal():
        return
    if kind == "sample" or not identity.endswith(".npz"):
        raise ValueError(
            f"--identity {identity}: expected sample:N, such as sample:7, or codes.npz"
        )
    check_readable(identity, "codes")


def prepare(
    talker: Callable[[], freetalk.Talker],
    file: Path | None,
    arguments: argparse.Namespace,
    report: Report,
) -> freetalk.Face:
    """Prepares a mesh and says what was guessed about it."""
    import freetalk

    if arguments.engine == "head" and file is None:
        return head_of(talker(), arguments, report)
    mesh = freetalk.load_mesh(file) if file is not None else built_in_face()
    landmarks = arguments.landmarks and check_readable(arguments.landmarks, "landmarks")
    face = talker().prepare(
        mesh, landmarks=landmarks, **preparation(arguments), progress=not report.quiet
    )
    name = file.name if file is not None else "the built-in mean face"
    found = face.report
    report.line(
        "mesh", f"{name}: {len(mesh.vertices)} vertices; {found.alignment.summary}; {found.parts}"
    )
    for notice in found.notices:
        report.line("note", notice, timed=False)
    return face


def head_of(
    talker: freetalk.Talker, arguments: argparse.Namespace, report: Report
) -> freetalk.Face:
    """The head of an identity of the weights."""
    identity = arguments.identity or "sample:0"
    if identity.startswith("sample:"):
        z_id = talker.sample_identity(int(identity.removeprefix("sample:")))
    else:
        from freetalk.head import ParametricHead, load_codes

        folder = find_weights(arguments.pretrained) / "head"
        z_id = load_codes(identity, ParametricHead.from_pretrained(folder).eval()).z_id
    face = talker.prepare_head(z_id, precision=arguments.precision, progress=not report.quiet)
    report.line("head", f"{identity}: {len(face.mesh.vertices)} vertices")
    return face


def animate(
    face: freetalk.Face,
    audio: freetalk.Audio,
    emotion: Emotion,
    arguments: argparse.Namespace,
    report: Report,
) -> freetalk.Animation:
    """Generates the motion."""
    names = ("intensity", "motion", "fps", "seed", "articulation", "blinks", "head_motion")
    options: dict[str, Any] = {name: getattr(arguments, name) for name in names}
    options["emotion"] = emotion
    options |= diffusion_options(arguments)
    if hasattr(arguments, "tolerance_mm"):
        options["tolerance_mm"] = arguments.tolerance_mm
    options["scratch_dir"] = tempfile.gettempdir()  # long speech: results larger than memory
    animation, found = face.animate_with_report(audio, **options, progress=not report.quiet)
    for notice in found.notices:
        report.line("note", notice, timed=False)
    stages = ", ".join(f"{stage} {seconds:.1f} s" for stage, seconds in found.timings.items())
    text = f"{animation.num_frames} frames, {animation.duration_s:.2f} s, {arguments.emotion}"
    if found.decoded_frames < found.num_frames:
        text += (
            f"; {found.decoded_frames} decoded, the rest within {found.decode_error_mm:.2f} mm and "
            f"{found.decode_error:.1%} on average where checked"
        )
    report.line("animated", f"{text} ({stages})")
    return animation


def write_all(
    animation: freetalk.Animation, job: Job, arguments: argparse.Namespace, report: Report
) -> None:
    """Writes every result that can be written.

    Raises:
        RuntimeError: one or more could not; the message names them and a file that keeps the motion.
    """
    failed: list[str] = []
    for output in job.outputs:
        try:
            write(animation, output, arguments, report, arguments.rig)
        except (ValueError, RuntimeError, OSError, ImportError) as error:
            failed.append(describe(error))
    if failed:
        from freetalk import _native

        kept = Path(_native.core.default_cache_dir()) / "unsaved.npz"
        animation.save(kept)
        raise RuntimeError(f"{'; '.join(failed)}; the animation is kept in {kept}")


def check_support(formats: set[str]) -> None:
    """Makes sure, before long work, that what single formats need is installed.

    Raises:
        RuntimeError: it is not; the message says what to install.
    """
    if formats & set(VIDEO_FORMATS):
        from freetalk.viz import check_video_support

        check_video_support()
    if formats & {"usd", "usdc", "usdz"}:
        from freetalk.exports.usd import check_usd_support

        check_usd_support()


def write(
    animation: freetalk.Animation,
    output: Output,
    arguments: argparse.Namespace,
    report: Report,
    rig: Any,
) -> None:
    """Writes one requested result and says what came of it."""
    if output.format in VIDEO_FORMATS:
        from freetalk.viz.video import MAX_VIDEO_FPS

        options = {"size": arguments.size, "progress": not report.quiet}
        animation.save(output.path, **options)
        if animation.fps > MAX_VIDEO_FPS:
            text = f"{output.path.name} shows {MAX_VIDEO_FPS:g} of its {animation.fps:g} frames a second"
            report.line("note", text, timed=False)
    elif output.is_folder:
        animation.save(output.path / f"*.{output.format}")
        report.line("wrote", f"{output.path}/ ({animation.num_frames} files)")
        return
    elif output.format in RIG_FORMATS:
        output.path.parent.mkdir(parents=True, exist_ok=True)
        made = animation.save(output.path, rig=rig, compact=arguments.compact)
        text = f"{output.path} {_size(output)}: {made.num_morph_targets} targets, "
        text += f"within {made.morph_error_mm:.2f} mm"
        report.line("wrote", text + (", into the mesh's own file" if made.into_source else ""))
        return
    else:
        output.path.parent.mkdir(parents=True, exist_ok=True)
        animation.save(output.path)
    report.line("wrote", f"{output.path} {_size(output)}")


def built_in_face() -> freetalk.Mesh:
    """The mean face that ships with the package."""
    import freetalk
    from freetalk.corpus import mean_face

    vertices, faces = mean_face("face")
    return freetalk.Mesh(vertices, faces.tolist(), name="the built-in face")


class Report:
    """Lines on stdout with the time each step took, unless quiet."""

    def __init__(self, quiet: bool) -> None:
        self.quiet = quiet
        self._start = self._last = time.perf_counter()

    def line(self, what: str, text: str, timed: bool = True) -> None:
        """Prints a step and, if timed, the seconds since the step before."""
        now = time.perf_counter()
        took = f"  [{now - self._last:.1f} s]" if timed else ""
        if not self.quiet:
            print(f"{what:>9}  {text}{took}", flush=True)
        self._last = now if timed else self._last

    def total(self) -> None:
        """Prints the time of everything."""
        if not self.quiet:
            print(f"{'done':>9}  in {time.perf_counter() - self._start:.1f} s", flush=True)


def _size(output: Output) -> str:
    return f"({output.path.stat().st_size / 1e6:.1f} MB)"
