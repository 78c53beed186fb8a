"""What Blender is to be told beside a file: it keeps the frame rate, range and sound of its own scene."""

from __future__ import annotations

import os
from pathlib import Path

_IMPORTERS = {
    ".glb": "import_scene.gltf",
    ".gltf": "import_scene.gltf",
    ".usd": "wm.usd_import",
    ".usda": "wm.usd_import",
    ".usdc": "wm.usd_import",
    ".usdz": "wm.usd_import",
}


def blender_script(path: str | os.PathLike[str], fps: float, num_frames: int) -> str:
    """Two lines for Blender's Python console that open a saved animation at its own rate, with its sound.

    Args:
        path: the glTF or USD file; the sound is looked for beside it.
        fps: of the animation: Blender turns seconds into frames of its scene, 24 a second unless told.
        num_frames: of the animation.

    Raises:
        ValueError: another kind of file.
    """
    file = Path(path).absolute()
    importer = _IMPORTERS.get(file.suffix.lower())
    if importer is None:
        raise ValueError(f"'{path}' is not opened by Blender's importers: write .glb or .usdc")
    whole = max(1, round(fps))
    sound = str(file.with_name(f"{file.stem}.speech.wav"))
    return (
        f"import bpy, os; s = bpy.context.scene; s.render.fps, s.render.fps_base = {whole}, {whole / fps!r}; "
        f"bpy.ops.{importer}(filepath={str(file)!r}); s.frame_start, s.frame_end = 0, {num_frames - 1}\n"
        f"e = s.sequence_editor_create(); os.path.exists({sound!r}) and "
        f"(e.strips if hasattr(e, 'strips') else e.sequences).new_sound('speech', {sound!r}, 1, 0)\n"
    )
