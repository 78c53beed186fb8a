"""Options of the trainings: what each draws from the data and which losses it weighs."""

from __future__ import annotations

from dataclasses import dataclass, field


def require(condition: bool, message: str, found: object) -> None:
    if not condition:
        raise ValueError(f"{message}, got {found}")


def require_shares(options: object, *names: str) -> None:
    for name in names:
        value = getattr(options, name)
        require(0 <= value <= 1, f"task.{name} must be in [0, 1]", value)


def require_positive(options: object, *names: str, section: str = "task") -> None:
    for name in names:
        value = getattr(options, name)
        require(value > 0, f"{section}.{name} must be positive", value)


def require_none_negative(options: object, *names: str, section: str = "task") -> None:
    for name in names:
        value = getattr(options, name)
        require(value >= 0, f"{section}.{name} must not be negative", value)


def require_known(options: object, name: str, *known: str, section: str = "task") -> None:
    value = getattr(options, name)
    require(value in known, f"{section}.{name} must be one of {', '.join(known)}", value)


@dataclass
class DenoisingTaskOptions:
    """Data and losses that the trainings of speech's denoisers share; what 0 disables, the papers lack.

    Attributes:
        init: weights to start from: their folder, a training's output folder, or the name of
            installed ones (``open-small``), whose statistics stay; empty starts from random ones.
        speech_encoder: folder of the speech encoder, or the name of installed weights
            (``open-small``); empty takes ``OUT/speech``, else the one beside the weights of `init`.
        feature_cache: folder of the computed speech features; empty takes ``OUT/cache``.
        feature_augmentations: extra copies of the features from changed audio (noise, room,
            band limits, speed).
        voices: further copies by source, in other voices: pitch, formants and tempo changed, the motion
            at that tempo; so that a model that learns from few talkers follows others.
        feature_noise: noise added to the features of each frame, relative to their standard
            deviation.
        feature_shift: noise that is the same in all frames of a window, likewise: what a speaker
            or a room adds to the features.
        feature_dropout: share of the features, each channel and frame for itself, that are replaced
            by their mean over the corpus.
        step_power: diffusion steps t of N are drawn with a density of t^(step_power - 1): more than 1
            dwells on noisy motion, where the sound alone must tell the answer; 1 is the papers.
        audio_dropout: share of the windows that hear nothing, for guidance.
        blend: share of the windows that are convex combinations of two, in all that they hold [mixup,
            Zhang et al. 2018]: between what was heard the answer is linear, which carries over better
            to other ways of speaking.
        source_weights: share of each source in the batches; others are left out, and so are names
            that the data lacks. Empty takes all in proportion to their length.
        lambda_velocity: weight of the error of the first differences.
        opening_weight: weight of an extra term on the inner-lip gaps.
        closure_weight: weight of an extra term on lips that should be closed for a moment, as in
            p, b and m.
        validation_windows: windows of the validation split that are scored.
        validation_samples: clips of it, of at most 300 frames, that are also sampled from noise, for LVE, MVE and the opening's
            correlation of what a user gets (``loop.select=sampled_lve_mm2`` chooses by them); 0 for none.
    """

    init: str = ""
    speech_encoder: str = ""
    feature_cache: str = ""
    feature_augmentations: int = 0
    voices: dict[str, int] = field(default_factory=dict)
    feature_noise: float = 0.0
    feature_shift: float = 0.0
    feature_dropout: float = 0.0
    step_power: float = 1.0
    audio_dropout: float = 0.0
    blend: float = 0.0
    source_weights: dict[str, float] = field(default_factory=dict)
    lambda_velocity: float = 0.0
    opening_weight: float = 0.0
    closure_weight: float = 0.0
    validation_windows: int = 32
    validation_samples: int = 4

    def check(self) -> None:
        """Raises ValueError where a value is out of range."""
        require(
            0 <= self.feature_dropout < 1,
            "task.feature_dropout must be in [0, 1)",
            self.feature_dropout,
        )
        require_positive(self, "step_power")
        require_shares(self, "blend", "audio_dropout")


@dataclass
class AtsTaskOptions(DenoisingTaskOptions):
    """Data and losses of the audio-to-landmarks stage.

    Attributes:
        rehearsal: share of the windows in which the noisy mouth, nose and jaw are made of the model's
            own first estimate, as in sampling, instead of the true motion [as DREAM, Zhou et al.
            2024]: sampling then does not enlarge what the first estimate got wrong. Brows and eyes
            stay true, so that they go on varying; 0 is the paper.
        affect_dropout: share of the windows without emotion and intensity, for guidance; 0 is the
            paper.
        known_prefix: share of the windows that are as live speech shows them: cut off a few frames after those that
            are known, which are given clean and not judged [as Diffusion Forcing, Chen et al. 2024]; 0 is the paper.
        mosaic: share of the windows joined from pieces of several takes of one emotion, so that
            each is judged by its own sound; 0 is the paper.
        position_offsets: windows shorter than ``model.max_frames`` begin at random learned positions,
            so that all of them are trained.
        lambda_velocity: of Eq. 15.
        lambda_acceleration: weight of Eq. 15's acceleration term.
        loss_units: ``millimetres`` (the paper's loss of positions) or ``normalised`` (each coordinate by
            its spread).
        lip_weight: weight of the 20 lip landmarks; 1 weighs all alike (the paper).
        eye_weight: weight of the 12 landmarks of the eyelids, so that blinks are learnt, which are
            rare; 1 weighs all alike (the paper).
    """

    rehearsal: float = 0.0
    affect_dropout: float = 0.0
    known_prefix: float = 0.0
    mosaic: float = 0.0
    position_offsets: bool = True
    lambda_velocity: float = 0.3
    lambda_acceleration: float = 0.1
    loss_units: str = "millimetres"
    lip_weight: float = 1.0
    eye_weight: float = 1.0

    def check(self) -> None:
        super().check()
        require_shares(self, "rehearsal", "mosaic", "affect_dropout", "known_prefix")
        require_known(self, "loss_units", "millimetres", "normalised")
        require_positive(self, "lip_weight", "eye_weight")


@dataclass
class FaceTalkTaskOptions(DenoisingTaskOptions):
    """Data and losses of the speech-to-codes stage [FaceTalk, Aneja et al. 2024].

    The terms on the lips are of the landmarks that a linear map makes of the codes.

    Attributes:
        targets: ``weights`` of the corpus's expressions, or fitted codes of a parametric ``head``
            (``freetalk corpus codes``).
        window_frames: of a window; 48 are the paper's two seconds.
        amplitude_low: r of Eq. 8, by which codes are scaled about the face at rest, is drawn from
            U(amplitude_low, amplitude_high) for each window; 1 and 1 disable it.
        amplitude_high: see `amplitude_low`; the paper does not say the bounds.
        audio_dropout: 0.25 is the paper.
        loss_units: ``codes`` (the paper's Eq. 4) or ``normalised`` (each code by its spread).
    """

    targets: str = "weights"
    window_frames: int = 48
    amplitude_low: float = 1.0
    amplitude_high: float = 1.0
    audio_dropout: float = 0.25
    loss_units: str = "normalised"

    def check(self) -> None:
        super().check()
        require_known(self, "targets", "weights", "head")
        require_known(self, "loss_units", "codes", "normalised")
        require(
            self.window_frames >= 2, "task.window_frames must be at least 2", self.window_frames
        )
        require(
            0 < self.amplitude_low <= self.amplitude_high,
            "task.amplitude_low must be positive and at most amplitude_high",
            f"{self.amplitude_low} and {self.amplitude_high}",
        )


@dataclass
class StmTaskOptions:
    """Data and losses of the landmarks-to-mesh stage.

    Attributes:
        init: weights to start from: their folder, a training's output folder, or the name of
            installed ones (``open-small``); empty starts from random ones.
        operator_cache: folder of the surface operators, which nothing empties; empty takes ``training-operators``
            in the user's cache.
        operator_memory_gb: memory of training faces with their operators; those used last stay, the others come
            again from the folder. 0 for no limit.
        frames: consecutive frames of a window.
        num_meshes: (identity, topology) pairs of the train split that are drawn, 0 for all.
        max_vertices: meshings with more vertices are left out of training, 0 for no limit; a dataset
            that has no smaller ones is trained on all the same.
        crops: share of the faces drawn that are cropped at random around eyes, nose and mouth, so
            that the network does not depend on where a mesh ends.
        missing_faces: largest share of a cropped face's triangles that is taken away.
        bends: share of the faces drawn that get other proportions by a smooth map of space.
        sculpts: share of the windows whose motion is changed as another artist's sculpt of the same
            expressions would have it, see ``freetalk.train.stm_sculpts``; 0 for the corpus's own.
        plain_weight: of a model that follows its landmarks: weight of the loss of its output before
            it is made to follow them.
        source_weights: share of each source in the batches; ``random`` is drawn combinations of
            expressions of the open corpus. Names that the data lacks are left out. Empty takes all
            sources in proportion to their length.
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
        landmark_weight: of sequences whose frames are scans (``freetalk.data.scans``): weight of Eq. 15 at the
            landmarks. `lip_weight` and `error_weight` do not concern them, nor do `crops`.
        chamfer_weight: of these: weight of the squared distances between scan and surface, both ways, which are small:
            most of a face's motion is along it.
        validation_windows: windows on unseen meshes that are scored.
    """

    init: str = ""
    operator_cache: str = ""
    operator_memory_gb: float = 4.0
    frames: int = 12
    num_meshes: int = 0
    max_vertices: int = 0
    crops: float = 0.0
    missing_faces: float = 0.0
    bends: float = 0.0
    sculpts: float = 0.0
    plain_weight: float = 0.3
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
    landmark_weight: float = 1.0
    chamfer_weight: float = 10.0
    validation_windows: int = 8

    def check(self) -> None:
        """Raises ValueError where a value is out of range."""
        require(self.frames >= 3, "task.frames must be at least 3", self.frames)
        require_none_negative(self, "operator_memory_gb", "plain_weight")
        require_none_negative(self, "landmark_weight", "chamfer_weight")
        require(0 <= self.scale_range < 1, "task.scale_range must be in [0, 1)", self.scale_range)
        require_shares(self, "crops", "bends", "sculpts")
        require(
            0 <= self.missing_faces < 1,
            "task.missing_faces must be in [0, 1)",
            self.missing_faces,
        )
        require_positive(self, "lip_weight")


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
        voices: share of the pieces that another voice says instead: pitch and formants changed together, tempo by itself.
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
    voices: float = 0.0
    phone_weight: float = 1.0
    mel_weight: float = 0.3
    curve_weight: float = 1.0
    opening_weight: float = 1.0
    num_mels: int = 40
    validation_crops: int = 48

    def check(self) -> None:
        """Raises ValueError where a value is out of range."""
        require(self.crop_s >= 1.0, "task.crop_s must be at least 1", self.crop_s)
        require(self.pieces >= 1, "task.pieces must be at least 1", self.pieces)
        require_shares(self, "augment", "voices")
