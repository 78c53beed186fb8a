"""The open corpus: public faces, captured and synthetic speech motion, and the code that builds it.

`build_corpus(out)` writes a corpus that training reads like any other data set; `freetalk.corpus.assets` gives
typed access to the data that ships with the package.
"""

from freetalk.corpus.assets import (
    FaceModel,
    Take,
    load_expression_take,
    load_face_model,
    load_take,
    mean_face,
    speech_clip,
)
from freetalk.corpus.build import build_corpus

__all__ = [
    "FaceModel",
    "Take",
    "build_corpus",
    "load_expression_take",
    "load_face_model",
    "load_take",
    "mean_face",
    "speech_clip",
]
