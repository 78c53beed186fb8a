"""Datasets of speech and facial motion behind one interface.

``open_dataset`` finds out what a folder is: VOCAset (as released, or FaceFormer's copy), BIWI_6, Multiface,
EmoVOCA, MEAD-EMOTE, the open corpus, or a plain folder of one's own; ``open_datasets`` mixes several. What is
wrong with a folder is raised by name (:mod:`freetalk.data.errors`), and ``check_dataset`` tells all of it.
"""

from freetalk.data.at_rate import AtRate
from freetalk.data.catalogue import KINDS, open_dataset, open_datasets, parse_spec
from freetalk.data.check import DatasetReport, check_dataset
from freetalk.data.dataset import EMOTIONS, NUM_LANDMARKS, FaceMesh, MotionDataset, MotionSequence
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
from freetalk.data.index_files import Landmarks, Mask, index_hash, read_landmarks, read_mask
from freetalk.data.landmarks import lip_opening
from freetalk.data.mixed import MixedDataset
from freetalk.data.open_corpus import OpenCorpus
from freetalk.data.registered import RegisteredDataset
from freetalk.data.resampling import interpolate_frames
from freetalk.data.safe_pickle import UnsafePickleError, load_pickle

__all__ = [
    "EMOTIONS",
    "KINDS",
    "NUM_LANDMARKS",
    "AtRate",
    "DatasetError",
    "DatasetReport",
    "FaceMesh",
    "LabelError",
    "Landmarks",
    "LayoutError",
    "Mask",
    "MissingFileError",
    "MissingLandmarksError",
    "MissingTemplateError",
    "MixedDataset",
    "MotionDataset",
    "MotionSequence",
    "NotFiniteError",
    "OpenCorpus",
    "RegisteredDataset",
    "ShortAudioError",
    "UnsafePickleError",
    "VertexCountError",
    "check_dataset",
    "index_hash",
    "interpolate_frames",
    "lip_opening",
    "load_pickle",
    "open_dataset",
    "open_datasets",
    "parse_spec",
    "read_landmarks",
    "read_mask",
]
