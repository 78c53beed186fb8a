"""Opens an animation in Blender as a module and writes the vertices of every frame; run by Blender's own Python.

python blender_vertices.py SCRIPT FRAMES OUT: SCRIPT is what ``freetalk.exports.blender_script`` gives.
"""

import sys
from pathlib import Path

import bpy
import numpy as np


def main(script: str, frames: int, out: str) -> None:
    """Evaluates every frame; vertices are those of the world, brought from Blender's +Z up to +Y up."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    exec(Path(script).read_text())
    scene = bpy.context.scene
    meshes = [item for item in scene.objects if item.type == "MESH"]
    seen = []
    for frame in range(frames):
        scene.frame_set(frame)
        graph = bpy.context.evaluated_depsgraph_get()
        points = []
        for item in meshes:
            evaluated = item.evaluated_get(graph)
            mesh = evaluated.to_mesh()
            local = np.empty(3 * len(mesh.vertices))
            mesh.vertices.foreach_get("co", local)
            matrix = np.array(evaluated.matrix_world)
            points.append(local.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3])
        seen.append(np.concatenate(points)[:, [0, 2, 1]] * [1, 1, -1])
    editor = scene.sequence_editor
    strips = editor.strips if hasattr(editor, "strips") else editor.sequences
    sounds = [strip.frame_final_duration for strip in strips]
    keys = [item.data.shape_keys for item in meshes if item.data.shape_keys]
    names = [block.name for block in keys[0].key_blocks[1:]] if keys else []
    np.savez(
        out,
        vertices=np.array(seen),
        fps=scene.render.fps / scene.render.fps_base,
        end=scene.frame_end,
        sound_frames=np.array(sounds),
        names=np.array(names),
        uv=sum(len(item.data.uv_layers) for item in meshes),
        materials=np.array([slot.name for item in meshes for slot in item.material_slots]),
    )


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), sys.argv[3])
