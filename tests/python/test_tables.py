"""The papers' tables: parts of datasets, rows that go on where they were stopped, verdicts, files."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from dataset_layouts import packed, write_folder
from mini_corpus import write_mini_corpus

from freetalk.corpus.topologies import TOPOLOGIES
from freetalk.data import open_dataset
from freetalk.data.resampling import resample_frames
from freetalk.evaluate.motion_files import Origin
from freetalk.stm import Stm
from freetalk.tables import main
from freetalk.tables.claims import HELD, OPPOSITE, UNDECIDED, Claim, judge
from freetalk.tables.definitions import TABLES, Recipes
from freetalk.tables.papers import DATASETS
from freetalk.tables.report import make_result, markdown
from freetalk.tables.scoring import lip_edges, roughness
from freetalk.tables.sets import FULL_FAMILIES, OPEN_SETS, SMALL_FAMILIES, Catalogue, parse_sets
from freetalk.tables.sizes import SIZES, TINY
from freetalk.tables.table import TableRun, merged
from freetalk.tables.views import ViewOptions, faces_of, view_of
from freetalk.train.checkpoint import git_commit
from freetalk.train.stm_meshes import prepare_mesh

pytestmark = pytest.mark.usefixtures("own_cache")


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_mini_corpus(tmp_path_factory.mktemp("tables") / "corpus")


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings at 25 fps on a template of their own, with masks."""
    folder = write_folder(tmp_path_factory.mktemp("own") / "own", frames=50, fps=25)
    (folder / "lip_mask.json").write_text(json.dumps(list(range(20, 40))))
    (folder / "upper_mask.json").write_text(json.dumps(list(range(60, 90))))
    return packed(folder)


def neutral_sets(corpus: Path) -> list[str]:
    return [f"--data={name}={corpus}" for name in ("VOCASET", "BIWI", "Multiface")]


# views


def test_a_view_at_another_rate_is_the_motion_resampled(corpus: Path, own: Path) -> None:
    for folder, fps in ((corpus, 30.0), (own, 25.0)):
        base = open_dataset(folder)
        view = view_of(base, "part", ViewOptions(fps=10.0, clip_frames=8))
        first, second = view.sequences("train")[:2]
        whole = next(s for s in base.sequences("train") if first.id == f"{s.id}-0")
        expected = resample_frames(base.landmarks(whole), fps, 10.0)
        np.testing.assert_array_equal(view.landmarks(first), expected[:8])
        np.testing.assert_array_equal(view.landmarks(second, 1, 4), expected[9:12])
        topology = str(second.topology or view.topologies("train")[0])
        moved = resample_frames(base.vertex_displacements(topology, whole), fps, 10.0)
        # Factors are resampled before they are multiplied: float32 sums in another order.
        found = view.vertex_displacements(topology, second, 1, 4)
        np.testing.assert_allclose(found, moved[9:12], atol=1e-7)


def test_clips_cover_a_sequence_with_its_sound(corpus: Path) -> None:
    base = open_dataset(corpus)
    view = view_of(base, "part", ViewOptions(clip_frames=30, min_frames=10))
    whole = base.sequences("train", ["facegood"])[0]  # 75 frames: 30, 30, 15
    clips = [s for s in view.sequences("train") if s.id.startswith(whole.id)]
    assert [c.num_frames for c in clips] == [30, 30, 15]
    joined = np.concatenate([view.landmarks(c) for c in clips])
    np.testing.assert_array_equal(joined, base.landmarks(whole))
    sound = np.concatenate([view.audio(c) for c in clips])
    np.testing.assert_array_equal(sound, base.audio(whole)[: len(sound)])
    assert len(view.audio(clips[0])) == 16000


def test_a_view_takes_every_other_sequence_of_training_and_test(corpus: Path) -> None:
    options = ViewOptions(fps=10.0, clip_frames=10, every=2, limits={"test": 3})
    base = open_dataset(corpus)
    view = view_of(base, "part", options)
    whole = view_of(base, "part", ViewOptions(fps=10.0, clip_frames=10))
    for split, step in (("train", 2), ("val", 1)):
        takes = [s.id for s in base.sequences(split)][::step]
        expected = [s.id for s in whole.sequences(split) if s.name in takes]
        assert [s.id for s in view.sequences(split)] == expected
    assert {s.name for s in view.sequences("test")} <= {s.id for s in base.sequences("test")[::2]}
    assert len(view.sequences("test")) == 3
    assert view.fingerprint != whole.fingerprint


def test_counterparts_of_neutral_sets_share_no_sequence() -> None:
    families = [*SMALL_FAMILIES.values(), *FULL_FAMILIES.values()]
    known = {spec.name for spec in TOPOLOGIES}
    for family in families:
        names = [name for split in ("train", "val", "test") for name in family[split]]
        assert len(set(names)) == len(names), "a meshing is in two splits"
        assert set(names) <= known
        assert len(family["test"]) == 1  # predictions of others are on one meshing
    for voice in ("espeak:en-us+f4", "espeak:en+m1", "flite:slt"):
        owners = [n for n in ("BIWI", "Multiface") if voice.startswith(OPEN_SETS[n].voices)]
        assert len(owners) == 1


def test_settings_are_numbers_of_datasets() -> None:
    assert parse_sets("1, 3") == (DATASETS[1], DATASETS[3])
    with pytest.raises(ValueError, match="6"):
        parse_sets("2,6")


# scores


def test_a_shift_is_not_rough_and_a_zigzag_is() -> None:
    faces = np.array([[0, 1, 2], [1, 3, 2]])
    edges = lip_edges(faces, np.array([True, True, True, False]))
    assert edges.tolist() == [[0, 1], [0, 2], [1, 2]]
    true = torch.zeros(2, 4, 3)
    assert roughness(true + 0.01, true, edges) == 0
    zigzag = true.clone()
    zigzag[:, 0, 1] = 0.001  # 1 mm on two of three edges
    assert roughness(zigzag, true, edges) == pytest.approx(2 / 3, rel=1e-6)


# claims


def scored(**means: float) -> dict[str, dict[str, object]]:
    """Rows of 30 clips, three alike trainings each, with a spread of their own that all rows share."""
    rng = np.random.default_rng(0)
    level, noise = rng.uniform(0.5, 1.5, 30), rng.normal(0, 0.02, (len(means), 30))
    return {name: seeded(mean * level + own) for (name, mean), own in zip(means.items(), noise)}


def seeded(*runs: np.ndarray, origins: dict[str, Origin] | None = None) -> dict[str, object]:
    """A row of runs with these values of their clips; of a single one, three times the same."""
    scores = [
        {
            "values": {"lve": {str(i): float(value) for i, value in enumerate(values)}},
            "frames": {str(i): 20 + i for i in range(len(values))},
            "origins": origins or {},
        }
        for values in (runs if len(runs) > 1 else 3 * runs)
    ]
    return merged("", [{"scores": {"SET": own}, "trainings": []} for own in scores])


def verdict(claim: Claim, rows: dict[str, dict[str, object]]) -> str:
    (found,) = judge([claim], rows)
    return found.outcome


def test_an_order_holds_is_refuted_or_stays_open() -> None:
    rows = scored(low=1.0, high=1.1, same=1.0005)
    assert verdict(Claim("", "", ("low",), ("high",)), rows) == HELD
    assert verdict(Claim("", "", ("high",), ("low",)), rows) == OPPOSITE
    assert verdict(Claim("", "", ("low",), ("same",)), rows) == UNDECIDED


def test_a_claim_of_likeness_asks_for_the_whole_interval() -> None:
    rows = scored(low=1.0, near=1.03, far=1.5)
    assert verdict(Claim("", "", ("near",), ("low",), margin=0.1), rows) == HELD
    assert verdict(Claim("", "", ("far",), ("low",), margin=0.1), rows) == OPPOSITE
    assert verdict(Claim("", "", ("near",), ("low",), margin=0.03), rows) == UNDECIDED


def test_what_seeds_change_widens_the_interval() -> None:
    rows = scored(a=0.9, b=1.0, c=1.1, high=1.1)
    trainings = [row["runs"][0] for name, row in rows.items() if name != "high"]
    several = {"low": merged("low", trainings), "high": rows["high"]}
    alike = {"low": merged("low", 3 * [several["low"]]), "high": rows["high"]}
    claim = Claim("", "", ("low",), ("high",))
    (alone,), (widened,) = judge([claim], alike), judge([claim], several)
    assert alone.outcome == HELD and alone.p_value < 0.001
    assert widened.outcome == UNDECIDED and widened.p_value > 0.05
    assert alone.difference == widened.difference == pytest.approx(-0.09, abs=0.01)
    # Means of 0.9, 1.0, 1.1 and three times the same: pooled over four degrees of freedom.
    assert widened.seed_spread == pytest.approx(0.1 / np.sqrt(2), rel=0.05)
    # Student's t at 97.5 % for 4 degrees, three runs of each row; 10,000 draws give two digits.
    extra = 2.776 * widened.seed_spread * np.sqrt(1 / 3 + 1 / 3)
    expected = np.hypot(alone.high - alone.difference, extra)
    assert widened.high - widened.difference == pytest.approx(expected, rel=0.05)


def test_fewer_than_three_trainings_decide_nothing() -> None:
    rows = scored(low=1.0, high=1.5)
    two = {name: {**row, "runs": row["runs"][:2]} for name, row in rows.items()}
    claim = Claim("", "", ("low",), ("high",))
    (found,) = judge([claim], {**rows, "low": two["low"]})
    assert found.high < 0 and found.outcome == UNDECIDED and found.seeds == 2
    assert verdict(claim, rows) == HELD


def test_intervals_and_p_values_agree() -> None:
    """A claim's interval leaves 0 out exactly where its own p-value is below 5 %."""
    rng = np.random.default_rng(5)
    decided = 0
    for number in range(40):
        shift, level = rng.uniform(-0.06, 0.06), rng.uniform(0.5, 1.5, 12)
        low = [level + shift + rng.normal(0, 0.05, 12) for _ in range(3)]
        rows = {"low": seeded(*low), "high": seeded(level)}
        (found,) = judge([Claim("", "", ("low",), ("high",))], rows, seed=number)
        outside = found.high < 0 or found.low > 0
        # Of 10,000 draws the quantiles lie between two, so one draw may fall either way.
        if abs(found.p_value - 0.05) > 5e-4:
            assert outside == (found.p_value < 0.05)
        decided += outside
    assert 5 < decided < 35  # both kinds were seen


def test_a_claim_among_many_asks_for_more() -> None:
    """A claim whose own p-value is near 0.03 holds alone, and is open where it is one of two such."""
    rng = np.random.default_rng(3)
    level, claim = np.ones(30), Claim("", "", ("low",), ("high",))
    for shift in np.linspace(0.0, 0.1, 51):
        rows = {"low": seeded(level - shift + rng.normal(0, 0.1, 30)), "high": seeded(level)}
        (alone,) = judge([claim], rows)
        if 0.026 < alone.p_value < 0.049:
            break
    assert alone.outcome == HELD and alone.high < 0
    both = judge([claim, claim], rows)
    assert [one.p_value for one in both] == pytest.approx([2 * alone.p_value] * 2)
    assert [one.outcome for one in both] == [UNDECIDED] * 2


def test_clips_of_one_take_are_one_observation() -> None:
    rng = np.random.default_rng(2)
    takes, own = rng.normal(-0.05, 0.1, 8), 25
    low = 1 + np.repeat(takes, own) + rng.normal(0, 0.01, 8 * own)
    claim = Claim("", "", ("low",), ("high",))

    def spread(origins: dict[str, Origin] | None) -> tuple[float, tuple[str, int]]:
        rows = {"low": seeded(low, origins=origins), "high": seeded(np.ones(8 * own))}
        (found,) = judge([claim], rows)
        return found.high - found.low, found.drawn

    alone, drawn = spread(None)
    assert drawn == ("takes", 200)  # nothing is known of them
    origins = {str(i): Origin("one", str(i // own)) for i in range(8 * own)}
    together, drawn = spread(origins)
    assert drawn == ("takes", 8)
    # The mean of 8 takes varies sqrt(25) times as much as that of 200 clips; clips weigh by their frames.
    assert 3.5 < together / alone < 6.5
    speakers = {str(i): Origin(str(i // own // 2), str(i)) for i in range(8 * own)}
    assert spread(speakers)[1] == ("takes", 200)  # four speakers stand for no others
    many = {str(i): Origin(str(i // own), str(i)) for i in range(8 * own)}
    assert spread(many)[1] == ("speakers", 8)


def test_one_take_has_no_interval() -> None:
    origins = {str(i): Origin("one", "same") for i in range(30)}
    rows = {"low": seeded(np.ones(30), origins=origins), "high": seeded(2 * np.ones(30))}
    (found,) = judge([Claim("", "", ("low",), ("high",))], rows)
    assert np.isnan(found.low) and found.outcome == UNDECIDED and found.p_value == 1
    assert found.to_dict()["low"] is None


def test_several_rows_count_by_their_mean_and_missing_ones_are_passed_over() -> None:
    rows = scored(a=1.0, b=1.2, c=1.3)
    (found,) = judge([Claim("", "", ("a", "b"), ("c",)), Claim("", "", ("a",), ("lost",))], rows)
    assert found.difference == pytest.approx(1.1 / 1.3 - 1, abs=0.01)


# rows


def test_a_killed_table_goes_on_after_its_last_row(corpus: Path, tmp_path: Path) -> None:
    arguments = ["--size=tiny", f"--work={tmp_path / 'work'}", f"--out={tmp_path / 'out'}"]
    arguments += neutral_sets(corpus)
    rows = tmp_path / "work/tiny/rows/supp_2"
    script = Path(__file__).parents[2] / "scripts/table_supp_2.py"
    child = subprocess.Popen(
        [sys.executable, str(script), *arguments],
        stderr=subprocess.DEVNULL,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    while not list(rows.glob("concat-*.json")) and child.poll() is None:
        time.sleep(0.05)
    child.send_signal(signal.SIGKILL)
    child.wait()
    (first,) = rows.glob("concat-*.json")
    written = first.stat().st_mtime_ns
    assert main("supp_2", arguments) == 0
    assert first.stat().st_mtime_ns == written
    result = json.loads((tmp_path / "out/supp_2.json").read_text())
    names = [row["name"] for row in result["rows"]]
    assert names == ["concat", "ca", "ca_concat", "gcn_ca_concat", "still face"]
    assert (tmp_path / "out/supp_2.png").read_bytes().startswith(b"\x89PNG")

    # Another table's row of the same training is not trained again; other steps are another training.
    trainings = tmp_path / "work/tiny/trainings"
    count = len(list(trainings.iterdir()))
    row = ["--rows", "diffusionnet + diffusionnet"]
    assert main("supp_1", [*arguments, *row]) == 0
    assert len(list(trainings.iterdir())) == count
    assert main("supp_1", [*arguments, *row, "--", "stm.loop.max_steps=1"]) == 0
    assert len(list(trainings.iterdir())) == count + 1


def test_a_row_scores_what_its_weights_give(corpus: Path, tmp_path: Path) -> None:
    catalogue = Catalogue([f"{n}={corpus}" for n in ("VOCASET", "BIWI", "Multiface")], {})
    table = TABLES["supp_2"](Recipes(TINY, 0), ())
    (both,) = TableRun(table, catalogue, tmp_path).rows(["gcn_ca_concat"], seeds=[0, 1])
    row, other = both["runs"]
    assert [run["trainings"][0]["seed"] for run in both["runs"]] == [0, 1]
    directory = tmp_path / "trainings" / f"stm-{row['trainings'][0]['key']}" / "stm"
    stm = Stm.from_pretrained(directory).eval()
    view = catalogue.view("BIWI", table.view)
    clip, identity, topology = faces_of(view, "test")[1]
    options = stm.options
    face = prepare_mesh(view, identity, topology, options.length_scale, options.k_eig)
    landmarks = torch.from_numpy(view.landmarks(clip))
    with torch.no_grad():
        guess = stm(face.positions, face.operators, landmarks).numpy()
    error = np.square(guess - view.vertex_displacements(topology, clip)).sum(axis=-1)
    lips = view.mesh(identity, topology).lip_mask
    expected = 1e6 * error[:, lips].max(axis=1).mean()
    # The table decodes with the fast decoder: sums in another order.
    values = [one["scores"]["BIWI"]["values"]["lve"][clip.id] for one in (row, other, both)]
    assert values[0] == pytest.approx(expected, rel=1e-3)
    assert values[1] != values[0]
    assert values[2] == pytest.approx((values[0] + values[1]) / 2)


def test_speech_moves_meshes_of_mixed_datasets(corpus: Path, own: Path, tmp_path: Path) -> None:
    arguments = ["--size=tiny", f"--work={tmp_path / 'work'}", f"--out={tmp_path / 'out'}"]
    arguments += [f"--data=MEAD-EMOTE={own}", f"--data=VOCASET={corpus}"]
    # Another system that predicts the truth.
    view = Catalogue([f"MEAD-EMOTE={own}"], {}).view("MEAD-EMOTE", TINY.ats)
    (tmp_path / "perfect").mkdir()
    for clip, _, topology in faces_of(view, "test"):
        motion = view.vertex_displacements(topology, clip)
        np.savez(tmp_path / "perfect" / f"{clip.id}.npz", displacements=motion)
    arguments += [f"--pred=Perfect={tmp_path / 'perfect'}", "--settings", "2+2,3", "2+2"]
    assert main("table_2", arguments) == 0
    result = json.loads((tmp_path / "out/table_2.json").read_text())
    scores = {row["name"]: row["scores"]["MEAD-EMOTE"] for row in result["rows"]}
    assert list(scores) == ["2 + 2,3", "2 + 2", "still face", "Perfect"]
    assert scores["Perfect"]["lve"]["mean"] == 0
    assert all(scores[name]["lve"]["mean"] > 0 for name in scores if name != "Perfect")
    own_row = next(row for row in result["rows"] if row["name"] == "2 + 2")
    assert [one["kind"] for one in own_row["runs"][0]["trainings"]] == ["stm", "ats"]
    assert own_row["paper"]["MEAD-EMOTE"]["lve"] == 13.8
    # Every number carries where it comes from: commit, data, and options of what was trained.
    commit, mark = git_commit(), {"MEAD-EMOTE": view.fingerprint}
    for row in result["rows"]:
        assert (row["runs"][0]["commit"], row["runs"][0]["fingerprints"]) == (commit, mark)
    stm = own_row["runs"][0]["trainings"][0]
    assert stm["commit"] == commit and stm["seed"] == 0 and "loop.seed=0" in stm["overrides"]
    trained = Catalogue([f"MEAD-EMOTE={own}"], {}).view("MEAD-EMOTE", TINY.stm)
    assert stm["data_fingerprint"] == trained.fingerprint


def test_the_report_says_what_was_run_and_ends_with_the_claims(corpus: Path) -> None:
    catalogue = Catalogue([str(corpus)], SMALL_FAMILIES)
    table = TABLES["supp_2"](Recipes(SIZES["small"], 3), ())
    rows = scored(concat=4.0, ca=3.0, ca_concat=2.0, gcn_ca_concat=2.001)
    listed = [{**row, "name": name} for name, row in rows.items()]
    result = make_result(table, listed, SIZES["small"], catalogue, "python x.py", 3)
    text = markdown(result)
    assert "Different data" in text
    assert "`python x.py`" in text
    assert "seeds 3" in text
    assert "paper's LVE (other data)" in text
    assert "0.0025" in next(line for line in text.splitlines() if line.startswith("| ca "))
    assert "LVE here: ca_concat < gcn_ca_concat < ca < concat." in text
    assert "In the paper: gcn_ca_concat < ca_concat < ca < concat." in text
    ending = text[text.index("## Claims of the paper") :]
    assert "| ca_concat beats ca (LVE) | supp. Table 2: 0.0023 and 0.0025 | **held** |" in ending
    assert (
        "| gcn_ca_concat beats ca_concat (LVE) | supp. Table 2: 0.0021 and 0.0023 | **not decided"
        in ending
    )
    json.dumps(result)  # nothing in it that JSON does not know


def test_what_a_table_lacks_is_named(corpus: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"FLAME.*EmoVOCA"):
        Catalogue([f"FLAME={corpus}"], {})
    with pytest.raises(ValueError, match="EmoVOCA=DIR"):
        Catalogue([f"BIWI={corpus}"], {}).view("EmoVOCA", ViewOptions())
    with pytest.raises(ValueError, match=r"KIND\.section"):
        Recipes(TINY, 0, ["loop.max_steps=3"])
    unmasked = packed(write_folder(tmp_path / "own", frames=20, fps=25))
    with pytest.raises(ValueError, match="MEAD-EMOTE has no mask of the lips and the upper"):
        main("table_2", ["--size=tiny", f"--data=MEAD-EMOTE={unmasked}", "--settings", "2+2"])
    with pytest.raises(ValueError, match="sideways"):
        main("supp_2", ["--size=tiny", *neutral_sets(corpus), "--rows", "sideways"])


def test_a_clip_at_another_rate_is_the_same_moment(corpus: Path) -> None:
    view = view_of(open_dataset(corpus), "part", ViewOptions(clip_frames=23, min_frames=8))
    clip = next(s for s in view.sequences("train") if s.offset == 23 and s.has_sound)
    (slower,) = view.select([clip]).at(24.0).sequences()
    assert slower.offset == 19 and slower.num_frames == 18  # ceil(18.4) ... floor(36)
    base = open_dataset(corpus)
    take = next(s for s in base.sequences() if s.id == clip.name)
    whole = resample_frames(base.landmarks(take), clip.fps, slower.fps)
    found = view.at(24.0).landmarks(slower)
    np.testing.assert_allclose(found, whole[19:37], atol=1e-6)
    skipped = round((19 / 24 - 23 / 30) * 16000)
    assert slower.first_sample == clip.first_sample + skipped
    np.testing.assert_array_equal(view.audio(slower), view.audio(clip)[skipped:])
