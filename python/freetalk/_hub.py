"""Folders of weights on the Hugging Face hub: fetched by name, published with a model card.

``huggingface_hub`` is an optional dependency (``pip install 'freetalk[hub]'``), imported when it is needed.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from freetalk._pretrained import FURTHER_STAGES, STAGES, missing_stages

_NO_NETWORK = (
    "cannot reach huggingface.co for {}: check the network (and that HF_HUB_OFFLINE is not set), or copy config.json "
    "and the weights into a folder by other means and use that folder"
)
#: What belongs to a folder of weights; checkpoints, caches and curves of its training stay where they are.
FILES = (
    "talker.json",
    "template.safetensors",
    "rig_poses.safetensors",
    *(
        f"{stage}/{name}"
        for stage in (*STAGES, *FURTHER_STAGES)
        for name in ("config.json", "model.safetensors")
    ),
)


def is_repository(name: str | os.PathLike[str]) -> bool:
    """Whether a name has the form ``owner/name``."""
    return re.fullmatch(r"[A-Za-z0-9][\w.-]*/[A-Za-z0-9][\w.-]*", os.fspath(name)) is not None


@contextmanager
def refusals(repository: str) -> Iterator[None]:
    """Says in one sentence why the hub gave nothing; a file that a repository lacks stays its own error."""
    from huggingface_hub import errors

    try:
        yield
    except errors.RepositoryNotFoundError:
        raise RuntimeError(f"huggingface.co has no public repository {repository}") from None
    except (errors.LocalEntryNotFoundError, errors.OfflineModeIsEnabled):
        raise RuntimeError(_NO_NETWORK.format(repository)) from None
    except errors.EntryNotFoundError:
        raise
    except errors.HfHubHTTPError as error:
        raise RuntimeError(f"huggingface.co refused {repository}: {error}") from None
    except OSError:
        raise RuntimeError(_NO_NETWORK.format(repository)) from None


def download(repository: str, revision: str | None = None) -> Path:
    """Fetches a folder of weights into the hub's cache.

    Args:
        repository: ``owner/name``.
        revision: branch, tag or commit; by default the newest.

    Raises:
        RuntimeError: the hub cannot be reached, or the repository holds no such weights.
        ModuleNotFoundError: huggingface_hub is not installed.
    """
    import huggingface_hub

    with refusals(repository):
        folder = Path(
            huggingface_hub.snapshot_download(
                repository, revision=revision, allow_patterns=list(FILES)
            )
        )
    if not (folder / "talker.json").is_file() or missing_stages(folder):
        raise RuntimeError(
            f"{repository} holds no weights of freetalk: it lacks talker.json or stages"
        )
    return folder


def push(
    folder: str | os.PathLike[str],
    repository: str,
    *,
    licence: str = "mit",
    private: bool = False,
    message: str = "Weights of freetalk",
) -> str:
    """Publishes a folder of weights with a model card; ``Talker.from_pretrained(repository)`` loads it.

    Args:
        folder: with talker.json and all stages, as a training leaves it.
        repository: ``owner/name``, made if it is not there.
        licence: of the weights, as the hub names licences.
        private: whether others do not see a repository that is made.
        message: of the commit.

    Returns:
        Its address.

    Raises:
        ValueError: the folder is no complete folder of weights, or the name has another form.
        RuntimeError: the hub refuses, or cannot be reached.
        ModuleNotFoundError: huggingface_hub is not installed.
    """
    path = Path(folder)
    lacking = missing_stages(path)
    if lacking or not (path / "talker.json").is_file():
        raise ValueError(
            f"{path} lacks {', '.join(lacking) or 'talker.json'}: train it to its end first"
        )
    if not is_repository(repository):
        raise ValueError(f"'{repository}' is no repository: give OWNER/NAME")
    from huggingface_hub import CommitOperationAdd, HfApi

    card = model_card(path, repository, licence)
    content: list[tuple[str, Any]] = [("README.md", card.encode())]
    content += [(name, path / name) for name in FILES if (path / name).is_file()]
    with refusals(repository):
        api = HfApi()
        address = api.create_repo(repository, private=private, exist_ok=True)
        api.create_commit(
            repository,
            [CommitOperationAdd(path_in_repo=name, path_or_fileobj=data) for name, data in content],
            commit_message=message,
        )
    return str(address)


def model_card(folder: Path, repository: str, licence: str = "mit") -> str:
    """What the weights are, what they were trained on and how they scored, as the hub's README.md.

    Args:
        folder: of weights.
        repository: its name on the hub.
        licence: of the weights.
    """
    about = json.loads((folder / "talker.json").read_text())
    lines = [
        *("---", f"license: {licence}", "library_name: freetalk"),
        *("tags: [talking-face, speech-driven-animation, 3d]", "---", ""),
        f"# {repository.split('/')[-1]}",
        "",
        "Speech and a face mesh of any topology in, a talking face out, with "
        "[freetalk](https://pypi.org/project/freetalk).",
        "",
        "```python",
        "import freetalk as ft",
        f'talker = ft.Talker.from_pretrained("{repository}")',
        'talker.animate("speech.wav", "face.obj", emotion="happy").save("talk.glb")',
        "```",
        "",
        f"Emotions: {', '.join(about['emotions'])}. Motion at {about['fps']:g} frames per second.",
        "",
        "| stage | steps | data | validation | commit |",
        "|---|---|---|---|---|",
    ]
    for stage in (*STAGES, *FURTHER_STAGES):
        if not (folder / stage / "config.json").is_file():
            continue
        config = json.loads((folder / stage / "config.json").read_text())
        training = config.get("training") or {}
        scores = training.get("validation") or {}
        shown = ", ".join(f"{name} {value:.4g}" for name, value in scores.items())
        data = training.get("data") or {}
        cells = [
            stage,
            training.get("steps", ""),
            data.get("name", training.get("data_fingerprint", "")),
        ]
        cells += [shown, training.get("commit", "unknown")]
        lines.append(f"| {' | '.join(str(cell) for cell in cells)} |")
    lines += [
        "",
        "A talking face can be mistaken for a statement by a real person: animate people who agreed to it, label what "
        "is synthetic, and do not use these weights to deceive, to harass or to get past identity checks.",
        "",
    ]
    return "\n".join(lines)
