"""``freetalk evaluate --pred``: unit, frame rate, axes and length are those of the files, or it stops."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dataset_layouts import packed, write_scantalk

import freetalk
from freetalk.cli import main
from freetalk.data import open_dataset

VERTICES = 30
NAMES = ("F1_e1", "F1_e2")
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "0.1": 0.1}
#: Metrics of which a perfect prediction's value is no distance, so that they do not vanish.
IDEALS = {"lip_correlation": 1.0, "jitter_ratio": 1.0}


def face() -> np.ndarray:
    """(V, 3) m, as wide as a head."""
    return np.random.default_rng(0).uniform(-0.1, 0.1, (VERTICES, 3))


def motion(name: str, frames: int = 40) -> np.ndarray:
    """Smooth displacements (T, V, 3) of a few millimetres, m."""
    rng = np.random.default_rng(len(name) + ord(name[-1]))
    phase, speed = rng.uniform(0, 6, (1, VERTICES, 3)), rng.uniform(0.1, 0.4, (1, VERTICES, 3))
    return 0.003 * np.sin(phase + speed * np.arange(frames)[:, None, None])


def write_animation(path: Path, moved: np.ndarray, scale: float, fps: float) -> None:
    triangles = np.arange(VERTICES).reshape(-1, 3)
    mesh = freetalk.Mesh(face() / scale, triangles)
    animation = freetalk.Animation(mesh, moved / scale, fps=fps, metres_per_unit=scale)
    animation.save(path)


Writer = Callable[[Path, np.ndarray, float, float], None]
FORMATS: dict[str, tuple[str, Writer]] = {
    "frames.npy": (".npy", lambda p, m, s, f: np.save(p, (face() + m) / s)),
    "flat.npy": (".npy", lambda p, m, s, f: np.save(p, ((face() + m) / s).reshape(len(m), -1))),
    "batch.npy": (".npy", lambda p, m, s, f: np.save(p, (m / s)[None])),
    "displacements.npz": (".npz", lambda p, m, s, f: np.savez(p, displacements=m / s)),
    "vertices.npz": (".npz", lambda p, m, s, f: np.savez(p, vertices=(face() + m) / s)),
    "verts.npz": (".npz", lambda p, m, s, f: np.savez(p, verts=(face() + m) / s)),
    "pred.npz": (".npz", lambda p, m, s, f: np.savez(p, pred=m / s)),
    "one array.npz": (".npz", lambda p, m, s, f: np.savez(p, (face() + m) / s)),
    "rated.npz": (".npz", lambda p, m, s, f: np.savez(p, prediction=m / s, fps=f)),
    "measured.npz": (".npz", lambda p, m, s, f: np.savez(p, pred=m / s, metres_per_unit=s)),
    "animation.npz": (".npz", write_animation),
}


def write(folder: Path, kind: str, scale: float, fps: float, frames: int = 40) -> Path:
    suffix, writer = FORMATS[kind]
    folder.mkdir(parents=True)
    for name in NAMES:
        writer(folder / f"{name}{suffix}", motion(name, frames), scale, fps)
    return folder


def report_of(root: Path, *arguments: object) -> dict[str, Any]:
    out = root / "scores.json"
    np.savetxt(root / "lips.txt", [1, 4, 7, 9], "%d")
    np.savetxt(root / "upper.txt", [20, 21], "%d")
    (root / "pairs.json").write_text("[[1, 7], [4, 9]]")
    given = ["evaluate", "--masks", root / "lips.txt", root / "upper.txt", "--metrics", "all"]
    given += ["--lip-pairs", root / "pairs.json", "--resamples", 50, "--out", out, *arguments]
    status = main([str(part) for part in given])
    return json.loads(out.read_text()) if status == 0 else {"status": status}


def values(report: dict[str, Any], system: str) -> dict[str, float]:
    rows = report["metrics"]
    return {r["metric"]: r["systems"][system]["mean"] for r in rows if system in r["systems"]}


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("kind", FORMATS)
def test_anything_scores_perfectly_against_itself(kind: str, unit: str, tmp_path: Path) -> None:
    for fps in (24.0, 60.0):
        folder = write(tmp_path / f"{fps}", kind, UNITS[unit], fps)
        stated = kind in ("measured.npz", "animation.npz"), kind in ("rated.npz", "animation.npz")
        given = [] if stated[0] else ["--unit", unit]
        given += [] if stated[1] else ["--fps", fps]
        report = report_of(tmp_path, "--pred", f"own={folder}", "--gt", folder, *given)
        found = values(report, "own")
        assert {"lve", "mve_mean", "dtw", "delta_m"} <= set(found)
        assert report["ground_truth"]["fps"] == fps
        for metric, value in found.items():
            if metric != "jerk_energy":  # of the prediction alone
                # Both sides are the same floats; sums in float64 leave nothing but a cosine's rounding.
                assert value == pytest.approx(IDEALS.get(metric, 0.0), abs=1e-9), metric


@pytest.mark.usefixtures("own_cache")
@pytest.mark.parametrize("name", ["biwi", "multiface"])
def test_a_dataset_scores_perfectly_against_its_own_files(name: str, tmp_path: Path) -> None:
    directory = write_scantalk(tmp_path / name, name, frames=30)
    (tmp_path / "pred").mkdir()
    data = packed(directory, name="own")
    for sequence in open_dataset(data).sequences("test"):
        path = next(directory.rglob(f"{sequence.id}.npy"))
        np.save(tmp_path / "pred" / path.name, np.load(path)[: sequence.num_frames])
    out = tmp_path / "scores.json"
    given = [
        "evaluate",
        "--pred",
        tmp_path / "pred",
        "--gt",
        f"GT:scantalk={data}",
        "--resamples",
        50,
    ]
    assert main([str(part) for part in [*given, "--out", out, "--metrics", "paper"]]) == 0
    found = values(json.loads(out.read_text()), "pred")
    # Packed vertices are float16, so within half a unit of the last of 11 digits of 6 mm.
    assert all(value == pytest.approx(0, abs=3e-3) for value in found.values())


def test_units_of_both_sides_are_their_own(tmp_path: Path) -> None:
    truth = write(tmp_path / "truth", "animation.npz", 0.1, 30.0)
    pred = write(tmp_path / "pred", "animation.npz", 0.001, 30.0)
    found = values(report_of(tmp_path, "--pred", pred, "--gt", truth), "pred")
    # Displacements of 3 mm, stored as 0.03 and as 3 in float32: seven digits of 3 mm.
    assert found["lve_l2"] == pytest.approx(0, abs=1e-5)
    plain = write(tmp_path / "plain", "batch.npy", 0.01, 30.0)
    found = values(
        report_of(tmp_path, "--pred", plain, "--gt", truth, "--pred-unit", "cm"), "plain"
    )
    assert found["lve_l2"] == pytest.approx(0, abs=1e-5)


@pytest.mark.parametrize(
    ("kind", "scale", "fps", "more", "message"),
    [
        ("animation.npz", 0.1, 25.0, [], "has 25 fps, the ground truth 30"),
        ("animation.npz", 0.1, 30.0, ["--pred-unit", "mm"], "0.1, but --pred-unit says 0.001"),
        ("animation.npz", 0.1, 30.0, ["--unit", "mm"], "0.1, but --unit says 0.001"),
        ("animation.npz", 0.1, 30.0, ["--fps", "25"], "30, but --fps says 25"),
        ("batch.npy", 0.1, 30.0, [], "states no unit: give --pred-unit"),
    ],
)
def test_what_contradicts_or_is_not_known_stops(
    kind: str,
    scale: float,
    fps: float,
    more: list[str],
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    truth = write(tmp_path / "truth", "animation.npz", 0.1, 30.0)
    pred = write(tmp_path / "pred", kind, scale, fps)
    assert report_of(tmp_path, "--pred", pred, "--gt", truth, *more) == {"status": 2}
    assert message in capsys.readouterr().err


def test_ground_truth_without_unit_or_with_two_rates_stops(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain = write(tmp_path / "plain", "frames.npy", 1.0, 30.0)
    assert report_of(tmp_path, "--pred", plain, "--gt", plain) == {"status": 2}
    assert "states no unit: give --unit" in capsys.readouterr().err
    mixed = write(tmp_path / "mixed", "animation.npz", 0.1, 30.0)
    write_animation(mixed / "F1_e3.npz", motion("F1_e3"), 0.1, 25.0)
    assert report_of(tmp_path, "--pred", mixed, "--gt", mixed) == {"status": 2}
    assert "another fps" in capsys.readouterr().err


def test_metrics_of_time_are_left_out_where_no_rate_is_known(tmp_path: Path) -> None:
    plain = write(tmp_path / "plain", "batch.npy", 1.0, 30.0)
    report = report_of(tmp_path, "--pred", f"own={plain}", "--gt", plain, "--unit", "m")
    assert "jerk_energy" not in values(report, "own") and report["ground_truth"]["fps"] is None
    assert "jerk_energy left out: it needs the frame rate (--fps)" in report["notes"]


def test_a_system_is_cut_by_its_own_length_alone(tmp_path: Path) -> None:
    truth = write(tmp_path / "truth", "batch.npy", 1.0, 30.0)
    noisy, short = tmp_path / "noisy", tmp_path / "short"
    for folder in (noisy, short):
        folder.mkdir()
    for name in NAMES:
        moved = motion(name)
        moved[-2:] += 0.01  # wrong at the end alone, which the short system does not reach
        np.save(noisy / f"{name}.npy", moved)
        np.save(short / f"{name}.npy", motion(name)[:-2])
    given = ["--gt", truth, "--unit", "m", "--pred"]
    alone = values(report_of(tmp_path, *given, noisy), "noisy")
    both = report_of(tmp_path, *given, noisy, short)
    assert values(both, "noisy") == alone and alone["lve"] > 1
    assert values(both, "short")["lve"] == 0
    frames = {system["name"]: system["frames"] for system in both["systems"]}
    assert frames == {"noisy": 80, "short": 76}


def test_another_clip_of_the_same_name_stops(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = write(tmp_path / "truth", "batch.npy", 1.0, 30.0)
    half = write(tmp_path / "half", "batch.npy", 1.0, 30.0, frames=20)
    assert report_of(tmp_path, "--pred", half, "--gt", truth, "--unit", "m") == {"status": 2}
    assert "has 20 frames, the ground truth 40" in capsys.readouterr().err


def test_the_axis_to_the_top_is_the_files(tmp_path: Path) -> None:
    """Lips of a head with z up open along z; a y-up reader would see them move sideways."""
    turn = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # z up to y up
    for folder in ("upright", "lying"):
        (tmp_path / folder).mkdir()
    for name in NAMES:
        moved, noisy = motion(name), motion(name) + 0.5 * motion(f"{name}x")
        for folder, frames in (("upright", moved), ("lying", noisy)):
            triangles = np.arange(VERTICES).reshape(-1, 3)
            mesh = freetalk.Mesh(face() @ turn, triangles)
            animation = freetalk.Animation(mesh, frames @ turn, fps=30.0, to_y_up=turn)
            animation.save(tmp_path / folder / f"{name}.npz")
    for folder in ("upright y", "lying y"):
        (tmp_path / folder).mkdir()
    for name in NAMES:
        np.save(tmp_path / "upright y" / f"{name}.npy", motion(name))
        np.save(tmp_path / "lying y" / f"{name}.npy", motion(name) + 0.5 * motion(f"{name}x"))
    z_up = report_of(tmp_path, "--pred", tmp_path / "lying", "--gt", tmp_path / "upright")
    given = ["--unit", "m", "--fps", 30]
    y_up = report_of(
        tmp_path, "--pred", f"lying={tmp_path / 'lying y'}", "--gt", tmp_path / "upright y", *given
    )
    # The same motion in other axes: float32 both times.
    expected = values(y_up, "lying")["lip_correlation"]
    assert values(z_up, "lying")["lip_correlation"] == pytest.approx(expected, abs=1e-5)
    assert expected < 0.99
