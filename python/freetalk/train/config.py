"""Training configuration: YAML, overridden by ``key=value``, checked before anything starts."""

from __future__ import annotations

import dataclasses
import difflib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException


@dataclass
class LoopOptions:
    """How long, how fast and on what a model trains.

    Attributes:
        seed: every random draw is a function of this and the step number.
        threads: CPU threads; 0 keeps torch's own choice.
        device: ``auto`` (CUDA where present), ``cpu`` or ``cuda``.
        batch_size: items a step (windows, crops or faces), over all processes and accumulated
            passes; a multiple of their number.
        accumulation_steps: forward passes that a step's items are shared out to, for what does not
            fit into memory at once.
        max_steps: optimiser steps.
        max_minutes: training time after which it ends, 0 for no limit; the learning rate then
            follows the clock where that is ahead of the steps.
        learning_rate: AdamW's, at its peak.
        weight_decay: of matrices and kernels; biases, norms and embeddings are spared.
        lr_schedule: ``cosine`` to ``lr_final`` times the peak, or ``constant``.
        lr_final: end of the cosine relative to the peak.
        warmup_steps: linear rise of the learning rate.
        grad_clip: largest gradient norm, 0 disables.
        ema_decay: of the weight average that is validated and exported, 0 disables.
        bf16: run the networks under bfloat16 autocast.
        fp16: run them under float16 autocast with scaled gradients, for GPUs without bfloat16.
        log_every: steps between TensorBoard points.
        validate_every: steps between validations (and exports), 0 only at the end.
        checkpoint_every: steps between checkpoints, 0 only at validations and at the end.
        keep: export the ``best`` validated weights or the ``last``.
        keep_checkpoints: newest checkpoints that stay.
        render_every: steps between rendered samples (a video in ``OUT/samples`` and a picture in
            TensorBoard), 0 for none.
    """

    seed: int = 0
    threads: int = 0
    device: str = "auto"
    batch_size: int = 16
    accumulation_steps: int = 1
    max_steps: int = 100_000
    max_minutes: float = 0.0
    learning_rate: float = 1e-4
    weight_decay: float = 1e-2
    lr_schedule: str = "constant"
    lr_final: float = 0.02
    warmup_steps: int = 0
    grad_clip: float = 1.0
    ema_decay: float = 0.0
    bf16: bool = False
    fp16: bool = False
    log_every: int = 10
    validate_every: int = 1000
    checkpoint_every: int = 0
    keep: str = "best"
    keep_checkpoints: int = 1
    render_every: int = 0

    def check(self) -> None:
        """Raises ValueError where a value is out of range."""
        _require(self.seed >= 0, "loop.seed must not be negative", self.seed)
        for name in ("batch_size", "accumulation_steps", "keep_checkpoints"):
            _require(getattr(self, name) > 0, f"loop.{name} must be positive", getattr(self, name))
        _require(self.max_steps > 0, "loop.max_steps must be positive", self.max_steps)
        _require(self.learning_rate > 0, "loop.learning_rate must be positive", self.learning_rate)
        _require(0 <= self.ema_decay < 1, "loop.ema_decay must be in [0, 1)", self.ema_decay)
        _require(
            not (self.bf16 and self.fp16), "loop.bf16 and loop.fp16 exclude each other", "both"
        )
        choices = {
            "loop.lr_schedule": (self.lr_schedule, ("cosine", "constant")),
            "loop.device": (self.device, ("auto", "cpu", "cuda")),
            "loop.keep": (self.keep, ("best", "last")),
        }
        for name, (value, known) in choices.items():
            _require(value in known, f"{name} must be one of {', '.join(known)}", value)


@dataclass
class AtsTaskOptions:
    """Data and losses of the audio-to-landmarks stage.

    Attributes:
        init: weights to start from: their folder, a training's output folder, or the name of
            installed ones (``open-small``), whose motion statistics stay; empty starts from random
            ones.
        speech_encoder: folder of the speech encoder; empty takes ``OUT/speech``, else the one beside
            the weights of `init`, else the shipped one.
        feature_cache: folder of the computed speech features; empty takes ``OUT/cache``.
        feature_augmentations: extra copies of the features from changed audio (noise, room,
            band limits, speed).
        feature_noise: noise added to the features of each frame, relative to their standard
            deviation.
        feature_shift: noise that is the same in all frames of a window, likewise: what a speaker
            or a room adds to the features.
        feature_dropout: share of the features, each channel and frame for itself, that are replaced
            by their mean over the corpus.
        step_power: diffusion steps t of N are drawn with a density of t^(step_power - 1): more than 1
            dwells on noisy motion, where the sound alone must tell the answer; 1 is the paper.
        rehearsal: share of the windows in which the noisy mouth, nose and jaw are made of the model's
            own first estimate, as in sampling, instead of the true motion [as DREAM, Zhou et al.
            2024]: sampling then does not enlarge what the first estimate got wrong. Brows and eyes
            stay true, so that they go on varying; 0 is the paper.
        audio_dropout: share of the windows that hear nothing, for guidance; 0 is the paper.
        affect_dropout: share of the windows without emotion and intensity, for guidance; 0 is the
            paper.
        mosaic: share of the windows joined from pieces of several takes of one emotion, so that
            each is judged by its own sound; 0 is the paper.
        blend: share of the windows that are convex combinations of two, in features, motion, emotion
            and intensity [mixup, Zhang et al. 2018]: between what was heard the answer is
            linear, which carries over better to other ways of speaking; 0 is the paper.
        source_weights: share of each source in the batches; others are left out. Empty takes all
            in proportion to their length.
        lambda_velocity: weight of Eq. 15's velocity term.
        lambda_acceleration: weight of Eq. 15's acceleration term.
        loss_units: ``normalised`` (each coordinate by its spread) or ``metres`` (the paper).
        lip_weight: weight of the 20 lip landmarks; 1 weighs all alike (the paper).
        opening_weight: weight of an extra term on the inner-lip gaps, 0 disables (the paper).
        closure_weight: weight of an extra term on lips that should be closed for a moment, as in
            p, b and m; 0 disables (the paper).
        validation_windows: windows of the validation split that are scored.
    """

    init: str = ""
    speech_encoder: str = ""
    feature_cache: str = ""
    feature_augmentations: int = 0
    feature_noise: float = 0.0
    feature_shift: float = 0.0
    feature_dropout: float = 0.0
    step_power: float = 1.0
    rehearsal: float = 0.0
    audio_dropout: float = 0.0
    affect_dropout: float = 0.0
    mosaic: float = 0.0
    blend: float = 0.0
    source_weights: dict[str, float] = field(default_factory=dict)
    lambda_velocity: float = 0.3
    lambda_acceleration: float = 0.1
    loss_units: str = "metres"
    lip_weight: float = 1.0
    opening_weight: float = 0.0
    closure_weight: float = 0.0
    validation_windows: int = 32

    def check(self) -> None:
        """Raises ValueError where a value is out of range."""
        _require(
            0 <= self.feature_dropout < 1,
            "task.feature_dropout must be in [0, 1)",
            self.feature_dropout,
        )
        _require(self.step_power > 0, "task.step_power must be positive", self.step_power)
        _require(0 <= self.rehearsal <= 1, "task.rehearsal must be in [0, 1]", self.rehearsal)
        _require(0 <= self.mosaic <= 1, "task.mosaic must be in [0, 1]", self.mosaic)
        _require(0 <= self.blend <= 1, "task.blend must be in [0, 1]", self.blend)
        _require(
            self.loss_units in ("metres", "normalised"),
            "task.loss_units must be metres or normalised",
            self.loss_units,
        )
        _require(self.lip_weight > 0, "task.lip_weight must be positive", self.lip_weight)


@dataclass
class StmTaskOptions:
    """Data and losses of the landmarks-to-mesh stage.

    Attributes:
        init: weights to start from: their folder, a training's output folder, or the name of
            installed ones (``open-small``); empty starts from random ones.
        operator_cache: folder of the surface operators; empty takes the user's cache.
        frames: consecutive frames of a window.
        num_meshes: (identity, topology) pairs of the train split that are drawn, 0 for all.
        max_vertices: meshings with more vertices are left out of training, 0 for no limit.
        crops: share of the faces drawn that are cropped at random around eyes, nose and mouth, so
            that the network does not depend on where a mesh ends.
        missing_faces: largest share of a cropped face's triangles that is taken away.
        source_weights: share of each source in the batches; ``random`` is drawn combinations of
            expressions. Empty takes all sources in proportion to their length.
        rotation_deg: misalignment of the mesh: largest rotation.
        translation_m: misalignment of the mesh: largest shift along an axis.
        scale_range: misalignment of the mesh: largest relative change of size.
        landmark_noise_m: standard deviation of noise on the landmark displacements.
        lambda_velocity: weight of Eq. 15's velocity term.
        lambda_acceleration: weight of Eq. 15's acceleration term.
        lip_weight: weight of vertices of the lips; 1 weighs all alike (the paper).
        relative: divide each window's loss by the target's own mean square (with a floor), so that
            small motions count as much as large ones; the paper does not.
        error_weight: weight of an extra term, the mean vertex error relative to the mean motion: it
            counts the many vertices that move little, which squares pass over; 0 disables (the
            paper).
        validation_windows: windows on unseen meshes that are scored.
    """

    init: str = ""
    operator_cache: str = ""
    frames: int = 12
    num_meshes: int = 0
    max_vertices: int = 0
    crops: float = 0.0
    missing_faces: float = 0.0
    source_weights: dict[str, float] = field(default_factory=dict)
    rotation_deg: float = 0.0
    translation_m: float = 0.0
    scale_range: float = 0.0
    landmark_noise_m: float = 0.0
    lambda_velocity: float = 0.5
    lambda_acceleration: float = 0.2
    lip_weight: float = 1.0
    relative: bool = False
    error_weight: float = 0.0
    validation_windows: int = 8

    def check(self) -> None:
        """Raises ValueError where a value is out of range."""
        _require(self.frames >= 3, "task.frames must be at least 3", self.frames)
        _require(0 <= self.scale_range < 1, "task.scale_range must be in [0, 1)", self.scale_range)
        _require(0 <= self.crops <= 1, "task.crops must be in [0, 1]", self.crops)
        _require(
            0 <= self.missing_faces < 1,
            "task.missing_faces must be in [0, 1)",
            self.missing_faces,
        )
        _require(self.lip_weight > 0, "task.lip_weight must be positive", self.lip_weight)


@dataclass
class SpeechTaskOptions:
    """Data and losses of the speech encoder.

    Attributes:
        init: weights to start from: their folder, a training's output folder, or the name of
            installed ones (``open-small``); the teachers' heads start from random ones. Empty
            starts all from random ones.
        crop_s: length of the crops.
        pieces: a crop joins up to so many pieces of different takes, so that what is heard at one
            moment is not judged by the rhythm of the whole take.
        motion_sources: sources whose curves and opening are taught; empty takes all. One recorded
            speaker is better left out: a few takes would be learnt by heart.
        recordings: alignments of recorded speech that ``freetalk speech align`` wrote; they teach
            phones alone and are the source ``recorded``.
        source_weights: share of each source in the batches. Empty takes all sources in
            proportion to their length.
        augment: share of the crops whose audio is changed (level, noise, room, band limits).
        speed_range: largest relative change of speed and pitch.
        phone_weight: weight of the frame-wise phone class.
        mel_weight: weight of the log-mel regression.
        curve_weight: weight of the regression of expression curves.
        opening_weight: weight of the regression of the inner-lip opening.
        num_mels: log-mel bands.
        validation_crops: crops of the validation split that are scored.
    """

    init: str = ""
    crop_s: float = 5.0
    pieces: int = 1
    motion_sources: list[str] = field(default_factory=list)
    recordings: list[str] = field(default_factory=list)
    source_weights: dict[str, float] = field(default_factory=dict)
    augment: float = 0.7
    speed_range: float = 0.12
    phone_weight: float = 1.0
    mel_weight: float = 0.3
    curve_weight: float = 1.0
    opening_weight: float = 1.0
    num_mels: int = 40
    validation_crops: int = 48

    def check(self) -> None:
        """Raises ValueError where a value is out of range."""
        _require(self.crop_s >= 1.0, "task.crop_s must be at least 1", self.crop_s)
        _require(self.pieces >= 1, "task.pieces must be at least 1", self.pieces)
        _require(0 <= self.augment <= 1, "task.augment must be in [0, 1]", self.augment)


TaskOptions = AtsTaskOptions | StmTaskOptions | SpeechTaskOptions
_TASKS: dict[str, type[AtsTaskOptions] | type[StmTaskOptions] | type[SpeechTaskOptions]] = {
    "ats": AtsTaskOptions,
    "stm": StmTaskOptions,
    "speech": SpeechTaskOptions,
}
KINDS = tuple(_TASKS)


@dataclass
class TrainingConfig:
    """A checked configuration; ``model`` is checked by the model's own options."""

    kind: str
    model: dict[str, Any]
    loop: LoopOptions
    task: TaskOptions

    def to_dict(self) -> dict[str, Any]:
        """Plain containers, as stored beside the weights."""
        return dataclasses.asdict(self)


def find_config(path: str | Path) -> Path:
    """The file at ``path``, or the shipped configuration of that name.

    Raises:
        FileNotFoundError: neither exists; the message lists the shipped names.
    """
    if Path(path).is_file():
        return Path(path)
    package = Path(__file__).resolve().parents[1]
    shipped = {
        file.stem: file
        for folder in (package.parents[1] / "configs", package / "configs")
        for file in sorted(folder.glob("*.yaml"))
    }
    if str(path) not in shipped:
        names = ", ".join(sorted(shipped))
        raise FileNotFoundError(f"no configuration file {path}; shipped configurations: {names}")
    return shipped[str(path)]


def load_config(kind: str, path: str | Path, overrides: list[str] | None = None) -> TrainingConfig:
    """Reads a YAML file with sections ``model``, ``loop`` and ``task``.

    Args:
        kind: ``ats``, ``stm`` or ``speech``.
        path: YAML file, or the name of a shipped one (``ats_small``).
        overrides: ``section.key=value`` pairs that win over the file; a mapping (``{a: 1}``) takes the
            place of the file's.

    Raises:
        ValueError: unknown kind or key (names the nearest), malformed value.
        FileNotFoundError: no such file.
    """
    if kind not in _TASKS:
        raise ValueError(f"unknown training {kind!r}; known: {', '.join(KINDS)}")
    path = find_config(path)
    try:
        base = OmegaConf.load(path)
        for override in overrides or []:
            option, _, value = override.partition("=")
            if value.strip().startswith("{") or value.strip() == "null":
                OmegaConf.update(base, option, None, merge=False)
        merged = OmegaConf.merge(base, OmegaConf.from_dotlist(overrides or []))
        raw = OmegaConf.to_container(merged, resolve=True)
    except (OmegaConfBaseException, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error
    if not isinstance(raw, dict):
        raise ValueError(f"{path} holds no sections model, loop, task")
    for key in raw:
        if key not in ("model", "loop", "task"):
            raise ValueError(_unknown(str(key), ["model", "loop", "task"], str(path)))
    model = {str(key): value for key, value in (raw.get("model") or {}).items()}
    loop = options_from_dict(LoopOptions, raw.get("loop") or {}, f"{path}: loop")
    task: TaskOptions = options_from_dict(_TASKS[kind], raw.get("task") or {}, f"{path}: task")
    loop.check()
    task.check()
    return TrainingConfig(kind=kind, model=model, loop=loop, task=task)


T = TypeVar("T")


def options_from_dict(kind: type[T], values: dict[Any, Any], where: str) -> T:
    """Fills a dataclass of options; numbers and flags must have the field's type."""
    fields = {f.name: f for f in dataclasses.fields(kind)}  # type: ignore[arg-type]
    filled: dict[str, Any] = {}
    for key, value in values.items():
        if key not in fields:
            raise ValueError(_unknown(str(key), list(fields), where))
        filled[key] = _converted(value, str(fields[key].type), f"{where}.{key}")
    return kind(**filled)


def _converted(value: Any, wanted: str, where: str) -> Any:
    if wanted == "float" and isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    if wanted == "int" and isinstance(value, int) and not isinstance(value, bool):
        return value
    if wanted == "bool" and isinstance(value, bool):
        return value
    if wanted == "str" and (isinstance(value, str) or value is None):
        return value or ""
    if wanted.startswith("dict") and (isinstance(value, dict) or value is None):
        return {str(key): float(item) for key, item in (value or {}).items()}
    if wanted == "list[str]" and isinstance(value, list):
        return [str(item) for item in value]
    raise ValueError(f"{where} = {value!r} is no {wanted}")


def _unknown(key: str, known: list[str], where: str) -> str:
    near = difflib.get_close_matches(key, known, n=1, cutoff=0.0)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return f"{where}: unknown option {key!r}{hint}"


def _require(condition: bool, message: str, found: object) -> None:
    if not condition:
        raise ValueError(f"{message}, got {found}")
