"""``freetalk view``."""

from __future__ import annotations

import argparse
import os
import sys
import webbrowser
from pathlib import Path

from freetalk._files import write_text
from freetalk.cli.outputs import check_readable, check_writable


def run(arguments: argparse.Namespace) -> None:
    """Writes the files that are named, or shows the page until it is stopped."""
    files = [check_readable(file, "an animation (.npz)") for file in arguments.files]
    truth = texture = None
    if arguments.truth is not None:
        truth = check_readable(arguments.truth, "an animation (.npz)")
    if arguments.texture is not None:
        texture = check_readable(arguments.texture, "a picture (PNG, JPEG or WebP)")
    wanted = {".png": arguments.png, ".mp4": arguments.mp4, ".html": arguments.html}
    for suffix, path in wanted.items():
        if path is not None and Path(path).suffix.lower() != suffix:
            raise ValueError(f"'{path}' must end in {suffix}")
        if path is not None:
            check_writable(Path(path))
    if arguments.png is not None or arguments.mp4 is not None:
        _render(files[0], arguments)
    if arguments.html is not None or not any(wanted.values()):
        _page(files, truth, texture, arguments)


def _render(file: Path, arguments: argparse.Namespace) -> None:
    from freetalk import viz

    sequence = viz.as_sequence(file)
    view = viz.View(yaw_deg=arguments.yaw)
    if arguments.png is not None:
        image = viz.render_frame(sequence, arguments.time, arguments.size, view)
        print(f"wrote {viz.save_image(image, arguments.png)}")
    if arguments.mp4 is not None:
        print(f"wrote {viz.save_video(sequence, arguments.mp4, size=arguments.size, view=view)}")


def _page(
    files: list[Path], truth: Path | None, texture: Path | None, arguments: argparse.Namespace
) -> None:
    from freetalk import Animation, page

    takes = {
        file.stem if _alone(file, files) else str(file): Animation.load(file) for file in files
    }
    title = ", ".join(takes) if arguments.html is None else Path(arguments.html).stem
    content = page.make_page(
        takes,
        title=title,
        truth=None if truth is None else Animation.load(truth),
        texture=texture,
    )
    if arguments.html is not None:
        write_text(Path(arguments.html), content)
        print(f"wrote {arguments.html}")
        return
    with page.PageServer(content, arguments.port or 0) as server:
        print(f"showing {server.address} until Ctrl-C", flush=True)
        if has_display():
            webbrowser.open(server.address)
        else:
            print(
                f"from another machine: ssh -L {server.port}:127.0.0.1:{server.port} HOST, then the same address"
            )
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            print("closed")


def _alone(file: Path, files: list[Path]) -> bool:
    return sum(other.stem == file.stem for other in files) == 1


def has_display() -> bool:
    """Whether a browser has somewhere to open."""
    if not sys.platform.startswith("linux"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
