"""``freetalk view``."""

from __future__ import annotations

import argparse
from pathlib import Path

from freetalk.cli.outputs import check_readable, check_writable


def run(arguments: argparse.Namespace) -> None:
    """Opens a window, or renders to the files that are named."""
    file = check_readable(arguments.file, "an animation (.npz)")
    for path, suffix in ((arguments.png, ".png"), (arguments.mp4, ".mp4")):
        if path is not None and Path(path).suffix.lower() != suffix:
            raise ValueError(f"'{path}' must end in {suffix}")
        if path is not None:
            check_writable(Path(path))
    from freetalk import viz

    sequence = viz.as_sequence(file)
    view = viz.View(yaw_deg=arguments.yaw)
    if arguments.png is not None:
        image = viz.render_frame(sequence, arguments.time, arguments.size, view)
        print(f"wrote {viz.save_image(image, arguments.png)}")
    if arguments.mp4 is not None:
        print(f"wrote {viz.save_video(sequence, arguments.mp4, size=arguments.size, view=view)}")
    if arguments.png is None and arguments.mp4 is None:
        viz.show(sequence, arguments.size, view)
