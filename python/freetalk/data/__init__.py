"""Datasets of speech and facial motion in one packed layout, read through one class.

``import_dataset`` packs VOCAset, BIWI, Multiface, EmoVOCA, MEAD, or a folder of one's own; the open corpus is
written in the same layout. ``open_dataset`` reads it, ``open_datasets`` mixes several. What is wrong with a
release is raised, or listed among the takes left out, by name (:mod:`freetalk.data.errors`), and
``check_dataset`` tells all of it.
"""

from freetalk.data.check import DatasetReport, check_dataset
from freetalk.data.codes import HeadCodes, write_codes
from freetalk.data.dataset import Dataset
from freetalk.data.emotions import EMOTIONS
from freetalk.data.errors import (
    DatasetError,
    LabelError,
    LayoutError,
    MissingFileError,
    MissingLandmarksError,
    MissingTemplateError,
    NotFiniteError,
    ShortAudioError,
    VertexCountError,
)
from freetalk.data.importing import import_dataset
from freetalk.data.index_files import Landmarks, Mask, index_hash, read_landmarks, read_mask
from freetalk.data.landmarks import NUM_LANDMARKS, lip_opening
from freetalk.data.opening import open_dataset, open_datasets, parse_spec
from freetalk.data.pack_writer import PackWriter
from freetalk.data.resampling import interpolate_frames
from freetalk.data.safe_pickle import UnsafePickleError, load_pickle
from freetalk.data.sequences import FaceMesh, MotionSequence

__all__ = [
    "EMOTIONS",
    "NUM_LANDMARKS",
    "Dataset",
    "DatasetError",
    "DatasetReport",
    "FaceMesh",
    "HeadCodes",
    "LabelError",
    "Landmarks",
    "LayoutError",
    "Mask",
    "MissingFileError",
    "MissingLandmarksError",
    "MissingTemplateError",
    "MotionSequence",
    "NotFiniteError",
    "PackWriter",
    "ShortAudioError",
    "UnsafePickleError",
    "VertexCountError",
    "check_dataset",
    "import_dataset",
    "index_hash",
    "interpolate_frames",
    "lip_opening",
    "load_pickle",
    "open_dataset",
    "open_datasets",
    "parse_spec",
    "read_landmarks",
    "read_mask",
    "write_codes",
]
