"""Pictures and videos of animations, drawn without a display."""

from __future__ import annotations

from freetalk.viz.pictures import (
    contact_sheet,
    landmark_plot,
    render_frame,
    render_frames,
    save_image,
)
from freetalk.viz.renderer import FaceRenderer, View
from freetalk.viz.sequence import Sequence, as_sequence
from freetalk.viz.video import save_video, write_video

__all__ = [
    "FaceRenderer",
    "Sequence",
    "View",
    "as_sequence",
    "contact_sheet",
    "landmark_plot",
    "render_frame",
    "render_frames",
    "save_image",
    "save_video",
    "write_video",
]
