"""What is wrong is told before the first step, what goes wrong later loses no steps, and a run stays itself."""

from __future__ import annotations

import json
import re
import shutil
import signal
from pathlib import Path
from typing import Any

import pytest
from dataset_layouts import write_folder
from mini_corpus import write_mini_corpus

from freetalk import Talker
from freetalk._pretrained import PRETRAINED
from freetalk.cli.app import main
from freetalk.cli.pack import untraceable
from freetalk.train import load_config, loop, run
from freetalk.train.assemble import assemble, encoder_record
from freetalk.train.checkpoint import find_checkpoint, git_commit, load_state
from freetalk.train.config import LoopOptions

CONFIGS = Path(__file__).parents[2] / "configs"
QUICK = ["loop.threads=1", "loop.device=cpu", "loop.validate_every=0", "loop.max_steps=4"]
STM = CONFIGS / "stm_smoke.yaml"


@pytest.fixture
def corpus(tmp_path: Path) -> Path:
    return write_mini_corpus(tmp_path / "corpus")


@pytest.fixture(autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FREETALK_CACHE", str(tmp_path_factory.getbasetemp() / "operators"))


@pytest.fixture
def no_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    def step(self: loop.Trainer, draws: object) -> None:
        raise AssertionError("a step was taken")

    monkeypatch.setattr(loop.Trainer, "_train_step", step)


def rewrite(corpus: Path, change: Any) -> None:
    path = corpus / "manifest.json"
    manifest = json.loads(path.read_text())
    change(manifest)
    path.write_text(json.dumps(manifest))


# Before the first step


@pytest.mark.usefixtures("no_steps")
@pytest.mark.parametrize("kind", ["ats", "stm", "speech"])
def test_an_empty_validation_split_is_told_first(kind: str, corpus: Path, tmp_path: Path) -> None:
    def move(manifest: dict[str, Any]) -> None:
        for entry in manifest["sequences"]:
            entry["split"] = ["train" if entry["split"] == ["val"] else entry["split"][0]]

    rewrite(corpus, move)
    with pytest.raises(ValueError, match=r"\bval\b"):
        run(kind, CONFIGS / f"{kind}_smoke.yaml", QUICK, corpus, tmp_path / "out")


@pytest.mark.usefixtures("no_steps")
def test_a_face_with_too_few_vertices_is_told_first(corpus: Path, tmp_path: Path) -> None:
    """The train split's meshings have 81 and 144 vertices."""
    with pytest.raises(ValueError, match=r"k_eig <= 81"):
        run("stm", STM, [*QUICK, "model.k_eig=100"], corpus, tmp_path / "out")


# After an error


def test_an_error_at_a_step_loses_none_before_it(
    corpus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = run("stm", STM, QUICK, corpus, tmp_path / "whole")
    step = loop.Trainer._train_step

    def failing(self: loop.Trainer, draws: Any) -> None:
        if self.step == 3:
            raise OSError("the disk is gone")
        step(self, draws)

    monkeypatch.setattr(loop.Trainer, "_train_step", failing)
    with pytest.raises(OSError, match="the disk is gone"):
        run("stm", STM, QUICK, corpus, tmp_path / "out")
    found = find_checkpoint(tmp_path / "out" / "checkpoints" / "stm")
    assert found is not None and load_state(found)["step"] == 3
    monkeypatch.setattr(loop.Trainer, "_train_step", step)
    assert run("stm", STM, QUICK, corpus, tmp_path / "out").scores == whole.scores


def test_checkpoints_are_on_by_default() -> None:
    assert 0 < LoopOptions().checkpoint_every <= 1000


# Going on


@pytest.mark.usefixtures("no_steps")
def test_other_data_or_another_task_does_not_go_on(
    corpus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.undo()  # one run of whole steps first
    monkeypatch.setenv("FREETALK_CACHE", str(tmp_path / "operators"))
    out = tmp_path / "out"
    run("stm", STM, QUICK, corpus, out)
    record = (out / "run_stm.json").read_bytes()
    other = write_mini_corpus(tmp_path / "other", seed=1)
    with pytest.raises(ValueError, match=r"of another training \(the data .*another --out"):
        run("stm", STM, QUICK, other, out)
    changed = [*QUICK, "task.lambda_velocity=0.7"]
    with pytest.raises(ValueError, match=r"task\.lambda_velocity 0\.5 -> 0\.7"):
        run("stm", STM, changed, corpus, out)
    assert (out / "run_stm.json").read_bytes() == record
    # Where caches lie, and how long it runs, is no other training.
    free = [*QUICK, f"task.operator_cache={tmp_path / 'elsewhere'}", "loop.max_steps=5"]
    (tmp_path / "elsewhere").mkdir()
    assert run("stm", STM, free, corpus, out).step == 5


def test_ctrl_c_exits_as_the_shell_expects(
    corpus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    step = loop.Trainer._train_step

    def interrupted(self: loop.Trainer, draws: Any) -> None:
        signal.raise_signal(signal.SIGINT)
        step(self, draws)

    command = ["train", "stm", "--config", str(STM), "--data", str(corpus)]
    command += ["--out", str(tmp_path / "out"), *QUICK]
    with monkeypatch.context() as patch:
        patch.setattr(loop.Trainer, "_train_step", interrupted)
        assert main(command) == 130
    assert main(command) == 0


# Schedules


@pytest.mark.slow
def test_the_learning_rate_follows_the_clock_only_when_asked(
    corpus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def rates(schedule: str, seconds: float) -> list[float]:
        found: list[float] = []

        def slow(self: loop.Trainer, taken: float) -> tuple[float, bool]:
            found.append(self._learning_rate())
            return seconds, False

        monkeypatch.setattr(loop.Trainer, "_agree", slow)
        options = [*QUICK, "loop.max_minutes=60", f"loop.lr_schedule={schedule}"]
        run("stm", STM, options, corpus, tmp_path / f"{schedule}-{seconds}")
        return found

    # A slow machine's third step ends at 1.2 of the hour; the first three follow the schedule.
    assert rates("cosine", 1)[:3] == rates("cosine", 1440)
    assert rates("cosine_minutes", 1)[:3] != rates("cosine_minutes", 1440)
    with pytest.raises(ValueError, match=r"cosine_minutes needs loop\.max_minutes"):
        load_config("stm", STM, ["loop.lr_schedule=cosine_minutes"])


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.yaml")), ids=lambda p: p.stem)
def test_shipped_recipes_repeat_on_any_machine(path: Path) -> None:
    (kind,) = set(path.stem.split("_")) & {"ats", "stm", "speech", "facetalk", "head"}
    options = load_config(kind, path).loop
    assert options.max_minutes == 0 and options.lr_schedule != "cosine_minutes"


# Where weights come from


def test_weights_record_commit_options_and_data(corpus: Path, tmp_path: Path) -> None:
    run("stm", STM, QUICK, corpus, tmp_path / "out")
    config = json.loads((tmp_path / "out" / "stm" / "config.json").read_text())
    training = config["training"]
    assert training["commit"] == git_commit()
    assert re.fullmatch(r"unknown|[0-9a-f]{40}(\+changes)?", training["commit"])
    assert training["config"]["task"]["frames"] == 4
    assert training["data_fingerprint"]
    traced = {"training": {**training, "commit": "0" * 40}}
    assert untraceable(traced) == []
    assert untraceable({"training": {**training, "commit": "unknown"}}) == ["commit"]
    assert untraceable({}) == ["commit", "data_fingerprint"]


def test_the_commit_is_of_this_package_or_unknown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import subprocess

    from freetalk.train import checkpoint

    def git(*arguments: str) -> None:
        identity = ["-c", "user.name=a", "-c", "user.email=a@b"]
        subprocess.run(
            ["git", *identity, *arguments], cwd=tmp_path, check=True, capture_output=True
        )

    installed = tmp_path / ".venv" / "checkpoint.py"
    installed.parent.mkdir()
    installed.write_text("")
    (tmp_path / "theirs.py").write_text("")
    git("init")
    git("add", "theirs.py")
    git("commit", "-m", "theirs")
    monkeypatch.setattr(checkpoint, "__file__", str(installed))
    assert git_commit() == "unknown"  # somebody else's repository
    git("add", "-f", ".venv")
    git("commit", "-m", "ours")
    clean = git_commit()
    assert re.fullmatch(r"[0-9a-f]{40}", clean)
    installed.write_text("changed")
    assert git_commit() == f"{clean}+changes"


# Data of one's own in the place of the corpus


README = (Path(__file__).parents[2] / "README.md").read_text()
TINY = {
    "speech": [
        "model.hidden_size=32", "model.num_hidden_layers=1", "model.num_attention_heads=2",
        "model.intermediate_size=32", "model.conv_dim=[32, 32, 32]", "task.crop_s=1",
        "task.validation_crops=2", "model.num_conv_pos_embedding_groups=4",
    ],
    "ats": [
        "model.d_model=16", "model.num_layers=1", "model.num_heads=2", "model.ff_dim=16",
        "task.feature_augmentations=1", "task.validation_windows=2",
    ],
    "stm": [
        "model.encoder_width=8", "model.encoder_blocks=1", "model.decoder_width=8",
        "model.decoder_blocks=1", "model.k_eig=8", "model.gcn_hidden=8", "task.validation_windows=2",
    ],
}  # fmt: skip
LINES = re.findall(r"^freetalk train (\w+) --config (\S+) --data corpus --out (\S+)$", README, re.M)


@pytest.mark.slow
def test_every_line_of_the_readme_takes_a_plain_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert [kind for kind, _, _ in LINES] == ["speech", "ats", "stm"]
    monkeypatch.setenv("FREETALK_CACHE", str(tmp_path / "cache"))
    own = write_folder(tmp_path / "own", size=(2200, 4360), frames=30)
    data, out = tmp_path / "packed", tmp_path / "mine"
    assert main(["data", "import", "folder", str(own), "--out", str(data)]) == 0
    assert main(["data", "check", str(data)]) == 0
    steps = ["loop.max_steps=1", "loop.threads=1", "loop.batch_size=2", "loop.bf16=false"]
    for kind, config, _ in LINES:
        path = str(Path(__file__).parents[2] / config)
        command = ["train", kind, "--config", path, "--data", str(data), "--out", str(out)]
        assert main([*command, *steps, *TINY[kind]]) == 0, capsys.readouterr().err
        printed = capsys.readouterr()
        told = printed.err
        assert "there is no source" in told
        if kind == "speech":
            assert f"{out} lacks ats and stm for `freetalk animate --pretrained`" in printed.out
        if kind == "stm":
            assert "has at most 2100 vertices: all are taken" in told
        if kind == "speech":
            assert "spectra and lip opening alone" in told
        assert (out / kind / "model.safetensors").is_file()
    mesh, sound = own / "templates" / "ann.ply", own / "wav" / "ann_0.wav"
    command = ["animate", "--pretrained", str(out), "--audio", str(sound)]
    command += ["--mesh", str(mesh), "--out", str(tmp_path / "talk.glb")]
    command += [
        "--unit",
        "m",
        "--up",
        "+y",
        "--forward",
        "+z",
    ]  # a toy that no one takes for a face
    assert main(command) == 0, capsys.readouterr().err
    assert (tmp_path / "talk.glb").stat().st_size > 1000
    words = ["models", "pack", *(w for k in TINY for w in (f"--{k}", str(out / k)))]
    words += ["--out", str(tmp_path / "weights")]
    traced = [] if git_commit() != "unknown" else ["--untraceable"]
    assert main([*words, *traced]) == 0
    assert (tmp_path / "weights" / "talker.json").read_text() == (out / "talker.json").read_text()


def test_an_audio_stage_brings_its_speech_encoder(tmp_path: Path) -> None:
    encoder = PRETRAINED / "open-small" / "speech"
    for stage in ("ats", "stm"):
        shutil.copytree(PRETRAINED / "open-small" / stage, tmp_path / "out" / stage)
    config = tmp_path / "out" / "ats" / "config.json"
    about = json.loads(config.read_text())
    about["training"]["speech_encoder"] = encoder_record(encoder)
    config.write_text(json.dumps(about))
    assert assemble(tmp_path / "out") == ""
    Talker.from_pretrained(tmp_path / "out", device="cpu")
    weights = tmp_path / "out" / "speech" / "model.safetensors"
    assert weights.read_bytes() == (encoder / "model.safetensors").read_bytes()
    weights.write_bytes(b"another")
    assert "not with the one in" in assemble(tmp_path / "out")
    with pytest.raises(ValueError, match=r"no folder of weights: it has no talker\.json"):
        Talker.from_pretrained(tmp_path / "out", device="cpu")
    shutil.rmtree(tmp_path / "out" / "stm")
    with pytest.raises(ValueError, match=r"lacks stm, which `freetalk train stm --out"):
        Talker.from_pretrained(tmp_path / "out", device="cpu")
