"""``freetalk evaluate --pred``: its numbers against plain numpy, its inputs, tables and errors."""

from __future__ import annotations

import csv
import hashlib
import json
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
from dataset_layouts import packed, write_scantalk
from mini_corpus import write_mini_corpus

from freetalk.cli import main
from freetalk.data import open_dataset
from freetalk.data.templates import speaker_of
from freetalk.evaluate.masks import KNOWN_MASKS, describe_masks
from freetalk.evaluate.motion_files import NameMatcher, motion_paths, read_motion
from freetalk.evaluate.writers import number

VERTICES, FPS = 30, 25.0
LIPS, UPPER = [1, 4, 7, 9], [20, 21, 25]
PAIRS = [[1, 7], [4, 9]]
SPEAKERS = ("F1", "M10")
# Files are float32, whose seven digits at 200 mm leave 1e-5 mm; numbers are differences of a few mm.
TOLERANCE = 1e-4


def template(speaker: str) -> np.ndarray:
    """(V, 3) mm, 200 mm wide."""
    return np.random.default_rng(len(speaker)).uniform(-100, 100, (VERTICES, 3)).astype(np.float32)


def motion(seed: int, frames: int) -> np.ndarray:
    """Smooth displacements (T, V, 3) mm of a few millimetres."""
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0, 6, (1, VERTICES, 3))
    speed = rng.uniform(2, 9, (1, VERTICES, 3))
    return 3 * np.sin(phase + speed * np.arange(frames)[:, None, None] / FPS)


class Data:
    """Ground truth in millimetres as FaceFormer stores it, and two systems' predictions of it.

    System ``a`` writes absolute vertices (T, V * 3), one sequence two frames too long and one with two
    styles; system ``b`` writes displacements in metres as ``.npz``.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self.names = [f"{speaker}_e{number}" for speaker in SPEAKERS for number in (1, 2, 3)]
        self.true: dict[str, np.ndarray] = {}
        self.pred: dict[str, dict[str, list[np.ndarray]]] = {"a": {}, "b": {}}
        for folder in ("gt", "a", "b", "wav"):
            (root / folder).mkdir()
        with (root / "templates.pkl").open("wb") as file:
            pickle.dump({speaker: template(speaker) for speaker in SPEAKERS}, file)
        (root / "lve.txt").write_text(", ".join(map(str, LIPS)))
        (root / "fdd.txt").write_text("\n".join(map(str, UPPER)))
        (root / "pairs.json").write_text(json.dumps(PAIRS))
        for index, name in enumerate(self.names):
            self._write(index, name)
        self.phones = {n: [[0.1, 0.2, "B"], [0.3, 0.4, "AA"], [0.5, 0.6, "M"]] for n in self.names}
        (root / "phones.json").write_text(json.dumps(self.phones))
        emotions = {n: ("happy", "sad")[i % 2] for i, n in enumerate(self.names)}
        (root / "emotions.json").write_text(json.dumps(emotions))

    def _write(self, index: int, name: str) -> None:
        rest, frames = template(name.split("_")[0])[None], 25 + index
        true = self.true[name] = motion(index, frames)
        np.save(self.root / "gt" / f"{name}.npy", (rest + true).reshape(frames, -1).astype("f4"))
        extra = 2 if index == 3 else 0
        styles = ("F1", "M10") if index == 4 else ("F1",)
        self.pred["a"][name] = []
        for take, style in enumerate(styles):
            near = motion(index, frames + extra) + 0.5 * motion(100 + index + take, frames + extra)
            self.pred["a"][name].append(near[:frames])
            flat = (rest + near).reshape(len(near), -1).astype("f4")
            np.save(self.root / "a" / f"{name}_condition_{style}.npy", flat)
        far = 0.7 * true + motion(200 + index, frames)
        self.pred["b"][name] = [far]
        np.savez(
            self.root / "b" / f"{name}.npz",
            displacements=(far / 1000).astype("f4"),
            metres_per_unit=1.0,
        )
        tone = np.sin(np.arange(frames * 640) / 9) * np.repeat(1 + true[:, 1, 1] / 9, 640)
        soundfile.write(self.root / "wav" / f"{name}.wav", 0.3 * tone, 16000)

    def arguments(self, *more: str) -> list[str]:
        root = self.root
        given = (
            f"evaluate --pred {root / 'a'} {root / 'b'} --gt {root / 'gt'} --unit mm --fps {FPS}"
        )
        given += (
            f" --masks {root / 'lve.txt'} {root / 'fdd.txt'} --templates {root / 'templates.pkl'}"
        )
        return [*given.split(), "--resamples", "2000", *more]


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Data:
    return Data(tmp_path_factory.mktemp("scored"))


def run(data: Data, tmp_path: Path, *more: str, base: list[str] | None = None) -> dict[str, Any]:
    out = tmp_path / "scores.json"
    given = base if base is not None else data.arguments()
    assert main([*given, *more, "--out", str(out)]) == 0
    report: dict[str, Any] = json.loads(out.read_text())
    return report


def means(report: dict[str, Any], system: str) -> dict[str, float]:
    rows = report["metrics"]
    return {
        row["metric"]: row["systems"][system]["mean"] for row in rows if system in row["systems"]
    }


# What follows computes the scores anew, without anything of freetalk's; lengths in mm.


def path_cost(pred: np.ndarray, true: np.ndarray, join: Callable[[float, float], float]) -> float:
    cost = np.linalg.norm(pred[:, None] - true[None], axis=-1).mean(axis=-1)
    table = np.full((len(pred) + 1, len(true) + 1), np.inf)
    table[0, 0] = 0.0
    for i in range(len(pred)):
        for j in range(len(true)):
            before = min(table[i, j], table[i, j + 1], table[i + 1, j])
            table[i + 1, j + 1] = join(before, cost[i, j])
    return float(table[-1, -1])


def upper_spread(m: np.ndarray) -> float:
    return float(np.std(np.square(m[:, UPPER]).sum(axis=2), axis=0).mean())


def opening(m: np.ndarray) -> np.ndarray:
    upper, lower = np.array(PAIRS).T
    return (m[:, upper, 1] - m[:, lower, 1]).mean(axis=1)


def closes(data: Data, name: str, pred: np.ndarray, true: np.ndarray) -> list[float]:
    limit = 0.15 * opening(true).max()
    return [
        float(opening(pred)[round(a * FPS) : round(b * FPS)].min() <= limit)
        for a, b, label in data.phones[name]
        if label in "PBM"
    ]


def expected_scores(data: Data, system: str) -> dict[str, float]:
    per_frame: dict[str, list[float]] = {"lve": [], "mve_mean": []}
    per_sequence: dict[str, list[float]] = {}
    closed: list[float] = []
    for name in data.names:
        true = data.true[name]
        samples = data.pred[system][name]
        error = [np.linalg.norm(p - true, axis=2) for p in samples]
        per_frame["lve"] += list(
            np.mean([np.square(e[:, LIPS]).max(axis=1) for e in error], axis=0)
        )
        per_frame["mve_mean"] += list(np.mean([e.mean(axis=1) for e in error], axis=0))
        rows = []
        for p in samples:
            u, w = np.diff(p, axis=0), np.diff(true, axis=0)
            cosine = (u * w).sum(-1) / np.linalg.norm(u, axis=-1) / np.linalg.norm(w, axis=-1)
            jerk = [np.square(np.diff(m, n=3, axis=0)).sum(-1).mean() for m in (p, true)]
            rows.append(
                {
                    "fdd": upper_spread(true) - upper_spread(p),
                    "dtw": path_cost(p[:, LIPS], true[:, LIPS], float.__add__) / len(true),
                    "dfd": path_cost(p[:, LIPS], true[:, LIPS], max),
                    "delta_m": np.square(u - w).sum(-1).mean(),
                    "delta_cd": (1 - cosine).mean(),
                    "jitter_ratio": jerk[0] / jerk[1],
                    "lip_correlation": np.corrcoef(opening(p), opening(true))[0, 1],
                }
            )
        for key in rows[0]:
            per_sequence.setdefault(key, []).append(float(np.mean([row[key] for row in rows])))
        closed += list(np.mean([closes(data, name, p, true) for p in samples], axis=0))
    return {
        **{key: float(np.mean(values)) for key, values in {**per_frame, **per_sequence}.items()},
        "closure_rate": float(np.mean(closed)),
    }


@pytest.fixture(scope="module")
def full(data: Data, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The report of everything that can be scored."""
    root = data.root
    more = f"--lip-pairs {root / 'pairs.json'} --phones {root / 'phones.json'} --wav {root / 'wav'}"
    more += f" --emotions {root / 'emotions.json'}"
    return run(data, tmp_path_factory.mktemp("full"), *more.split())


@pytest.mark.parametrize("system", ["a", "b"])
def test_numbers_are_those_of_plain_numpy(data: Data, full: dict[str, Any], system: str) -> None:
    found = means(full, system)
    for key, value in expected_scores(data, system).items():
        assert found[key] == pytest.approx(value, rel=TOLERANCE, abs=TOLERANCE), key


def test_lips_are_compared_with_speech_over_the_whole_set(data: Data, full: dict[str, Any]) -> None:
    rows = {row["metric"]: row for row in full["metrics"]}
    assert rows["mtm"]["unit"] == "ms" and set(rows["mtm"]["systems"]) == {"a", "b"}
    loud = [
        np.sqrt(np.square(soundfile.read(data.root / "wav" / f"{n}.wav")[0]).mean())
        for n in data.names
    ]

    def moved(motion: np.ndarray) -> float:
        steps = np.linalg.norm(np.diff(motion[:, LIPS], axis=0), axis=-1).mean(axis=1)
        return float(np.sqrt(np.square(steps).mean()))

    def normal(values: list[float]) -> np.ndarray:  # by speaker: the first three are of one
        halves = np.reshape(values, (2, 3))
        spread = halves.std(axis=1, ddof=1, keepdims=True)
        return ((halves - halves.mean(axis=1, keepdims=True)) / spread).ravel()

    for system, motions in (("b", data.pred["b"]), ("", {n: [m] for n, m in data.true.items()})):
        lips = [moved(motions[name][0]) for name in data.names]
        expected = np.corrcoef(normal(loud), normal(lips))[0, 1]
        score = rows["slcc"]["systems"][system] if system else rows["slcc"]["ground_truth"]
        assert score["mean"] == pytest.approx(expected, abs=1e-4)  # 16-bit sound
    assert rows["slcc"]["paired"] == {}  # nearer to the truth's is better: no ideal to test against


def test_samples_count_by_their_mean_and_give_diversity(data: Data, full: dict[str, Any]) -> None:
    name = data.names[4]
    first, second = data.pred["a"][name]
    rows = {row["metric"]: row for row in full["metrics"]}
    assert rows["diversity_vertex"]["systems"]["a"]["per_sequence"] == {
        name: pytest.approx(np.linalg.norm(first - second, axis=2).mean(), rel=TOLERANCE)
    }
    assert "b" not in rows["diversity_vertex"]["systems"]
    true = data.true[name]
    worst = [np.square(p - true)[:, LIPS].sum(-1).max(axis=1).mean() for p in (first, second)]
    assert rows["lve_coverage"]["systems"]["a"]["mean"] == pytest.approx(min(worst), rel=TOLERANCE)


def test_the_report_says_what_the_numbers_are_of(data: Data, full: dict[str, Any]) -> None:
    digest = hashlib.sha256(np.array(sorted(LIPS), "<i8").tobytes()).hexdigest()
    lips = full["masks"]["lips"]
    assert (lips["count"], lips["vertices"]) == (len(LIPS), VERTICES)
    assert digest.startswith(lips["sha256"]) and len(lips["sha256"]) == 16
    units = {row["metric"]: row["unit"] for row in full["metrics"]}
    assert units["lve"] == "mm^2" and units["mve_mean"] == "mm" and units["delta_cd"] == "1"
    assert full["ground_truth"]["metres_per_unit"] == 0.001
    assert full["ground_truth"]["kind"] == "vertices"
    assert full["frames"] == sum(len(true) for true in data.true.values())
    cut = {system["name"]: system["sequences_cut"] for system in full["systems"]}
    assert cut == {"a": 1, "b": 0}
    assert any("by at most 2 frames" in note for note in full["notes"])
    truth = {row["metric"]: row["ground_truth"] for row in full["metrics"]}
    assert truth["closure_rate"] is not None and truth["audio_offset_ms"] is not None
    assert 0 <= means(full, "a")["emotion_rate"] <= 1


def test_intervals_and_tests_follow_the_sequences(full: dict[str, Any]) -> None:
    rows = {row["metric"]: row for row in full["metrics"]}
    for row in rows.values():
        for score in row["systems"].values():
            if score["low"] is not None:
                # Of few values BCa may leave the mean at the end of its interval, never outside the data.
                values = score["per_sequence"].values()
                assert min(values) <= score["low"] <= score["high"] <= max(values)
    test = rows["mve_mean"]["paired"]["b"]
    assert test["against"] == "a"
    # b is farther off in all six sequences: 2 of 2^6 sign patterns.
    assert (test["sequences_better"], test["sequences_worse"]) == (0, 6)
    assert test["p_permutation"] == pytest.approx(2 / 64)
    assert test["p_wilcoxon"] == pytest.approx(2 / 64)
    assert test["p_holm"] >= test["p_permutation"]


def test_tables_are_written_in_every_format(
    data: Data, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [tmp_path / f"scores{suffix}" for suffix in (".csv", ".tex", ".txt")]
    outs = [part for file in files for part in ("--out", str(file))]
    report = run(data, tmp_path, "--metrics", "paper", "delta_m@lips", *outs)
    printed = capsys.readouterr().out
    assert files[2].read_text().strip() == printed.strip()
    assert "LVE ↓" in printed and "mm^2" in printed and "Mask lips: 4 of 30 vertices" in printed
    assert report["masks"]["lips"]["sha256"] in printed
    rows = list(csv.DictReader(files[0].open()))
    assert len(rows) == 2 * 8
    first = next(row for row in rows if row["metric"] == "lve" and row["system"] == "b")
    assert float(first["mean"]) == means(report, "b")["lve"]
    assert first["mask_sha256"] == report["masks"]["lips"]["sha256"] and first["unit"] == "mm^2"
    tex = files[1].read_text()
    assert tex.count(r"\textbf") == 8 and r"\toprule" in tex and "sha256" in tex
    assert r"$\delta_M$ @ lips" in tex and r"$\mathrm{mm}^2$" in tex


def test_a_mask_of_ones_own_can_be_asked_for(data: Data, tmp_path: Path) -> None:
    jaw = [11, 12, 13]
    np.save(tmp_path / "jaw.npy", np.array(jaw))
    masks = [str(data.root / "lve.txt"), f"jaw={tmp_path / 'jaw.npy'}"]
    report = run(data, tmp_path, "--metrics", "mve_mean@jaw", "--masks", *masks)
    error = [
        np.linalg.norm(data.pred["b"][n][0] - data.true[n], axis=2)[:, jaw].mean(axis=1)
        for n in data.names
    ]
    assert means(report, "b")["mve_mean@jaw"] == pytest.approx(
        np.concatenate(error).mean(), rel=TOLERANCE
    )


def test_without_neutral_faces_differences_are_scored(data: Data, tmp_path: Path) -> None:
    base = data.arguments()
    at = base.index("--templates")
    base = [*base[:at], *base[at + 2 :]]
    base.remove(str(data.root / "b"))  # displacements cannot be compared with vertices then
    report = run(data, tmp_path, base=base)
    found, expected = means(report, "a"), expected_scores(data, "a")
    assert "fdd" not in found and any("fdd left out" in note for note in report["notes"])
    for key in ("lve", "mve_mean", "dtw", "delta_m"):
        assert found[key] == pytest.approx(expected[key], rel=TOLERANCE)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--strict"], "M10_e1_condition_F1.npy has 27 frames, the ground truth 25"),
        (["--metrics", "lvee"], "did you mean 'lve'"),
        (["--metrics", "closure_rate"], "closure_rate needs --lip-pairs"),
        (["--metrics", "lve@jaw"], "a mask called jaw"),
        (["--names", "other_{name}"], "has no prediction of the 6 sequences"),
        (["--names", "other"], "lacks {name}"),
        (["--unit", "parsec"], "unknown unit 'parsec'"),
        (["--baseline", "c"], "no system is called 'c'"),
        (["--out", "scores.doc"], "does not say what to write"),
        (["--split", "test"], "it has no splits"),
    ],
)
def test_mistakes_are_told_in_one_sentence(
    data: Data, more: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    message = message.replace(
        "has 27 frames, the ground truth 25", "has 30 frames, the ground truth 28"
    )
    assert main(data.arguments(*more)) == 2
    assert message in capsys.readouterr().err


def test_broken_files_are_named(
    data: Data, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def said(array: np.ndarray) -> str:
        np.save(tmp_path / "F1_e1.npy", array)
        base = data.arguments()
        base[base.index(str(data.root / "a"))] = f"broken={tmp_path}"
        assert main(base) == 2
        return capsys.readouterr().err

    nan = np.zeros((25, VERTICES, 3), np.float32)
    nan[7, 3, 1] = np.nan
    assert "F1_e1.npy: frame 7 holds NaN" in said(nan)
    assert "expected (T, V, 3) or (T, V * 3)" in said(np.zeros((25, 31), np.float32))
    assert "8 vertices, the ground truth has 30" in said(np.zeros((25, 8, 3), np.float32))
    assert "no plain array" in said(np.array([{"a": 1}], dtype=object))


def test_predictions_need_a_ground_truth(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", "--pred", "."]) == 2
    assert "--gt" in capsys.readouterr().err
    assert main(["evaluate"]) == 2
    assert "--data" in capsys.readouterr().err


@pytest.mark.parametrize("shape", [(4, 90), (4, 30, 3), (1, 4, 90), (1, 4, 30, 3)])
def test_every_public_shape_is_read(shape: tuple[int, ...], tmp_path: Path) -> None:
    values = np.arange(360, dtype=np.float32)
    np.save(tmp_path / "one.npy", values.reshape(shape))
    np.savez(tmp_path / "one.npz", anything=values.reshape(shape).astype(np.float64))
    for path in motion_paths(tmp_path):
        frames = read_motion(path, VERTICES).frames
        np.testing.assert_array_equal(frames, values.reshape(4, 30, 3))


def test_numbers_keep_their_significant_digits() -> None:
    shown = [number(v) for v in (0.0, 3.0, 12.3456, 12345.6, 0.00123456, 1.5e-9, 8e7, None)]
    assert shown == ["0", "3.000", "12.35", "12346", "0.001235", "1.5e-09", "8e+07", "–"]


def test_names_of_public_systems_are_understood() -> None:
    names = ["F1_e37", "F1_e3", "FaceTalk_170731_00024_TA_sentence01"]
    known = NameMatcher(names)
    assert known.match("F1_e37") == "F1_e37"
    assert known.match("F1_e37_condition_F2") == "F1_e37"
    assert known.match("F1_e3_7") == "F1_e3"
    assert known.match("F1_e3_sample12") == "F1_e3"
    styled = "FaceTalk_170731_00024_TA_sentence01_condition_FaceTalk_170728_03272_TA"
    assert known.match(styled) == names[2]
    assert known.match("F1_e38") is None
    own = NameMatcher(names, "faceformer_{name}_{sample}_out")
    assert own.match("faceformer_F1_e3_x_out") == "F1_e3"
    assert own.match("F1_e3") is None


def test_speakers_are_whole_words() -> None:
    assert speaker_of("F10_e1", ["F1", "F10"]) == "F10"
    assert speaker_of("F1_e1", ["F1", "F10"]) == "F1"
    assert speaker_of("F12_e1", ["F1"]) is None


def test_known_masks_are_recognised() -> None:
    from freetalk.data import Mask

    for vertices, count, digest in KNOWN_MASKS:
        assert 0 < count < vertices and len(digest) == 16
    other = describe_masks({"lips": Mask(np.arange(371), "own.txt")}, 5023)
    assert other["lips"]["known_as"] is None  # the count alone is not enough


@pytest.mark.usefixtures("own_cache")
def test_a_dataset_is_ground_truth_in_its_files_unit_and_axes(tmp_path: Path) -> None:
    directory = write_scantalk(tmp_path / "biwi", "biwi", frames=30)
    (tmp_path / "pred").mkdir()
    from freetalk.data import open_dataset

    data = packed(directory)
    dataset = open_dataset(data)
    sequences = dataset.sequences("test")
    assert sequences
    rng = np.random.default_rng(0)
    errors = []
    for sequence in sequences:
        path = next(directory.rglob(f"{sequence.id}.npy"))
        frames = np.load(path)
        shape = frames.shape
        frames = frames.reshape(len(frames), -1, 3)[: sequence.num_frames]
        noise = rng.normal(0, 1e-3, frames.shape) * np.abs(frames).max()
        np.save(
            tmp_path / "pred" / path.name, (frames + noise).reshape(-1, *shape[1:]).astype("f4")
        )
        errors.append(np.linalg.norm(noise, axis=2).mean(axis=1))
    given = f"evaluate --pred {tmp_path / 'pred'} --gt {data} --metrics paper --strict"
    out = tmp_path / "scores.json"
    assert main([*given.split(), "--resamples", "200", "--out", str(out)]) == 0
    report = json.loads(out.read_text())
    scale = report["ground_truth"]["metres_per_unit"]
    assert report["ground_truth"]["split_scored"] == "test"
    assert means(report, "pred")["mve_mean"] == pytest.approx(
        1000 * scale * np.concatenate(errors).mean(), rel=1e-3
    )
    assert {"lips", "upper"} <= set(report["masks"])


def test_landmarks_of_the_open_corpus_are_scored(tmp_path: Path) -> None:
    directory = write_mini_corpus(tmp_path / "corpus")
    corpus = open_dataset(directory)
    (tmp_path / "pred").mkdir()
    for sequence in corpus.sequences("test"):
        motion = corpus.landmarks(sequence) + np.float32([0, 0.002, 0])
        np.savez(tmp_path / "pred" / f"{sequence.id}.npz", displacements=motion)
    given = f"evaluate --pred {tmp_path / 'pred'} --gt {directory} --topology landmarks"
    out = tmp_path / "scores.json"
    assert main([*given.split(), "--resamples", "200", "--out", str(out)]) == 0
    found = means(json.loads(out.read_text()), "pred")
    assert found["mve_mean"] == pytest.approx(2, rel=1e-4)
    assert found["lve"] == pytest.approx(4, rel=1e-4)
    assert found["delta_m"] == pytest.approx(0, abs=1e-9)
    assert found["lip_correlation"] == pytest.approx(1, abs=1e-6)
