"""Training data from videos of faces: tracked points, a fitted face model, a dataset."""

from freetalk.video.dataset import TalkerReport, report_of, save_fit_picture, write_dataset
from freetalk.video.fit import FittedClip, FittedTalker, fit_talker
from freetalk.video.solve import SolveOptions
from freetalk.video.tracks import (
    VIDEO_SUFFIXES,
    FaceTrack,
    read_tracks,
    track_videos,
    tracks_by_talker,
)

__all__ = [
    "VIDEO_SUFFIXES",
    "FaceTrack",
    "FittedClip",
    "FittedTalker",
    "SolveOptions",
    "TalkerReport",
    "fit_talker",
    "read_tracks",
    "report_of",
    "save_fit_picture",
    "track_videos",
    "tracks_by_talker",
    "write_dataset",
]
