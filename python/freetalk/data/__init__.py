"""Datasets of speech and facial motion behind one interface."""

from freetalk.data.dataset import EMOTIONS, NUM_LANDMARKS, FaceMesh, MotionDataset, MotionSequence
from freetalk.data.landmarks import lip_opening
from freetalk.data.open_corpus import OpenCorpus

__all__ = [
    "EMOTIONS",
    "NUM_LANDMARKS",
    "FaceMesh",
    "MotionDataset",
    "MotionSequence",
    "OpenCorpus",
    "lip_opening",
]
