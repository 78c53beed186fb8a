"""Pictures and videos of animations, drawn without a display."""

from __future__ import annotations

from freetalk.viz.appearance import part_labels
from freetalk.viz.cavities import boundary_rims
from freetalk.viz.heat import heat_map, heat_sheet
from freetalk.viz.pictures import (
    contact_sheet,
    landmark_plot,
    render_frame,
    render_frames,
    save_image,
)
from freetalk.viz.renderer import FaceRenderer, View
from freetalk.viz.sequence import Sequence, as_sequence
from freetalk.viz.video import check_video_support, save_video, write_video

__all__ = [
    "FaceRenderer",
    "Sequence",
    "View",
    "as_sequence",
    "boundary_rims",
    "check_video_support",
    "contact_sheet",
    "heat_map",
    "heat_sheet",
    "landmark_plot",
    "part_labels",
    "render_frame",
    "render_frames",
    "save_image",
    "save_video",
    "write_video",
]
