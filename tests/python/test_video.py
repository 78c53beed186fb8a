"""Datasets from tracked faces: the fit finds what made the points, and what is written can be trained on."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import soundfile

from freetalk.cli.app import main
from freetalk.corpus.assets import load_face_model
from freetalk.data import check_dataset, lip_opening, open_dataset
from freetalk.video import (
    FaceTrack,
    fit_talker,
    read_tracks,
    report_of,
    save_fit_picture,
    tracks_by_talker,
    write_dataset,
)
from freetalk.video.points import LANDMARK_POINTS

FPS, SCALE_PX = 25.0, 740.0
MOVED = ("jawOpen", "mouthFunnel", "mouthSmile_L", "mouthSmile_R", "browInnerUp_L", "browInnerUp_R")


def spoken(frames: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Weights (T, E) of a mouth that opens and closes, and the landmarks' displacements (T, 68, 3)."""
    model, rng = load_face_model(), np.random.default_rng(seed)
    times = np.arange(frames) / FPS
    weights = np.zeros((frames, len(model.expression_names)), np.float32)
    for name in MOVED:
        rate, phase = rng.uniform(1.0, 2.5), rng.uniform(0, 6)
        weights[:, model.index(name)] = 0.4 * np.clip(np.sin(6 * rate * times + phase), 0, 1)
    weights[:15] = 0  # the talker rests before speaking
    return weights, np.tensordot(weights, model.landmark_basis, 1)


def tracked(name: str, frames: int = 90, seed: int = 0, noise_px: float = 0.3) -> FaceTrack:
    """What a tracker would see of a talker with an identity, whose head turns and comes nearer."""
    model, rng = load_face_model(), np.random.default_rng(seed)
    identity = np.random.default_rng(7).normal(0, 0.6, len(model.identity_basis)).astype(np.float32)
    shape = model.neutral + np.pad(
        np.tensordot(identity, model.identity_basis, 1),
        ((0, len(model.neutral) - model.identity_basis.shape[1]), (0, 0)),
    )
    moved = shape[model.landmarks68] + spoken(frames, seed)[1]
    times = np.arange(frames) / FPS
    points = np.zeros((frames, 68, 3))
    for k, t in enumerate(times):
        yaw, pitch = 0.15 * np.sin(2 * t), 0.08 * np.cos(1.3 * t)
        turn = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
        nod = np.array(
            [[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]]
        )
        points[k] = SCALE_PX * (1 + 0.02 * np.sin(t)) * moved[k] @ (nod @ turn).T
    points += [200, -150, 0] + rng.normal(0, noise_px, points.shape)
    return FaceTrack(
        name, "anna", points.astype(np.float32), np.ones(frames, bool), FPS, Path(f"{name}.wav")
    )


def with_sound(track: FaceTrack, folder: Path) -> FaceTrack:
    path = folder / f"{track.name}.wav"
    soundfile.write(path, np.zeros(round(len(track.points) / FPS * 16000)), 16000)
    return replace(track, media=path, words=((0.0, 0.5, "bin"),), text="bin")


def test_fit_finds_the_motion_that_made_the_points():
    track = tracked("a")
    talker = fit_talker([track])
    true, made = spoken(90, 0)[1], talker.clips[0].landmarks
    assert np.corrcoef(lip_opening(made), lip_opening(true))[0, 1] > 0.98
    # The tracker sees the talker's own scale up to the identity's: a tenth.
    assert np.abs(made - true)[:, 48:68].mean() < 0.0012
    report = report_of(talker, talker.clips)
    assert report.error_px < 0.8  # noise of 0.3 px in each direction, and what the model cannot say
    assert report.width_correlation > 0.95 and report.closed > 0.95


def test_weights_stay_within_their_bounds():
    clip = fit_talker([tracked("a", noise_px=2.0)]).clips[0]
    assert clip.weights.min() >= 0 and clip.weights.max() <= 1


def test_lost_points_do_not_move_the_face():
    clean = tracked("a")
    broken = clean.points.copy()
    broken[40:50, 30] += 60  # the nose jumps away
    broken[60, 55] -= 80
    moved = fit_talker([replace(clean, points=broken)]).clips[0].landmarks
    expected = fit_talker([clean]).clips[0].landmarks
    assert np.abs(moved - expected).max() < 0.004


def test_frames_without_a_face_are_filled_and_marked():
    track = tracked("a")
    found = track.found.copy()
    found[30:33] = False
    points = np.where(found[:, None, None], track.points, 0).astype(np.float32)
    clip = fit_talker([replace(track, points=points, found=found)]).clips[0]
    assert not clip.good[30:33].any() and clip.good.mean() > 0.9
    step = (clip.weights[33] - clip.weights[29]) / 4
    assert np.allclose(clip.weights[31], clip.weights[29] + 2 * step, atol=1e-6)


def test_too_few_frames_are_refused():
    with pytest.raises(ValueError, match="9 frames with a face"):
        fit_talker([tracked("a", frames=9)])


def test_dataset_can_be_opened_and_says_what_was_left_out(tmp_path):
    good = [with_sound(tracked(f"clip{k}", seed=k), tmp_path) for k in range(3)]
    lost = replace(with_sound(tracked("lost", seed=9), tmp_path), found=np.arange(90) < 60)
    report = write_dataset(tmp_path / "out", [fit_talker([*good, lost])], "train")
    assert report["left_out"] == {"anna_lost": "a face in 67% of the frames"}
    assert report["splits"] == {"train": 3, "val": 0, "test": 0}
    dataset = open_dataset(tmp_path / "out")
    sequences = dataset.sequences("train")
    assert [s.id for s in sequences] == ["anna_clip0", "anna_clip1", "anna_clip2"]
    assert sequences[0].fps == FPS and sequences[0].text == "bin" and sequences[0].voice == "anna"
    with np.load(tmp_path / "out" / "fit" / "anna_clip1.npz") as fit:
        weights = fit["weights"]
        assert fit["rotation"].shape == (90, 3, 3) and json.loads(str(fit["words"]))[0][2] == "bin"
    expected = np.tensordot(weights, load_face_model().landmark_basis, 1)
    assert np.allclose(dataset.landmarks(sequences[1]), expected, atol=1e-6)
    assert dataset.expressions == load_face_model().expression_names
    kept = dataset.weights(sequences[1])
    assert np.array_equal(kept, weights[: len(kept)]) and len(kept) == sequences[1].num_frames
    assert check_dataset(tmp_path / "out").ok


def test_a_folder_that_holds_something_is_not_written_to(tmp_path):
    (tmp_path / "mine.txt").write_text("x")
    with pytest.raises(ValueError, match="not empty"):
        write_dataset(tmp_path, [], "auto")


def write_tracks(folder: Path, tracks: list[FaceTrack], points: tuple[int, ...]) -> None:
    """Tracks as files: differences in time, in sixteenths of a pixel."""
    (folder / "audio").mkdir(parents=True)
    parts = []
    for track in tracks:
        soundfile.write(folder / "audio" / f"{track.name}.flac", np.zeros(57600), 16000)
        steps = np.round(16 * track.points * [1, -1, -1]).astype(np.int32)
        parts.append(np.diff(steps, axis=0, prepend=0 * steps[:1])[:, : len(points)])
    np.savez(
        folder / "tracks.npz",
        names=np.array([t.name for t in tracks]),
        frames=np.array([len(t.points) for t in tracks]),
        points=np.array(points),
        fps=FPS,
        delta=np.concatenate(parts).astype(np.int16),
    )
    words = {t.name: [[0.0, 0.4, "sil"], [0.4, 0.9, "bin"]] for t in tracks}
    (folder / "words.json").write_text(json.dumps(words))


def test_tracks_are_read_as_they_were_written(tmp_path):
    tracks = [tracked("a", seed=1), tracked("b", 40, seed=2)]
    write_tracks(tmp_path / "anna", tracks, LANDMARK_POINTS)
    read = read_tracks(tmp_path / "anna", "anna")
    assert [(t.name, t.talker, len(t.points)) for t in read] == [
        ("a", "anna", 90),
        ("b", "anna", 40),
    ]
    assert np.abs(read[1].points - tracks[1].points).max() <= 1 / 32 + 1e-4
    assert read[0].text == "bin" and read[0].words[1] == (0.4, 0.9, "bin")
    alone = tracks_by_talker([tmp_path / "anna"], "file")
    assert sorted(alone) == ["a", "b"]


def test_tracks_without_a_landmark_are_refused(tmp_path):
    write_tracks(tmp_path, [tracked("a")], LANDMARK_POINTS[:-1])
    with pytest.raises(ValueError, match=rf"lacks MediaPipe's points \[{LANDMARK_POINTS[-1]}\]"):
        read_tracks(tmp_path)


def test_command_makes_a_dataset(tmp_path, capsys):
    write_tracks(tmp_path / "anna", [tracked("a"), tracked("b", seed=3)], LANDMARK_POINTS)
    out = tmp_path / "out"
    assert main(["data", "from-video", str(tmp_path / "anna"), "--out", str(out)]) == 0
    assert "anna: 2 clips, 180 frames" in capsys.readouterr().out
    assert len(open_dataset(out).sequences()) == 2


def test_command_names_a_folder_without_videos(tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    assert main(["data", "from-video", str(tmp_path / "empty"), "--out", str(tmp_path / "o")]) != 0
    assert "holds neither tracks.npz nor videos" in capsys.readouterr().err


def test_picture_shows_the_clips(tmp_path):
    pytest.importorskip("matplotlib")
    talker = fit_talker([tracked("a"), tracked("b", seed=3)])
    save_fit_picture(talker, tmp_path / "fit.png")
    assert (tmp_path / "fit.png").read_bytes().startswith(b"\x89PNG")
    # Fitted points lie where the tracker saw them.
    clip = talker.clips[0]
    assert np.abs(clip.projected - clip.track.points[..., :2]).mean() < 1.0
