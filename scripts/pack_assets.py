#!/usr/bin/env python3
"""Re-encodes the public source data into the compact assets that ship with the package.

    scripts/pack_assets.py --source DIR [--out python/freetalk/assets]

DIR holds the folders `ict_facekit`, `facegood_audio2face`, `livelinkface_rom`, `emodb` and
`speech_english`, each with its LICENSE and SOURCE.txt. Deltas become integers of a fixed step
(10 micrometres), differenced along the vertices and packed low byte before high byte, which is what
makes them compress; audio becomes FLAC. `manifest.json` lists every file with its size and SHA-256.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import soundfile as sf

STEP_CM = 0.001
FACE_VERTICES = 14062  # face, head, neck and sockets: the part whose identity modes are kept
TAKES = ("1114_2_01", "1114_2_02", "1114_2_03", "1114_2_04", "1114_2_05", "1114_3_15")
CLIPS_A_SPEAKER = 23
CLIPS_AN_EMOTION = 5
NOTES = {
    "ict_facekit": "Packed: faces.npz (see freetalk.corpus.assets.load_face_model). Expression deltas "
    "of all vertices and identity modes of the first 14,062 vertices, quantised to 10 micrometres.",
    "facegood_audio2face": "Packed: audio as FLAC (lossless), the active curves as uint16 / 65535, "
    "both per take.",
    "emodb": "Packed: the best recognised clips that have phone labels, up to 23 a speaker, one FLAC "
    "(lossless) a speaker; index.json gives each clip's samples, emotion, text and phone labels.",
    "livelinkface_rom": "Packed: the 52 ARKit weights as uint16 / 65535.",
    "speech_english": "Packed: jfk.wav only, as FLAC (lossless).",
}


def pack_deltas(deltas: np.ndarray) -> np.ndarray:
    """Packs (K, V, 3) deltas in cm into bytes; `freetalk.corpus.assets.unpack_deltas` undoes it."""
    steps = np.round(np.asarray(deltas, np.float64).transpose(0, 2, 1) / STEP_CM).astype(np.int32)
    diff = np.diff(steps, axis=-1, prepend=0)
    zigzag = ((diff << 1) ^ (diff >> 31)).astype(np.uint32)
    if zigzag.max() > 0xFFFF:
        raise ValueError("a delta exceeds what 16 bits hold at this step")
    return np.stack([(zigzag & 255).astype(np.uint8), (zigzag >> 8).astype(np.uint8)])


def pack_face_model(source: Path, out: Path) -> None:
    model = np.load(source / "ict_facekit.npz")
    quads = model["faces"].copy()
    quads[quads < 0] = 0xFFFF
    np.savez_compressed(
        out / "faces.npz",
        neutral_cm=model["neutral"].astype(np.float32),
        quads=quads.astype(np.uint16),
        expression=pack_deltas(model["expr"]),
        expression_names=np.array([str(name) for name in model["expr_names"]]),
        identity=pack_deltas(model["identity"][:, :FACE_VERTICES].astype(np.float32)),
        landmarks68=model["landmarks68"].astype(np.uint16),
        step_cm=np.float64(STEP_CM),
    )


def pack_facegood(source: Path, out: Path) -> None:
    names = [line.strip() for line in (source / "bs_names.txt").read_text().splitlines()]
    for take in TAKES:
        audio, rate = sf.read(source / "wav" / f"{take}.wav", dtype="int16")
        sf.write(out / f"{take}.flac", audio, rate, subtype="PCM_16")
        curves = np.clip(np.load(source / "curves" / f"{take}.npz")["weights"], 0.0, 1.0)
        active = np.flatnonzero(curves.max(axis=0) > 0.01)
        np.savez_compressed(
            out / f"{take}.npz",
            weights=np.round(curves[:, active] * 65535).astype(np.uint16),
            names=np.array([names[i] for i in active]),
            fps=np.float64(30.0),
        )
    shutil.copy(source / "arkit_map.json", out / "arkit_map.json")


def pack_livelink(source: Path, out: Path) -> None:
    with (source / "alex_rom_3.csv").open(newline="") as file:
        header, *rows = list(csv.reader(file))
    names = header[2:54]
    weights = np.array([[float(x) for x in row[2:54]] for row in rows if len(row) >= 54])
    np.savez_compressed(
        out / "rom.npz",
        weights=np.round(np.clip(weights, 0, 1) * 65535).astype(np.uint16),
        names=np.array(names),
        fps=np.float64(30.0),
    )


def read_labels(path: Path) -> list[tuple[float, str]]:
    """(end in seconds, label) of a label file; modifiers are dropped, a bare modifier keeps the label."""
    labels: list[tuple[float, str]] = []
    for line in path.read_text(encoding="latin-1").split("#\n", 1)[-1].splitlines():
        fields = line.split()
        if len(fields) < 2:
            continue
        label = fields[2] if len(fields) > 2 else ""
        if label[:1] in ("", "+", "-") and labels:
            label = labels[-1][1]
        if labels and labels[-1][1] == label:
            labels.pop()
        labels.append((float(fields[0]), label))
    return labels


def pack_emodb(source: Path, out: Path) -> None:
    with (source / "index.csv").open(newline="", encoding="utf-8") as file:
        rows = sorted(csv.DictReader(file), key=lambda r: -float(r["recognised_pct"] or 0))
    index: list[dict[str, object]] = []
    for speaker in sorted({row["speaker"] for row in rows}):
        chosen: dict[str, int] = {}
        pieces, start = [], 0
        for row in (r for r in rows if r["speaker"] == speaker):
            labels = sorted((source / "lablaut").glob(row["file"][:7] + "*"))
            phones = read_labels(labels[0]) if labels else []
            full = sum(chosen.values()) >= CLIPS_A_SPEAKER
            if full or len(phones) < 12 or chosen.get(row["emotion"], 0) >= CLIPS_AN_EMOTION:
                continue
            audio, rate = sf.read(source / "wav" / row["file"], dtype="int16")
            audio = audio[: int(min(2.0, phones[-1][0] + 0.05) * rate)]
            chosen[row["emotion"]] = chosen.get(row["emotion"], 0) + 1
            entry = {"clip": row["file"][:-4], "speaker": speaker, "emotion": row["emotion"]}
            entry |= {"text": row["text"], "start": start, "samples": len(audio), "phones": phones}
            index.append(entry)
            pieces.append(audio)
            start += len(audio)
        sf.write(out / f"{speaker}.flac", np.concatenate(pieces), rate, subtype="PCM_16")
    (out / "index.json").write_text(json.dumps(index, ensure_ascii=False))


def pack_speech(source: Path, out: Path) -> None:
    audio, rate = sf.read(source / "jfk.wav", dtype="int16")
    sf.write(out / "jfk.flac", audio, rate, subtype="PCM_16")


PACKERS = {
    "ict_facekit": pack_face_model,
    "facegood_audio2face": pack_facegood,
    "livelinkface_rom": pack_livelink,
    "emodb": pack_emodb,
    "speech_english": pack_speech,
}


def write_manifest(out: Path) -> int:
    files = sorted(p for p in out.rglob("*") if p.is_file() and p.name not in ("manifest.json",))
    entries = [
        {
            "path": path.relative_to(out).as_posix(),
            "bytes": path.stat().st_size,
            "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        }
        for path in files
        if "__pycache__" not in path.parts
    ]
    total = sum(int(entry["bytes"]) for entry in entries)
    text = json.dumps({"total_bytes": total, "files": entries}, indent=1)
    (out / "manifest.json").write_text(text + "\n")
    return total


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--source", type=Path, required=True)
    root = Path(__file__).resolve().parents[1]
    parser.add_argument("--out", type=Path, default=root / "python/freetalk/assets")
    args = parser.parse_args()
    for name, pack in PACKERS.items():
        source, out = args.source / name, args.out / name
        out.mkdir(parents=True, exist_ok=True)
        pack(source, out)
        shutil.copyfile(source / "LICENSE", out / "LICENSE")
        (out / "SOURCE.txt").write_text(
            (source / "SOURCE.txt").read_text().rstrip() + "\n" + NOTES[name] + "\n"
        )
    print(f"{args.out}: {write_manifest(args.out) / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
