"""``freetalk animate``: the main job, from a recording and a mesh to files."""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from freetalk.cli.outputs import Output, check_readable, parse_outputs
from freetalk.cli.weights import find_weights

if TYPE_CHECKING:
    import freetalk


def run(arguments: argparse.Namespace) -> None:
    """Animates a mesh; every input and output is checked before the work begins."""
    outputs = parse_outputs(arguments.out)
    audio_file = check_readable(arguments.audio, "a recording of speech")
    mesh_file = None
    if arguments.mesh is not None:
        mesh_file = check_readable(arguments.mesh, "a mesh (OBJ, PLY, OFF, STL or glTF)")
    weights = find_weights(arguments.pretrained)
    if any(output.format == "mp4" for output in outputs):
        from freetalk.viz import check_video_support

        check_video_support()
    report = Report(arguments.quiet)

    import freetalk

    audio = freetalk.load_audio(audio_file)
    mesh = freetalk.load_mesh(mesh_file) if mesh_file is not None else built_in_face()
    talker = freetalk.Talker.from_pretrained(weights)
    report.line("loaded", _describe_inputs(audio, mesh, mesh_file))
    animation = animate(talker, audio, mesh, arguments, report)
    write_all(animation, outputs, arguments.size, report)
    report.total()


def animate(
    talker: freetalk.Talker,
    audio: freetalk.Audio,
    mesh: freetalk.Mesh,
    arguments: argparse.Namespace,
    report: Report,
) -> freetalk.Animation:
    """Generates the motion and says what was guessed about the mesh."""
    options: dict[str, Any] = {
        name: getattr(arguments, name)
        for name in (
            *("emotion", "intensity", "fps", "seed", "blinks", "precision"),
            *("unit", "up", "forward"),
        )
    }
    if hasattr(arguments, "sampler"):
        options["sampler"] = arguments.sampler
    if hasattr(arguments, "steps"):
        options["num_steps"] = arguments.steps
    for name in ("mouth_temperature", "tolerance_mm"):
        if hasattr(arguments, name):
            options[name] = getattr(arguments, name)
    if hasattr(arguments, "guidance"):
        options.update(arguments.guidance)
    options["scratch_dir"] = tempfile.gettempdir()  # long speech: results larger than memory
    animation = talker.animate(audio, mesh, **options, progress=not report.quiet)
    found = talker.report
    assert found is not None
    report.line("mesh", f"{found.alignment.summary}; {found.parts}", timed=False)
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
    animation: freetalk.Animation, outputs: list[Output], size: tuple[int, int], report: Report
) -> None:
    """Writes every result that can be written.

    Raises:
        RuntimeError: one or more could not; the message names them and a file that keeps the motion.
    """
    from freetalk.cli.app import describe

    failed: list[str] = []
    for output in outputs:
        try:
            write(animation, output, size, report)
        except (ValueError, RuntimeError, OSError, ImportError) as error:
            failed.append(describe(error))
    if failed:
        from freetalk import _native

        kept = Path(_native.core.default_cache_dir()) / "unsaved.npz"
        animation.save(kept)
        raise RuntimeError(f"{'; '.join(failed)}; the animation is kept in {kept}")


def write(
    animation: freetalk.Animation, output: Output, size: tuple[int, int], report: Report
) -> None:
    """Writes one requested result."""
    if output.format == "mp4":
        from freetalk.viz import save_video

        save_video(animation, output.path, size=size, progress=not report.quiet)
    elif output.is_folder:
        animation.save(output.path / f"*.{output.format}")
    else:
        output.path.parent.mkdir(parents=True, exist_ok=True)
        animation.save(output.path)
    report.line("wrote", f"{output.path}{'/' if output.is_folder else ''} {_size(output)}")


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


def _describe_inputs(audio: freetalk.Audio, mesh: freetalk.Mesh, mesh_file: Path | None) -> str:
    name = mesh_file.name if mesh_file is not None else "the built-in mean face"
    seconds = len(audio.samples) / audio.sample_rate_hz
    return f"{seconds:.2f} s of speech; {name}: {len(mesh.vertices)} vertices"


def _size(output: Output) -> str:
    if output.is_folder:
        return f"({sum(1 for _ in output.path.glob(f'*.{output.format}'))} files)"
    return f"({output.path.stat().st_size / 1e6:.1f} MB)"
