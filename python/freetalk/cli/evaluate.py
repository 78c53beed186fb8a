"""``freetalk evaluate``."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from freetalk._files import write_json
from freetalk._pretrained import find_weights
from freetalk.cli.outputs import check_readable, check_writable
from freetalk.cli.parser import UsageError
from freetalk.cli.score_options import AXES

_STAGES = {
    "stm": ("stm",),
    "ats": ("speech", "ats"),
    "emotions": ("speech", "ats"),
    "facetalk": ("speech", "facetalk"),
}


def run(arguments: argparse.Namespace) -> None:
    """Scores predictions (--pred), or weights on the test split of a dataset (--data)."""
    if arguments.pred:
        score(arguments)
        return
    if arguments.data is None:
        raise UsageError(
            "give --data, a dataset to measure weights on, or --pred and --gt, predictions to score "
            "(see 'freetalk evaluate --help')"
        )
    measure(arguments)


def measure(arguments: argparse.Namespace) -> None:
    """Measures weights on the test split of a dataset and prints a table."""
    from freetalk.data import open_datasets, parse_spec

    if len(arguments.out) > 1:
        raise UsageError("scores of weights are written to one --out")
    _folder(parse_spec(arguments.data)[2])
    needed = {stage for part in arguments.parts for stage in _STAGES[part]}
    weights = find_stages(arguments.pretrained, sorted(needed))
    for file in arguments.audio:
        check_readable(file, "a recording of speech")
    for file in arguments.out:
        check_writable(Path(file))
    from freetalk.evaluate import weights as scores_of

    scores = scores_of.measure(
        open_datasets(arguments.data),
        weights,
        parts=arguments.parts,
        take=arguments.take,
        audio=[Path(file) for file in arguments.audio],
        samples=arguments.samples,
        steps=arguments.steps,
        device=arguments.device,
    )
    print(weights)
    print(scores_of.table(scores))
    for file in arguments.out:
        write_json(Path(file), scores)


def find_stages(name: str, needed: Sequence[str]) -> Path:
    """Installed weights by name, or a folder with the stages that are needed."""
    if all((Path(name) / stage / "config.json").is_file() for stage in needed):
        return Path(name)
    return find_weights(name)


def score(arguments: argparse.Namespace) -> None:
    """Scores folders of predictions against a ground truth and prints a table."""
    if arguments.gt is None:
        raise UsageError("--pred needs --gt, the ground truth: a folder of motion or a dataset")
    if (arguments.fps is not None and arguments.fps <= 0) or arguments.resamples < 1:
        raise UsageError("--fps and --resamples must be above 0")
    from freetalk import evaluate
    from freetalk.data import parse_spec
    from freetalk.evaluate.masks import read_lip_pairs
    from freetalk.evaluate.motion_files import unit_scale
    from freetalk.evaluate.writers import FORMATS, terminal

    outputs = [Path(file) for file in arguments.out]
    for path in outputs:
        if path.suffix.lower() not in FORMATS:
            raise ValueError(f"'{path}' does not say what to write: end it in {', '.join(FORMATS)}")
        check_writable(path)
    _, scheme, folder = parse_spec(arguments.gt)
    truth = evaluate.open_ground_truth(
        _folder(folder),
        evaluate.FolderSettings(
            unit=arguments.unit,
            kind=arguments.kind,
            templates=_path(arguments.templates),
            fps=arguments.fps,
            wav=None if arguments.wav is None else _folder(arguments.wav),
            phones=_file(arguments.phones, "phones"),
            emotions=_file(arguments.emotions, "emotions"),
        ),
        arguments.split,
        arguments.topology,
        scheme,
    )
    masks = {**truth.masks, **evaluate.read_masks(arguments.masks, truth.num_vertices)}
    pairs = truth.lip_pairs
    if arguments.lip_pairs is not None:
        pairs = read_lip_pairs(check_readable(arguments.lip_pairs, "lip pairs"), truth.num_vertices)
    scores = evaluate.score_predictions(
        _systems(arguments.pred),
        truth,
        masks,
        pairs,
        evaluate.PredictionSettings(
            metrics=arguments.metrics,
            kind=arguments.pred_kind,
            scale=None if arguments.pred_unit is None else unit_scale(arguments.pred_unit),
            pattern=arguments.names,
            strict=arguments.strict,
            up=None if arguments.up is None else AXES[arguments.up],
        ),
    )
    statistics = evaluate.StatisticsSettings(
        confidence=arguments.confidence,
        num_resamples=arguments.resamples,
        seed=arguments.score_seed,
        baseline=arguments.baseline,
    )
    report = evaluate.make_report(scores, truth, masks, statistics)
    print(terminal(report))
    for path in outputs:
        evaluate.write_report(report, path)


def _systems(given: list[str]) -> list[tuple[str, Path]]:
    """``NAME=DIR`` or ``DIR``, which is called as the folder."""
    from freetalk.data import parse_spec

    systems: dict[str, Path] = {}
    for text in given:
        name, _, directory = parse_spec(text)
        name = name or Path(directory).resolve().name
        if name in systems:
            raise ValueError(f"two systems are called {name}: give them names, NAME=DIR")
        systems[name] = _folder(directory)
    return list(systems.items())


def _folder(text: str) -> Path:
    if not Path(text).is_dir():
        raise OSError(f"'{text}' is no folder")
    return Path(text)


def _file(text: str | None, what: str) -> Path | None:
    return None if text is None else check_readable(text, what)


def _path(text: str | None) -> Path | None:
    if text is not None and not Path(text).exists():
        raise OSError(f"'{text}' does not exist")
    return None if text is None else Path(text)
