"""The open corpus: layout, disjoint splits, lips, emotions, determinism."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from freetalk.corpus import assets, build_corpus, curves, emotion, plan, rest, running
from freetalk.corpus.lips import LIMIT_M, Lips
from freetalk.corpus.phones import BILABIALS, LABIODENTALS
from freetalk.corpus.sequences import Job
from freetalk.corpus.stretch import stretched
from freetalk.data import check_dataset
from freetalk.tables import main as table

MODEL = assets.load_face_model()
LIPS = Lips(MODEL)
CLOSED_M = (
    0.0005  # a bilabial's least opening over its frames: well under the neutral lips' own 0.76 mm
)


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_corpus(tmp_path_factory.mktemp("corpus") / "tiny", "tiny", 0, progress=False)


@pytest.fixture(scope="module")
def manifest(corpus: Path) -> dict[str, Any]:
    return json.loads((corpus / "manifest.json").read_text())


def _frames(sequence: dict[str, Any]) -> slice:
    return slice(sequence["start_frame"], sequence["start_frame"] + sequence["num_frames"])


def test_assets_match_their_manifest_and_budget() -> None:
    listing = json.loads((assets.ASSETS / "manifest.json").read_text())
    assert listing["total_bytes"] <= 25_000_000
    for entry in listing["files"]:
        data = (assets.ASSETS / entry["path"]).read_bytes()
        assert hashlib.sha256(data).hexdigest() == entry["sha256"], entry["path"]
    folders = {Path(entry["path"]).parts[0] for entry in listing["files"]}
    for folder in folders:
        assert (assets.ASSETS / folder / "LICENSE").is_file()
        assert (assets.ASSETS / folder / "SOURCE.txt").is_file()


def test_canonical_frame_has_its_origin_at_the_mean_landmark() -> None:
    landmarks = MODEL.neutral[MODEL.landmarks68]
    np.testing.assert_allclose(landmarks.mean(axis=0), 0, atol=1e-6)
    assert landmarks[27, 1] > landmarks[8, 1]  # the nose lies above the chin
    assert landmarks[45, 0] > landmarks[36, 0]  # the subject's left eye is on +X
    assert 0.05 < landmarks[45, 0] - landmarks[36, 0] < 0.12  # metres


@pytest.mark.parametrize("extent", list(assets.EXTENTS))
def test_mean_face_is_a_closed_index_set(extent: str) -> None:
    vertices, faces = assets.mean_face(extent)
    assert len(vertices) == assets.EXTENTS[extent]
    assert faces.min() >= 0 and faces.max() < len(vertices)
    with pytest.raises(ValueError, match="narrow, face"):
        assets.mean_face("nose")


def test_layout_is_consistent(corpus: Path, manifest: dict[str, Any]) -> None:
    landmarks = np.load(corpus / "landmarks.npy")
    weights = np.load(corpus / "motion.npy")
    identities = np.load(corpus / "identities.npy")
    assert landmarks.dtype == np.float32 and landmarks.shape[1:] == (68, 3)
    assert weights.shape == (len(landmarks), len(manifest["expressions"]))
    assert np.isfinite(landmarks).all() and weights.min() >= 0 and weights.max() <= 1
    assert identities.shape == (len(manifest["identities"]), 100)
    basis = MODEL.landmark_basis.astype(np.float64)
    np.testing.assert_allclose(landmarks, np.tensordot(weights, basis, 1), atol=1e-6)
    ends = [0]
    for sequence in manifest["sequences"]:
        assert sequence["start_frame"] == ends[-1]
        ends.append(sequence["start_frame"] + sequence["num_frames"])
        assert sequence["emotion"] in emotion.EMOTIONS
        heard = round(sequence["num_frames"] * 16000 / 30)
        assert sequence["num_samples"] == (0 if sequence["source"] == "rom" else heard)
    assert ends[-1] == len(landmarks)
    assert {s["source"] for s in manifest["sequences"]} == {
        "synthetic", "emodb", "facegood", "rom", "rest", "running",
    }  # fmt: skip
    places = [s["first_sample"] for s in manifest["sequences"] if s["source"] == "facegood"]
    assert len(set(places)) < len(places)  # variants of a take share its sound
    assert check_dataset(corpus).ok
    assert not list(corpus.parent.glob(".*"))


def spoken(jobs: list[Job], field: str) -> set[str]:
    """Voices, sentences or takes of sequences, by plain reading of their fields."""
    texts = {clip.name: clip.text for clip in assets.load_clips()}
    found: set[str] = set()
    for job in jobs:
        if field == "voice":
            captured = job.source in ("facegood", "running") and not job.speaker
            own = job.voice.name.split("+")[-1] if job.voice else job.speaker
            found |= {"captured"} if captured else {own} if own else set()
        elif field == "sentence":
            found |= {job.text} if job.text else {texts[clip] for clip in job.clips}
        else:
            found |= {job.take, *job.clips, *(part.take for part in job.parts)}
    return found - {"", None}


def test_test_speech_is_as_disjoint_as_is_said_and_no_more() -> None:
    jobs = plan.all_jobs(plan.SIZES["small"], 0)
    others = [j for j in jobs if j.split != "test"]
    for source, promised in plan.DISJOINT.items():
        own = [j for j in jobs if j.split == "test" and j.source == source]
        for field in ("voice", "sentence", "take"):
            mine, both = spoken(own, field), spoken(own, field) & spoken(others, field)
            if field in promised:
                assert not both, f"{source}: {field}s are said to be unheard"
            else:
                assert both or not mine, f"{source}: {field}s are unheard, say so"
    emodb = [j for j in jobs if j.split == "test" and j.source == "emodb"]
    assert spoken(emodb, "sentence") <= spoken(others, "sentence")  # all ten of them


@pytest.mark.parametrize("size", ["tiny", "small"])
def test_no_split_shares_a_recording_or_a_synthetic_voice(size: str) -> None:
    jobs = plan.all_jobs(plan.SIZES[size], 0)
    for one, other in (("train", "test"), ("train", "val"), ("val", "test")):
        first, second = ([j for j in jobs if j.split == s] for s in (one, other))
        for field in ("text", "audio", "speaker"):
            held = [{getattr(j, field) for j in js} - {None} for js in (first, second)]
            assert all(held) and not held[0] & held[1], field
        variants = [{j.voice.name.split("+")[-1] for j in js if j.voice} for js in (first, second)]
        assert all(variants) and not variants[0] & variants[1]
    assert {j.take for j in jobs if j.split == "test" and j.source == "facegood"} == {"1114_3_15"}
    assert "1114_3_15" not in {j.take for j in jobs if j.split != "test"}
    joined = [j for j in jobs if j.source == "running"]
    held = {(take, split): (a, b) for take, split, a, b in plan.take_spans()}
    for job in joined:
        for part in job.parts:
            if part.take:
                first, last = held[part.take, job.split]  # no part of another split's frames
                assert first <= part.start < part.stop <= last
    assert {j.split for j in joined} == {"train", "val"}


def test_running_speech_opens_the_mouth_where_its_parts_did() -> None:
    rng = np.random.default_rng(3)
    take = assets.load_take("1114_2_01")
    per_frame = 16000 / 30
    spans = running.voiced_spans(take, [(0, 600)], per_frame)
    voiced = sum(stop - start for start, stop in spans)
    assert 0.2 * 600 < voiced < 0.8 * 600  # separate words: voice and pauses
    parts = running.draw_parts(rng, [("1114_2_01", a, b) for a, b in spans], 300)
    clock = np.arange(len(take.curves), dtype=np.float32)[
        :, None
    ]  # each frame's number as its motion
    given = [
        (p, take.audio[round(p.start * per_frame) : round(p.stop * per_frame)], clock[p.start : p.stop])
        for p in parts
    ]  # fmt: skip
    audio, motion = running.joined(given, rng, per_frame, 16000)
    assert len(motion) >= 300 and abs(len(audio) - len(motion) * per_frame) < len(parts) + 1
    at = 0
    for part in parts:  # away from the joints a part is played from its first frame to its last
        inside = motion[at + 2 : at + part.num_frames - 2, 0]
        if part.take and len(inside):
            assert part.start <= inside.min() and inside.max() <= part.stop - 1
            assert (np.diff(inside) > 0).all()
        elif not part.take:
            assert (inside == 0).all()
        at += part.num_frames - 2


@pytest.mark.parametrize("speed", [0.8, 1.0, 1.3, 1.5])
def test_stretched_speech_keeps_its_pitch_and_moves_its_events(speed: float) -> None:
    rate = 16000
    time = np.arange(3 * rate) / rate
    loud = (np.abs(time - 1.0) < 0.1) | (np.abs(time - 2.2) < 0.1)
    voice = np.where(loud, 1.0, 0.05) * sum(
        np.sin(2 * np.pi * 180 * k * time) / k for k in (1, 2, 3)
    )
    result = stretched(voice.astype(np.float32), speed, rate)
    assert len(result) == round(len(voice) / speed)
    spectrum = np.abs(np.fft.rfft(result * np.hanning(len(result))))
    assert np.argmax(spectrum) * rate / len(result) == pytest.approx(180, abs=1)
    level = np.convolve(np.abs(result), np.full(800, 1 / 800), mode="same")
    for event in (1.0, 2.2):
        near = np.abs(np.arange(len(level)) / rate - event / speed) < 0.3
        times = np.flatnonzero(near & (level > 0.5 * level.max())) / rate
        assert times.mean() == pytest.approx(event / speed, abs=0.015)
        assert np.ptp(times) == pytest.approx(0.2 / speed, abs=0.03)


@pytest.mark.parametrize("length", [0, 1, 300, 700])
def test_the_shortest_sounds_are_stretched_too(length: int) -> None:
    assert len(stretched(np.ones(length, np.float32), 1.4, 16000)) == round(length / 1.4)


def test_identities_and_topologies_have_their_splits(manifest: dict[str, Any]) -> None:
    split_of = [entry["split"] for entry in manifest["identities"]]
    for sequence in manifest["sequences"]:
        assert [split_of[sequence["identity"]]] == sequence["split"]
    assert {t["split"] for t in manifest["topologies"]} == {"train", "val", "test"}


def test_lips_close_on_bilabials_and_touch_teeth_on_labiodentals(
    corpus: Path, manifest: dict[str, Any]
) -> None:
    landmarks = np.load(corpus / "landmarks.npy")
    phones = json.loads((corpus / "phones.json").read_text())
    opening = landmarks[:, 62, 1] - landmarks[:, 66, 1]
    closures, teeth, vowels = [], [], []
    for sequence in manifest["sequences"]:
        if sequence["source"] != "synthetic":
            continue
        track = opening[_frames(sequence)]
        times = (np.arange(len(track)) + 0.5) / manifest["fps"]
        for start, end, label in phones[sequence["id"]]:
            inside = track[(times >= start) & (times < end)]
            if len(inside) == 0:
                continue
            if label in BILABIALS:
                closures.append(inside.min())
            elif label in LABIODENTALS:
                teeth.append(np.median(inside))
            elif label in ("AA", "AE"):
                vowels.append(inside.max())
    assert np.mean(np.array(closures) < CLOSED_M) > 0.95
    assert 0.0015 < np.median(teeth) < 0.0035
    assert 0.008 < np.median(vowels) < 0.016


def test_captured_speech_opens_as_speech_does() -> None:
    gap = []
    for name in assets.TRAIN_TAKES + assets.TEST_TAKES:
        weights = curves.facegood_weights(MODEL, LIPS, assets.load_take(name))
        opening = LIPS.opening(weights)
        gap.append(np.percentile(opening, 99.5))
        assert opening.max() <= LIMIT_M + 1e-4
        assert np.percentile(opening, 5) < 0.001  # closures stay closures
        assert LIPS.narrowest(weights).min() > -0.0007  # lips do not pass through each other
    assert 0.012 < max(gap) < 0.019


@pytest.mark.parametrize("label", emotion.EMOTIONS[1:])
def test_emotion_keeps_the_opening_and_grows_with_intensity(label: str) -> None:
    take = assets.load_take("1114_3_15")
    weights = curves.facegood_weights(MODEL, LIPS, take)[:240]
    opening = LIPS.opening(weights)
    basis = MODEL.landmark_basis.reshape(len(MODEL.expression_names), -1)
    moved = []
    for intensity in (1.0, 2.0, 3.0):
        rng = np.random.default_rng(0)
        shown = emotion.add_emotion(MODEL, LIPS, weights, label, intensity, rng)
        change = ((shown - weights) @ basis).reshape(-1, 68, 3)
        moved.append(np.linalg.norm(change[:, 17:48], axis=-1).mean())
        assert np.abs(LIPS.opening(shown) - opening).max() < 0.0012
        assert LIPS.opening(shown)[opening < 1e-4].max() < 0.0012  # closed lips stay closed
    assert moved[0] < moved[1] < moved[2]


def test_emotions_are_apart_in_the_upper_face() -> None:
    upper = [*range(17, 28), *range(36, 48), 31, 35]
    poses = [
        np.tensordot(emotion.pose(MODEL, label), MODEL.landmark_basis, 1)[upper].ravel()
        for label in emotion.EMOTIONS
    ]
    distance = np.linalg.norm(np.stack(poses)[:, None] - np.stack(poses)[None], axis=-1)
    assert distance[np.triu_indices(len(poses), 1)].min() > 0.008  # metres, all landmarks together


def test_rest_keeps_lips_closed_and_blinks() -> None:
    rng = np.random.default_rng(1)
    weights = rest.rest_weights(MODEL, LIPS, 600, rng)
    shown = rest.add_blinks(MODEL, weights, rng)
    assert np.abs(LIPS.opening(shown)).max() < 2e-4
    blink = shown[:, MODEL.index("eyeBlink_L")]
    closes = np.flatnonzero((blink[1:] > 0.5) & (blink[:-1] <= 0.5))
    assert 2 <= len(closes) <= 12  # in 20 s
    assert shown[:, MODEL.index("jawOpen")].std() > 0  # it breathes


def test_same_seed_gives_the_same_corpus(
    corpus: Path, tmp_path: Path, manifest: dict[str, Any]
) -> None:
    again = build_corpus(tmp_path / "again", "tiny", 0, progress=False)
    names = ["manifest.json", "landmarks.npy", "motion.npy", "audio.npy", "phones.json"]
    names += ["identities.npy", "extras.npz"]
    names += [t["file"] for t in manifest["topologies"]]
    for name in names:
        if name.endswith(".npz"):
            with np.load(corpus / name) as a, np.load(again / name) as b:
                assert all(np.array_equal(a[key], b[key]) for key in a)
        else:
            assert (corpus / name).read_bytes() == (again / name).read_bytes(), name
    stamp = (again / "manifest.json").stat().st_mtime_ns
    build_corpus(again, "tiny", 0, progress=False)
    assert (again / "manifest.json").stat().st_mtime_ns == stamp  # already there: kept


def test_build_refuses_wrong_sizes_and_foreign_folders(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="tiny, small, full"):
        build_corpus(tmp_path / "x", "huge")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("keep me")
    with pytest.raises(ValueError, match="is no dataset"):
        build_corpus(tmp_path / "mine", "tiny")
    assert (tmp_path / "mine" / "thesis.txt").read_text() == "keep me"


@pytest.mark.slow
@pytest.mark.usefixtures("own_cache")
def test_a_tiny_corpus_makes_a_table(corpus: Path, tmp_path: Path) -> None:
    arguments = ["--size=tiny", f"--data={corpus}", f"--work={tmp_path / 'work'}"]
    arguments += [f"--out={tmp_path / 'out'}", "--rows", "concat", "still face"]
    assert table("supp_2", arguments) == 0
    result = json.loads((tmp_path / "out/supp_2.json").read_text())
    assert [row["name"] for row in result["rows"]] == ["concat", "still face"]
    # At size small it lacks the meshings: said before anything is trained.
    with pytest.raises(ValueError, match="build a larger corpus"):
        table("supp_2", ["--size=small", f"--data={corpus}", f"--work={tmp_path / 'small'}"])
    assert not (tmp_path / "small").exists()
