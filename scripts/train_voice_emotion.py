"""Learns to read emotions from voices (EmoDB, which the package ships) with the encoder of a folder of weights.

    scripts/train_voice_emotion.py --pretrained open-small

Writes voice_emotion.json and .safetensors into the folder, and says how many clips of each actor are recognised when
the other seven are learnt from; these clips also tell how sure it may be of itself.
"""

from __future__ import annotations

import argparse

import numpy as np

from freetalk._files import content_hash
from freetalk._pretrained import find_weights
from freetalk.corpus.assets import ASSETS, load_clips
from freetalk.corpus.plan import EMODB_EMOTIONS
from freetalk.speech import SpeechEncoder
from freetalk.speech.voice_emotion import VoiceEmotion, voice_features
from freetalk.train.checkpoint import git_commit

#: Temperatures of the probabilities that are tried.
TEMPERATURES = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0)


def main() -> None:
    """Learns, scores actors that were left out, writes."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else None)
    parser.add_argument("--pretrained", default="open-small", help="folder or name of weights")
    folder = find_weights(parser.parse_args().pretrained)
    encoder = SpeechEncoder.from_pretrained(folder / "speech").eval()
    clips = load_clips()
    features = np.stack([voice_features(encoder, clip.audio) for clip in clips])
    acted = np.array([clip.emotion for clip in clips])
    shown = [EMODB_EMOTIONS[emotion] for emotion in acted]
    actors = np.array([clip.speaker for clip in clips])
    right = {"acted": np.zeros(len(clips), bool), "shown": np.zeros(len(clips), bool)}
    chances = np.zeros((len(TEMPERATURES), len(clips)))  # of what is shown
    for actor in sorted(set(actors)):
        others, own = actors != actor, np.flatnonzero(actors == actor)
        for name, labels in (("acted", acted), ("shown", np.array(shown))):
            model = VoiceEmotion.fit(features[others], labels[others].tolist())
            best = model.probabilities(features[own]).argmax(1)
            right[name][own] = np.array(model.labels)[best] == labels[own]
        truth = [model.labels.index(label) for label in labels[own]]
        for row, temperature in enumerate(TEMPERATURES):
            given = model.softened(temperature).probabilities(features[own])
            chances[row, own] = given[np.arange(len(own)), truth]
        print(f"actor {actor}: {right['acted'][own].mean():.2f} of {len(own)} clips")
    accuracy = {name: round(float(hits.mean()), 3) for name, hits in right.items()}
    print(f"left-out actors: {accuracy['acted']:.3f} of {len(set(acted))} acted emotions")
    temperature = TEMPERATURES[int(np.log(chances + 1e-9).mean(1).argmax())]
    print(f"temperature {temperature:g}")
    about = {
        "training": {
            "data": "EmoDB, the clips of the package",
            "data_fingerprint": content_hash(ASSETS / "emodb"),
            "encoder": content_hash(folder / "speech" / "model.safetensors"),
            "commit": git_commit(),
            "command": f"scripts/train_voice_emotion.py --pretrained {folder.name}",
            "left_out_actors": accuracy,
            "temperature": temperature,
        }
    }
    VoiceEmotion.fit(features, shown).softened(temperature).save(folder, about)
    print(f"{folder / 'voice_emotion.json'}")


if __name__ == "__main__":
    main()
