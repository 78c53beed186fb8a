"""Scores weights on recorded talkers: opening and width of the mouth, closures, the open corpus's take, emotions.

    scripts/evaluate_recorded.py --weights open-small OUT --data english talkers --split val --corpus CORPUS

``--data`` are datasets of tracked talkers (``freetalk data from-video``); with ``--corpus`` the scores of
``freetalk evaluate --parts ats emotions`` on the open corpus follow, and that of a recording without motion.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from freetalk._files import write_json
from freetalk._pretrained import PRETRAINED
from freetalk.corpus.assets import speech_clip
from freetalk.data import open_dataset
from freetalk.evaluate import weights
from freetalk.evaluate.pretrained import SpeechToMotion
from freetalk.evaluate.recorded import evaluate_recorded


def main() -> None:
    """Prints the scores of each of the weights, one a line, and writes them."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else None)
    parser.add_argument("--weights", nargs="+", default=["open-small"], help="folders or names")
    parser.add_argument("--data", nargs="+", default=[], help="folders of tracked talkers")
    parser.add_argument("--split", default="val", help="of the data")
    parser.add_argument("--samples", type=int, default=1, help="performances of each clip")
    parser.add_argument("--corpus", type=Path, help="the open corpus")
    parser.add_argument("--out", type=Path, help="JSON to write")
    arguments = parser.parse_args()
    results: dict[str, dict[str, Any]] = {}
    for name in arguments.weights:
        folder = PRETRAINED / name if (PRETRAINED / name).is_dir() else Path(name)
        model = SpeechToMotion.of(folder)
        scores: dict[str, Any] = {}
        for path in arguments.data:
            dataset = open_dataset(path)
            scores[dataset.name] = evaluate_recorded(
                dataset, model, arguments.split, arguments.samples
            )
        if arguments.corpus is not None:
            corpus = open_dataset(arguments.corpus)
            parts = ("ats", "emotions")
            scores |= weights.measure(corpus, folder, parts=parts, audio=[speech_clip()])
        results[name] = scores
        print(name, json.dumps(scores, indent=1), flush=True)
    if arguments.out is not None:
        write_json(arguments.out, results)


if __name__ == "__main__":
    main()
