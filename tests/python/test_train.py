"""Training: the loss is the paper's, a run that stops goes on as if it had not, mistakes are named."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from mini_corpus import write_mini_corpus

from freetalk.ats import Ats
from freetalk.data import open_dataset
from freetalk.speech import SpeechEncoder
from freetalk.stm import Stm
from freetalk.train import load_config, loop, motion_loss, run
from freetalk.train.augment import augment_wave, change_speed
from freetalk.train.checkpoint import find_checkpoint, load_state
from freetalk.train.draws import Draws
from freetalk.train.losses import closure_error
from freetalk.train.sequences import SequenceSampler
from freetalk.train.speech_targets import SpeechTargets, log_mel
from freetalk.train.stm_meshes import Placement, random_placement

CONFIGS = Path(__file__).parents[2] / "configs"
# Enough to be quick on any machine, and a fixed sum order.
QUICK = ["loop.threads=1", "loop.device=cpu"]


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_mini_corpus(tmp_path_factory.mktemp("train") / "corpus")


@pytest.fixture(autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FREETALK_CACHE", str(tmp_path_factory.getbasetemp() / "operators"))


@pytest.fixture(scope="module")
def speech(corpus: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("speech")
    run("speech", CONFIGS / "speech_smoke.yaml", [*QUICK, "loop.max_steps=2"], corpus, out)
    return out / "speech"


def weights(directory: Path, group: str = "model") -> dict[str, torch.Tensor]:
    from freetalk import _native

    return dict(_native.core.load_safetensors(str(directory / f"{group}.safetensors")))


# Eq. 15-16


def test_motion_loss_of_a_known_motion() -> None:
    # One point whose error is e_t = t^2 along x: velocities 1, 3, 5, accelerations 2, 2.
    target = torch.zeros(1, 4, 1, 3)
    prediction = target.clone()
    prediction[0, :, 0, 0] = torch.tensor([0.0, 1.0, 4.0, 9.0])
    terms = motion_loss(prediction, target, None, 0.5, 0.2)
    assert terms["position"].item() == pytest.approx((0 + 1 + 16 + 81) / 4)
    assert terms["velocity"].item() == pytest.approx((1 + 9 + 25) / 3)
    assert terms["acceleration"].item() == pytest.approx(4.0)
    assert terms["loss"].item() == pytest.approx(98 / 4 + 0.5 * 35 / 3 + 0.2 * 4)


def test_motion_loss_is_three_times_the_mean_square() -> None:
    prediction, target = torch.randn(2, 5, 7, 3), torch.randn(2, 5, 7, 3)
    expected = 3 * torch.nn.functional.mse_loss(prediction, target)
    assert motion_loss(prediction, target)["loss"].item() == pytest.approx(
        expected.item(), rel=1e-5
    )


def test_motion_loss_ignores_padding() -> None:
    prediction, target = torch.randn(1, 6, 4, 3), torch.randn(1, 6, 4, 3)
    padded = [torch.cat([x, 100 * torch.randn(1, 3, 4, 3)], dim=1) for x in (prediction, target)]
    valid = torch.arange(9)[None] < 6
    short = motion_loss(prediction, target, None, 0.3, 0.1)
    long = motion_loss(*padded, valid, 0.3, 0.1)
    for name, value in short.items():
        assert long[name].item() == pytest.approx(value.item(), rel=1e-5)


def test_motion_loss_weights_points() -> None:
    prediction, target = torch.zeros(1, 3, 2, 3), torch.zeros(1, 3, 2, 3)
    prediction[:, :, 1, 0] = 1.0
    weighted = motion_loss(prediction, target, point_weights=torch.tensor([0.5, 1.5]))
    assert weighted["loss"].item() == pytest.approx(0.75)


# Configuration


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.yaml")), ids=lambda p: p.stem)
def test_shipped_configurations_are_valid(path: Path) -> None:
    from freetalk.ats import AtsOptions
    from freetalk.facetalk import FaceTalkOptions
    from freetalk.head import HeadOptions
    from freetalk.speech import SpeechEncoderOptions
    from freetalk.stm import StmOptions

    options = {
        "ats": AtsOptions,
        "stm": StmOptions,
        "speech": SpeechEncoderOptions,
        "facetalk": FaceTalkOptions,
        "head": HeadOptions,
    }
    (kind,) = set(path.stem.split("_")) & set(options)  # ats_small, table_stm
    options[kind].from_dict(load_config(kind, path).model)


def test_overrides_win_and_unknown_keys_name_the_nearest() -> None:
    path = CONFIGS / "ats_smoke.yaml"
    assert load_config("ats", path, ["loop.batch_size=7"]).loop.batch_size == 7
    with pytest.raises(ValueError, match=r"unknown option 'bach_size'; did you mean 'batch_size'"):
        load_config("ats", path, ["loop.bach_size=7"])
    with pytest.raises(ValueError, match=r"task\.lip_weight = 'much' is no float"):
        load_config("ats", path, ["task.lip_weight=much"])
    with pytest.raises(
        ValueError, match=r"lr_schedule must be one of cosine, cosine_minutes, constant"
    ):
        load_config("ats", path, ["loop.lr_schedule=step"])
    for kind in ("ats", "facetalk"):
        for name, value in (("blend", 2), ("audio_dropout", -1), ("step_power", 0)):
            with pytest.raises(ValueError, match=rf"task\.{name} must be .*, got {value}"):
                load_config(kind, CONFIGS / f"{kind}_smoke.yaml", [f"task.{name}={value}"])
    with pytest.raises(ValueError, match=r"unknown training 'xyz'; known: ats, stm, speech"):
        load_config("xyz", path)
    with pytest.raises(FileNotFoundError, match=r"nowhere\.yaml"):
        load_config("ats", "nowhere.yaml")


def test_model_options_are_checked_by_the_model(corpus: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="encoder_width"):
        run("stm", CONFIGS / "stm_smoke.yaml", ["model.encoder_widht=8"], corpus, tmp_path)


# Parts


def test_sampler_keeps_the_shares_of_the_sources(corpus: Path) -> None:
    sequences = open_dataset(corpus).sequences()
    sampler = SequenceSampler(sequences, {"facegood": 3.0, "rom": 1.0})
    rng = np.random.default_rng(0)
    drawn = [sampler.draw(rng).source for _ in range(4000)]
    # 4000 draws of probability 0.75: standard deviation 0.007.
    assert drawn.count("facegood") / len(drawn) == pytest.approx(0.75, abs=0.03)
    assert set(drawn) == {"facegood", "rom"}
    with pytest.raises(ValueError, match="no sequences of source 'video'"):
        SequenceSampler(sequences, {"video": 1.0})


def test_targets_are_those_of_the_time_asked_for(corpus: Path) -> None:
    data = open_dataset(corpus)
    sequence = data.sequences("train", ["synthetic"])[0]
    targets = SpeechTargets(data, [sequence])
    labels = [
        targets.phones[i] for i in targets.phones_at(sequence, np.array([0.1, 0.7, 1.2, 2.2]))
    ]
    assert labels == ["sil", "P", "AA", "sil"]
    curves, opening = targets.motion_at(sequence, np.array([10 / 30, 10.5 / 30, 11 / 30]))
    assert curves.shape == (3, targets.num_curves) and opening.shape == (3,)
    # Linear between frames.
    np.testing.assert_allclose(curves[1], (curves[0] + curves[2]) / 2, atol=1e-5)


def test_log_mel_peaks_at_the_band_and_the_time_of_a_tone() -> None:
    times = torch.arange(16000) / 16000
    wave = torch.where(times < 0.5, torch.zeros(()), torch.sin(2 * torch.pi * 1000 * times))
    energies = log_mel(wave[None], 48, 0.0125, 40)[0]
    assert energies.shape == (48, 40)
    bands = energies[30:].mean(dim=0)
    hertz = 700 * (10 ** (torch.linspace(31.7, 2840, 42)[1:-1] / 2595) - 1)
    # Band centres are at most 130 Hz apart near 1 kHz.
    assert abs(hertz[bands.argmax()] - 1000) < 130
    assert energies[35:].mean() > energies[:20].mean() + 1


def test_speed_changes_length_and_pitch_alike() -> None:
    wave = np.sin(2 * np.pi * 440 * np.arange(16000) / 16000).astype(np.float32)
    fast = change_speed(wave, 1.1)
    assert len(fast) == round(16000 / 1.1)
    spectrum = np.abs(np.fft.rfft(fast, 16000))
    assert abs(int(spectrum.argmax()) - 484) <= 1


def test_augmentation_is_finite_and_repeats(corpus: Path) -> None:
    wave = np.random.default_rng(0).normal(0, 0.1, 8000).astype(np.float32)
    for seed in range(20):
        once = augment_wave(wave, np.random.default_rng(seed), 16000)
        again = augment_wave(wave, np.random.default_rng(seed), 16000)
        assert once.shape == wave.shape and np.isfinite(once).all()
        np.testing.assert_array_equal(once, again)


def test_placement_moves_points_and_turns_displacements() -> None:
    rng = np.random.default_rng(3)
    placement = random_placement(rng, 5.0, 0.006, 0.06, torch.device("cpu"))
    assert isinstance(placement, Placement)
    eye = placement.rotation @ placement.rotation.T
    torch.testing.assert_close(eye, torch.eye(3), atol=1e-6, rtol=0)
    points, vectors = torch.randn(5, 3), torch.randn(5, 3)
    torch.testing.assert_close(
        placement.moved(points + vectors),
        placement.moved(points) + placement.turned(vectors),
        atol=1e-6,
        rtol=0,
    )


# Whole trainings


def test_speech_training_writes_an_encoder(speech: Path) -> None:
    encoder = SpeechEncoder.from_pretrained(speech)
    assert encoder(torch.randn(1, 16000)).shape[-1] == 32
    config = json.loads((speech / "config.json").read_text())
    assert config["model_type"] == "hubert"
    assert config["training"]["steps"] == 2
    assert "phones" not in " ".join(weights(speech))  # the heads stay behind


def test_ats_training_writes_weights(corpus: Path, speech: Path, tmp_path: Path) -> None:
    result = run(
        "ats",
        CONFIGS / "ats_smoke.yaml",
        [*QUICK, f"task.speech_encoder={speech}"],
        corpus,
        tmp_path,
    )
    assert result.status == "finished" and np.isfinite(result.scores["score"])
    model = Ats.from_pretrained(tmp_path / "ats")
    assert model.options.audio_dim == 32
    # Statistics must not be rounded to half precision.
    assert weights(tmp_path / "ats")["motion_scale"].dtype == torch.float32


def test_stm_training_lowers_the_error(corpus: Path, tmp_path: Path) -> None:
    result = run(
        "stm",
        CONFIGS / "stm_smoke.yaml",
        [*QUICK, "loop.max_steps=60", "loop.validate_every=0", "loop.learning_rate=0.005"],
        corpus,
        tmp_path,
    )
    # 1 is a face that stays still, and what the untrained network scores; 60 steps of
    # three seeds reach 0.46 to 0.53.
    assert result.scores["relative_error"] < 0.7
    Stm.from_pretrained(tmp_path / "stm")


@pytest.mark.parametrize("kind", ["ats", "stm", "speech"])
def test_a_stopped_run_ends_with_the_same_weights(
    kind: str, corpus: Path, speech: Path, tmp_path: Path
) -> None:
    common = [*QUICK, "loop.validate_every=0", "loop.keep=last"]
    if kind == "ats":
        common.append(f"task.speech_encoder={speech}")
    config = CONFIGS / f"{kind}_smoke.yaml"
    run(kind, config, [*common, "loop.max_steps=5"], corpus, tmp_path / "whole")
    run(kind, config, [*common, "loop.max_steps=2"], corpus, tmp_path / "parts")
    run(kind, config, [*common, "loop.max_steps=5"], corpus, tmp_path / "parts")
    whole, parts = (
        weights(tmp_path / name / "checkpoints" / kind / "step_0000005" / "state")
        for name in ("whole", "parts")
    )
    for name, value in whole.items():
        assert torch.equal(value, parts[name]), name


def test_another_model_does_not_continue_a_run(corpus: Path, tmp_path: Path) -> None:
    config = CONFIGS / "stm_smoke.yaml"
    run("stm", config, [*QUICK, "loop.max_steps=1"], corpus, tmp_path)
    with pytest.raises(ValueError, match=r"of another training \(model\.decoder_width 16 -> 8\)"):
        run("stm", config, [*QUICK, "model.decoder_width=8"], corpus, tmp_path)


def test_a_loss_that_is_not_finite_stops_with_the_batch_saved(
    corpus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from freetalk.train.stm import StmTask

    clean = StmTask.collate

    drawn = StmTask.item

    def numbered(self: StmTask, rng: np.random.Generator, number: int) -> dict[str, object]:
        return {**drawn(self, rng, number), "number": number}

    def poisoned(self: StmTask, items: list[Any]) -> dict[str, Any]:
        batch = clean(self, items)
        if items[0]["number"] == 2:  # of the second step
            batch["items"][0]["landmarks"][0, 0, 0] = float("nan")
        return batch

    monkeypatch.setattr(StmTask, "item", numbered)

    monkeypatch.setattr(StmTask, "collate", poisoned)
    # Terms are read every third step: the two steps after the first change nothing.
    options = [*QUICK, "loop.log_every=3", "loop.validate_every=0"]
    monkeypatch.setattr(loop.Trainer, "_agree", lambda self, seconds: (1e-3, False))
    with pytest.raises(RuntimeError, match=r"step 1 of stm is not finite.*failed_batch_stm\.pt"):
        run("stm", CONFIGS / "stm_smoke.yaml", options, corpus, tmp_path)
    found = find_checkpoint(tmp_path / "checkpoints" / "stm")
    assert found is not None and load_state(found)["step"] == 1
    one = [*QUICK, "loop.max_steps=1"]
    monkeypatch.setattr(StmTask, "collate", clean)
    run("stm", CONFIGS / "stm_smoke.yaml", one, corpus, tmp_path / "one")
    ours, theirs = (
        weights(out / "checkpoints" / "stm" / "step_0000001" / "state")
        for out in (tmp_path, tmp_path / "one")
    )
    assert all(torch.equal(value, theirs[name]) for name, value in ours.items())
    saved = torch.load(tmp_path / "failed_batch_stm.pt", weights_only=True)
    assert torch.isnan(saved["items"][0]["landmarks"]).any()


def test_an_interrupted_run_saves_and_says_how_to_go_on(
    corpus: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    import signal

    step = loop.Trainer._train_step

    def interrupted(self: loop.Trainer, draws: Draws) -> None:
        if self.step == 2:
            signal.raise_signal(signal.SIGINT)
        step(self, draws)

    monkeypatch.setattr(loop.Trainer, "_train_step", interrupted)
    options = [*QUICK, "loop.validate_every=0"]
    result = run("stm", CONFIGS / "stm_smoke.yaml", options, corpus, tmp_path)
    assert (result.status, result.step) == ("interrupted", 3)
    assert "the same command continues" in capsys.readouterr().err
    monkeypatch.setattr(loop.Trainer, "_train_step", step)
    assert run("stm", CONFIGS / "stm_smoke.yaml", options, corpus, tmp_path).step == 6


def test_ats_without_an_encoder_says_where_to_get_one(corpus: Path, tmp_path: Path) -> None:
    options = [*QUICK, f"task.speech_encoder={tmp_path / 'none'}"]
    with pytest.raises(FileNotFoundError, match="freetalk train speech"):
        run("ats", CONFIGS / "ats_smoke.yaml", options, corpus, tmp_path)


def test_closure_error_counts_lips_that_close_for_a_moment() -> None:
    wanted = torch.zeros(1, 60)
    wanted[0, 20:40] = 0.01  # speech between two pauses
    wanted[0, 30] = 0.0  # a p
    valid = torch.ones(1, 60, dtype=torch.bool)
    guess = wanted.clone()
    guess[0, 20:30], guess[0, :10], guess[0, 50:] = 0.005, 0.004, 0.004
    usual = float(wanted.square().mean().sqrt())
    # Open lips and long pauses do not count.
    assert float(closure_error(guess, wanted, valid, usual)) == 0
    guess = wanted.clone()
    guess[0, 30] = 0.003
    expected = (0.003 / usual - 0.09) ** 2 / 9  # nine frames are closed near open ones
    assert float(closure_error(guess, wanted, valid, usual)) == pytest.approx(expected)
    twice = float(closure_error(guess, wanted, valid, usual, torch.tensor(18.0)))
    assert twice == pytest.approx(expected / 2)  # over the frames of two such shards
    pressed = guess.clone()
    pressed[0, 30] = 0.08 * usual
    assert float(closure_error(pressed, wanted, valid, usual)) == 0  # closed enough
    valid[0, 30] = False
    assert float(closure_error(guess, wanted, valid, usual)) == 0
    still = torch.zeros(1, 60)
    assert torch.isfinite(closure_error(still + 0.001, still, valid, 0.0))
