#!/usr/bin/env python3
"""Packs generated takes of MEAD-EMOTE's layout, with a kill on the way, and starts a training on them.

    scripts/bench/importing.py --takes 31000 --frames 10 --work /tmp/mead

Prints how long the listing, the import and the start of the training take, and their greatest resident memory. The takes
are as many as EMOTE releases, but short, and FLAME is smooth nonsense of its shape: what grows with the number of takes is
what is measured.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import soundfile

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "python"))
from dataset_layouts import FLAME, sound, write_flame, write_lists

from freetalk.data.emotions import LABELS

ACTORS = [f"M{n:03d}" for n in range(3, 30)] + [f"W{n:03d}" for n in range(9, 29)]
_CONTENTS = 100


def write_takes(folder: Path, count: int, frames: int) -> None:
    """Takes of 47 actors, eight emotions and three levels, links to a few files; every thousandth is broken."""
    rng = np.random.default_rng(0)
    folder.mkdir(parents=True)
    for number in range(_CONTENTS):
        with h5py.File(folder / f"{number}.hdf5", "w") as file:
            for name, width in (("shape", 300), ("exp", 100), ("jaw", 3)):
                file[name] = rng.normal(0, 0.1, (1, frames, width)).astype(np.float32)
        soundfile.write(folder / f"{number}.wav", sound(frames / 25, 16000, number), 16000)
    (folder / "broken.hdf5").write_bytes(b"cut short")
    root = folder / "processed"
    for number in range(count):
        actor, rest = ACTORS[number % len(ACTORS)], number // len(ACTORS)
        label, rest = list(LABELS["mead"])[rest % 8], rest // 8
        take = Path(actor, "front", label, f"level_{rest % 3 + 1}", f"{rest // 3:03d}")
        target = root / "reconstructions" / "EMICA" / take / "shape_pose_cam.hdf5"
        target.parent.mkdir(parents=True)
        content = "broken" if number % 1000 == 999 else str(number % _CONTENTS)
        os.link(folder / f"{content}.hdf5", target)
        wav = (root / "audio" / take).with_suffix(".wav")
        wav.parent.mkdir(parents=True, exist_ok=True)
        os.link(folder / f"{number % _CONTENTS}.wav", wav)
    write_flame(folder / "flame.npz")
    write_lists(folder, FLAME, ("landmarks68.npy", "lip_mask.npy", "upper_mask.npy"))


def run(command: list[str], stop_after_s: float = 0.0) -> tuple[str, float, float, int]:
    """Seconds and memory as text, seconds, greatest resident memory (GB), status; killed after a while if asked for."""
    began = time.perf_counter()
    process = subprocess.Popen(command)
    if stop_after_s:
        time.sleep(stop_after_s)
        process.send_signal(signal.SIGKILL)
    _, status, usage = os.wait4(process.pid, 0)
    took, memory = time.perf_counter() - began, usage.ru_maxrss / 1e6
    said = f"{took:.1f} s ({usage.ru_utime + usage.ru_stime:.1f} s of CPU), {memory:.2f} GB"
    return said, took, memory, os.waitstatus_to_exitcode(status)


def main() -> int:
    """Reads the command line and measures; 0 where the limits hold."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--takes", type=int, default=31000)
    parser.add_argument("--frames", type=int, default=10)
    parser.add_argument("--work", type=Path, required=True, help="an empty folder")
    parser.add_argument(
        "--kill-after", type=float, default=30.0, help="seconds of the first import"
    )
    parser.add_argument("overrides", nargs="*", metavar="section.key=value", help="of the training")
    given = parser.parse_args()
    source, packed = given.work / "mead", given.work / "packed"
    if not source.exists():
        write_takes(source, given.takes, given.frames)
    freetalk = [sys.executable, "-m", "freetalk.cli"]
    importing = [*freetalk, "data", "import", "mead", str(source), "--out", str(packed)]
    if not packed.exists():
        said, *_ = run(importing, given.kill_after)
        journal = given.work / ".packed.partial" / "journal"
        noted = len(journal.read_text().splitlines()) - 1 if journal.is_file() else 0
        print(
            f"import killed after {said}: {noted} takes are noted, {packed.exists()=}", flush=True
        )
        said, *_, status = run(importing)
        print(f"import resumed and finished in {said} (status {status})", flush=True)
    config = Path(__file__).resolve().parents[2] / "configs" / "stm_smoke.yaml"
    training = [*freetalk, "train", "stm", "--config", str(config), "--data", str(packed)]
    training += ["--out", str(given.work / "out"), "loop.max_steps=1", "loop.validate_every=0"]
    said, took, memory, status = run([*training, *given.overrides])
    print(f"training started, took a step and ended in {said} (status {status})")
    return int(status != 0 or took > 30 or memory > 2)


if __name__ == "__main__":
    sys.exit(main())
