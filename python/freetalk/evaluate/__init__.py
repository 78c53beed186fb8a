"""Scores of speech-driven faces: of any system's predictions, and of weights on the open corpus."""

from freetalk.evaluate.generated import (
    features_of,
    frechet_distance,
    kernel_distance,
)
from freetalk.evaluate.ground_truth import FolderSettings, GroundTruth, open_ground_truth
from freetalk.evaluate.masks import KNOWN_MASKS, describe_masks, read_masks
from freetalk.evaluate.predictions import PredictionSettings, Scores, score_predictions
from freetalk.evaluate.report import StatisticsSettings, make_report
from freetalk.evaluate.speech_motion import (
    NearestCentroid,
    affect_features,
    closures,
    correlation,
    log_energy,
)
from freetalk.evaluate.surfaces import (
    SurfaceDistances,
    SurfaceScores,
    surface_distances,
    surface_scores,
)
from freetalk.evaluate.writers import write_report

__all__ = [
    "KNOWN_MASKS",
    "FolderSettings",
    "GroundTruth",
    "NearestCentroid",
    "PredictionSettings",
    "Scores",
    "StatisticsSettings",
    "SurfaceDistances",
    "SurfaceScores",
    "affect_features",
    "closures",
    "correlation",
    "describe_masks",
    "features_of",
    "frechet_distance",
    "kernel_distance",
    "log_energy",
    "make_report",
    "open_ground_truth",
    "read_masks",
    "score_predictions",
    "surface_distances",
    "surface_scores",
    "write_report",
]
