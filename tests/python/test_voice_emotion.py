"""Emotions read from voices: recognised where they are clear, neutral where they are not."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import freetalk as ft
from freetalk._pretrained import PRETRAINED
from freetalk.corpus.assets import load_clips, mean_face, speech_clip
from freetalk.corpus.plan import EMODB_EMOTIONS
from freetalk.speech.voice_emotion import VoiceEmotion
from freetalk.talker.voice import Voice, summary


def clusters(rng: np.random.Generator, count: int = 60) -> tuple[np.ndarray, list[str]]:
    centres = {"angry": 2.0, "neutral": 0.0, "sad": -2.0}
    rows = [rng.normal(at, 0.5, (count, 6)) for at in centres.values()]
    labels = [name for name in centres for _ in range(count)]
    return np.concatenate(rows).astype(np.float32), labels


def angry() -> list[ft.Audio]:
    """The longest clips of anger."""
    clips = [clip for clip in load_clips() if clip.emotion == "anger"]
    longest = sorted(clips, key=lambda clip: -len(clip.audio))[:8]
    return [ft.Audio(np.array(clip.audio), 16000) for clip in longest]


def test_clear_classes_are_found_and_strange_windows_are_not_known() -> None:
    rng = np.random.default_rng(0)
    features, labels = clusters(rng)
    reader = VoiceEmotion.fit(features, labels)
    new, truth = clusters(rng, 20)
    best = reader.probabilities(new).argmax(1)
    assert [reader.labels[k] for k in best] == truth
    assert reader.knows(new).mean() > 0.9 and not reader.knows(new + 30).any()
    np.testing.assert_allclose(reader.probabilities(new).sum(1), 1, rtol=1e-5)


def test_softer_is_less_sure_of_the_same() -> None:
    features, labels = clusters(np.random.default_rng(1))
    reader = VoiceEmotion.fit(features, labels)
    sure, soft = reader.probabilities(features), reader.softened(8.0).probabilities(features)
    assert (soft.max(1) <= sure.max(1) + 1e-6).all() and soft.max(1).mean() < sure.max(1).mean()
    np.testing.assert_array_equal(soft.argmax(1), sure.argmax(1))


def test_one_class_or_one_window_is_refused() -> None:
    with pytest.raises(ValueError, match="two emotions"):
        VoiceEmotion.fit(np.zeros((3, 2), np.float32), ["sad", "sad", "angry"])


def test_weights_are_saved_and_loaded(tmp_path: Path) -> None:
    features, labels = clusters(np.random.default_rng(2))
    reader = VoiceEmotion.fit(features, labels)
    reader.save(tmp_path, {"training": {"data": "made up"}})
    assert json.loads((tmp_path / "voice_emotion.json").read_text())["training"]
    again = VoiceEmotion.from_pretrained(tmp_path)
    np.testing.assert_array_equal(again.probabilities(features), reader.probabilities(features))
    with pytest.raises(ValueError, match="read no emotions"):
        VoiceEmotion.from_pretrained(tmp_path / "elsewhere")


def test_shipped_weights_recognised_actors_that_were_left_out() -> None:
    about = json.loads((PRETRAINED / "open-small" / "voice_emotion.json").read_text())
    assert about["training"]["left_out_actors"]["acted"] >= 0.7


def test_acted_voices_show_and_an_even_reader_does_not() -> None:
    voice = Voice(PRETRAINED / "open-small")
    keys = [key for sound in angry() for key in voice.read(sound)]
    shown = [max(mixture, key=lambda name: mixture[name]) for _, mixture, _ in keys]
    assert np.mean([name == EMODB_EMOTIONS["anger"] for name in shown]) > 0.7
    assert all(1 <= intensity <= 3 for _, _, intensity in keys)
    silent = voice.read(ft.Audio(np.zeros(32000, np.float32), 16000))
    assert silent == [(1.0, {"neutral": 1.0}, 1.0)]
    assert summary(silent) == "1.0 s neutral"


@pytest.mark.slow
def test_auto_is_the_emotion_that_was_read() -> None:
    talker = ft.Talker.from_pretrained("open-small")
    sound = angry()[0]
    face = talker.prepare(ft.Mesh(*mean_face("narrow")), progress=False)
    made = [
        np.asarray(face.animate(sound, emotion=e, num_steps=4, progress=False).displacements)
        for e in ("auto", talker.read_emotion(sound), "neutral")
    ]
    np.testing.assert_array_equal(made[0], made[1])
    assert np.abs(made[0] - made[2]).max() > 1e-4
    assert len(talker.read_emotion(speech_clip())) > 3
