"""Scores of speech-driven faces: vertex errors, lip opening and closures, affect."""

from freetalk.evaluate.speech_motion import (
    NearestCentroid,
    affect_features,
    closures,
    correlation,
    log_energy,
)

__all__ = ["NearestCentroid", "affect_features", "closures", "correlation", "log_energy"]
