"""Viseme labels, forced alignments and the linear probe."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import soundfile
import torch

from freetalk.audio import load_audio
from freetalk.cli import main
from freetalk.corpus import speech_clip
from freetalk.corpus.alignment import (
    align_speech,
    alignment_json,
    hurried_share,
    phones_of,
    read_alignments,
    read_transcripts,
    recognised_words,
    spoken_words,
)
from freetalk.corpus.phones import ARPABET, Phone
from freetalk.evaluate.viseme_probe import (
    SILENCE,
    VISEMES,
    confusion_matrix,
    fit_probe,
    probe_layer,
    scores_of,
    viseme_labels,
)
from freetalk.speech import SpeechEncoder, hubert_tiny

# What pocketsphinx gives for half a second in which "map" is said: name, start, duration in frames of 10 ms.
STORED = [("SIL", 0, 5), ("M", 5, 8), ("AE", 13, 12), ("P", 25, 9), ("+NSN+", 34, 4)]


def stored() -> list[SimpleNamespace]:
    return [SimpleNamespace(name=n, start=s, duration=d) for n, s, d in STORED]


def test_every_phone_has_one_viseme_class() -> None:
    phones = [phone for group in VISEMES.values() for phone in group]
    assert sorted(phones) == sorted(ARPABET) and len(VISEMES) == 12


def test_labels_follow_the_phones_and_are_silence_outside() -> None:
    phones = [Phone(0.1, 0.2, "B"), Phone(0.2, 0.4, "UW"), Phone(0.5, 0.6, "Z")]
    labels = viseme_labels(phones, [0.0, 0.1, 0.199, 0.2, 0.39, 0.45, 0.55, 0.6, 9.0])
    names = [list(VISEMES)[k] for k in labels]
    quiet, round_ = "silence", "r w uw uh ow er"
    assert names == [quiet, "p b m", "p b m", round_, round_, quiet, "s z", quiet, quiet]
    assert (viseme_labels([], [0.0, 1.0]) == SILENCE).all()


def test_an_alignment_becomes_contiguous_phones() -> None:
    phones = phones_of(stored(), duration_s=0.5)
    assert [p.label for p in phones] == ["sil", "M", "AE", "P", "sil"]
    edges = [0.0, *(p.end_s for p in phones)]
    np.testing.assert_allclose(
        edges, [0, 0.05, 0.13, 0.25, 0.34, 0.5], atol=1e-9
    )  # noise joins the pause
    assert [p.start_s for p in phones] == edges[:-1]
    with pytest.raises(ValueError, match=r"phone AE at 0\.13 s begins before the last one ends"):
        phones_of([stored()[3], stored()[2]], 0.5)


def test_alignments_survive_their_file(tmp_path: Path) -> None:
    phones = phones_of(stored(), 0.5)
    file = tmp_path / "phones.json"
    file.write_text(alignment_json({"a.wav": phones, "b.wav": []}))
    assert read_alignments(file) == {"a.wav": phones, "b.wav": []}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[1, 2]", "not JSON of recordings"),
        ('{"a": [[0.0, 0.1]]}', "not JSON of recordings"),
        ('{"a": [[0.2, 0.1, "P"]]}', "out of order"),
        ('{"a": [[0.0, 0.2, "P"], [0.1, 0.3, "T"]]}', "out of order"),
        ('{"a": [[0.0, 0.2, "AA1"]]}', "'AA1' is no ARPABET without stress"),
    ],
)
def test_alignments_that_make_no_sense_are_refused(
    tmp_path: Path, content: str, message: str
) -> None:
    file = tmp_path / "phones.json"
    file.write_text(content)
    with pytest.raises(ValueError, match=message):
        read_alignments(file)


def test_transcripts_are_read_in_both_forms(tmp_path: Path) -> None:
    file = tmp_path / "metadata.csv"
    file.write_text("a.wav|It is so.\n\nLJ1|in 1455,|in fourteen fifty-five,\n")
    assert read_transcripts(file) == {"a.wav": "It is so.", "LJ1": "in fourteen fifty-five,"}
    file.write_text("a.wav|It is so.\nb.wav\n")
    with pytest.raises(ValueError, match="line 2 is not RECORDING"):
        read_transcripts(file)


def test_words_are_those_of_a_dictionary() -> None:
    words = spoken_words("\u2019Thy self-substantial mak\u2019st, caf\u00e9!\u2019")
    assert words == ["thy", "self", "substantial", "mak'st", "cafe"]
    with pytest.raises(ValueError, match="write numbers out as words"):
        spoken_words("in 1455")
    with pytest.raises(ValueError, match="no words"):
        spoken_words("...")


def test_a_real_recording_is_aligned_with_its_text() -> None:
    samples = np.array(load_audio(speech_clip()).samples)
    text = "And so my fellow Americans, ask not what your country can do for you"
    clip = samples[: int(7.6 * 16000)]
    phones = align_speech(clip, text)
    assert phones[0].start_s == 0 and phones[-1].end_s == pytest.approx(7.6)
    assert all(a.end_s == b.start_s for a, b in zip(phones, phones[1:]))
    # He pauses for over a second after "Americans" and after "ask not": where nothing is said it is quiet.
    energy = np.square(clip)
    loud = [energy[int(p.start_s * 16000) : int(p.end_s * 16000)].mean() for p in phones]
    vowels = [e for p, e in zip(phones, loud) if p.label in ("AE", "AA", "AH", "EH", "OW", "UW")]
    pauses = [e for p, e in zip(phones, loud) if p.label == "sil" and p.end_s - p.start_s > 0.3]
    assert len(pauses) >= 2 and max(pauses) < 0.1 * np.median(vowels)


def test_a_text_that_is_not_said_is_refused() -> None:
    clip = np.array(load_audio(speech_clip()).samples)[: 4 * 16000]
    other = (
        "especially as no more time is occupied in casting setting or printing beautiful letters"
    )
    with pytest.raises(RuntimeError, match=r"does not fit the recording|something else seems"):
        align_speech(clip, other)
    assert hurried_share(stored()) == 0
    hurried = [SimpleNamespace(name=n, start=s, duration=3) for n, s, _ in STORED]
    assert hurried_share([*stored()[:2], *hurried[2:]]) == pytest.approx(2 / 3)  # of M, AE, P


def test_a_probe_finds_what_is_linearly_there_and_nothing_else() -> None:
    generator = torch.Generator().manual_seed(0)
    labels = torch.randint(0, 12, (6000,), generator=generator)
    # Two far directions carry chance; the class lies in twelve small ones, which standardising has to bring out.
    signal = 1e-3 * (torch.eye(12)[labels] + 0.15 * torch.randn(6000, 12, generator=generator))
    noise = 100 * torch.randn(6000, 2, generator=generator)
    features = torch.cat([noise, signal], dim=1)
    probe = fit_probe(features[:4000], labels[:4000].numpy())
    held_out = labels[4000:].numpy()
    found = scores_of(confusion_matrix(held_out, probe.predict(features[4000:])))
    assert found["accuracy"] > 0.99 and found["frames"] == 2000
    # The parity of two signs: no line separates it, so a linear probe stays at chance.
    signs = torch.randn(6000, 2, generator=generator)
    parity = (signs[:, 0] * signs[:, 1] > 0).long().numpy()
    blind = fit_probe(signs[:4000], parity[:4000], num_classes=2)
    assert abs((blind.predict(signs[4000:]) == parity[4000:]).mean() - 0.5) < 0.05


def test_weights_decide_whose_labels_a_probe_believes() -> None:
    labels = np.array([0] * 90 + [1] * 10)
    alike = fit_probe(torch.zeros(100, 1), labels, num_classes=2)
    assert (alike.predict(torch.zeros(5, 1)) == 0).all()
    trusted = torch.tensor([1.0] * 90 + [30.0] * 10)
    believed = fit_probe(torch.zeros(100, 1), labels, trusted, num_classes=2)
    assert (believed.predict(torch.zeros(5, 1)) == 1).all()


def test_scores_without_silence_leave_its_frames_out() -> None:
    counts = np.zeros((12, 12), dtype=np.int64)
    counts[0, 0], counts[0, SILENCE], counts[SILENCE, SILENCE], counts[SILENCE, 0] = 3, 1, 10, 6
    found = scores_of(counts)
    assert found["accuracy"] == pytest.approx(13 / 20)
    assert found["accuracy_speech"] == pytest.approx(3 / 4)
    assert found["largest_class"] == pytest.approx(16 / 20)
    assert found["recall"]["p b m"] == pytest.approx(3 / 4)
    assert found["recall"]["silence"] == pytest.approx(10 / 16)


def tones(seed: int) -> tuple[np.ndarray, list[Phone]]:
    """Three seconds in which each class of three sounds like itself."""
    rng = np.random.default_rng(seed)
    times = np.arange(4800) / 16000
    hertz = {"S": 3000.0, "AA": 300.0, "sil": 0.0}
    labels = [str(rng.choice(list(hertz))) for _ in range(10)]
    pieces = [np.sin(2 * np.pi * hertz[label] * times + rng.uniform(0, 6)) for label in labels]
    wave = np.concatenate([p * (h != "sil") for p, h in zip(pieces, labels)])
    phones = [Phone(0.3 * k, 0.3 * (k + 1), label) for k, label in enumerate(labels)]
    return (0.2 * wave + 1e-3 * rng.standard_normal(len(wave))).astype(np.float32), phones


def test_even_a_random_encoder_tells_tones_apart_at_the_right_moments() -> None:
    torch.manual_seed(0)
    encoder = SpeechEncoder(hubert_tiny()).eval()
    fit = {f"fit{k}": tones(k) for k in range(12)}
    held = {f"held{k}": tones(100 + k) for k in range(4)}
    shifted = {
        name: (wave, [Phone(p.start_s + 0.15, p.end_s + 0.15, p.label) for p in phones])
        for name, (wave, phones) in held.items()
    }
    result = probe_layer(encoder, 0, fit, {}, {"held": held, "shifted": shifted})
    # Frames that see two tones at once are the rest: 0.055 s of every 0.3 s.
    assert result["sets"]["held"]["accuracy"] > 0.85
    assert result["sets"]["shifted"]["accuracy"] < result["sets"]["held"]["accuracy"] - 0.15
    assert result["fitted_on"]["synthetic"] > 1500 and result["fitted_on"]["recorded"] == 0
    assert set(result["sets"]["held"]["recordings"]) == set(held)


def test_the_command_writes_figures_and_a_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import soundfile
    from mini_corpus import write_mini_corpus

    corpus = write_mini_corpus(tmp_path / "corpus")
    torch.manual_seed(0)
    SpeechEncoder(hubert_tiny()).save_pretrained(tmp_path / "encoder")
    wave, phones = tones(0)
    (tmp_path / "real").mkdir()
    soundfile.write(tmp_path / "real" / "a.wav", wave, 16000)
    (tmp_path / "real" / "phones.json").write_text(alignment_json({"a.wav": phones}))
    real = str(tmp_path / "real" / "phones.json")
    arguments = ["--data", corpus, "--encoder", tmp_path / "encoder", "--out", tmp_path / "out"]
    arguments += ["--fit", real, "--held-out", f"tones={real}", "--layers", "0", "-1"]
    assert main(["speech", "probe", *map(str, arguments)]) == 0
    report = json.loads((tmp_path / "out" / "probe.json").read_text())
    assert [entry["layer"] for entry in report["layers"]] == [0, -1]
    assert set(report["layers"][0]["sets"]) == {"synthetic test voices", "tones"}
    assert report["layers"][0]["fitted_on"]["recorded"] == 149  # 3 s, 20 ms a frame
    assert "tones" in capsys.readouterr().out
    for layer in (0, -1):
        assert (tmp_path / "out" / f"probe_{layer}.png").read_bytes().startswith(b"\x89PNG")
    assert main(["speech", "probe", *map(str, arguments[:-2]), "7"]) == 2
    assert "--layers 7: the encoder's hidden states are -1 to" in capsys.readouterr().err


def test_recordings_that_do_not_fit_are_left_out_of_an_alignment(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = np.array(load_audio(speech_clip()).samples)[: int(7.6 * 16000)]
    for name in ("said", "other"):
        soundfile.write(tmp_path / f"{name}.wav", short, 16000)
    said = "And so my fellow Americans, ask not what your country can do for you"
    other = (
        "as no more time is occupied in casting setting or printing beautiful letters than there"
    )
    lines = tmp_path / "transcripts.psv"
    command = ["speech", "align", "--transcripts", str(lines), "--out", str(tmp_path / "out.json")]
    lines.write_text(f"said.wav|{said}\nother.wav|{other}\n")
    assert main(command) == 0
    assert list(read_alignments(tmp_path / "out.json")) == ["said.wav"]
    told = capsys.readouterr()
    assert "1 left out" in told.out and "other.wav" in told.err
    heard = ["speech", "align", "--audio", str(tmp_path), "--out", str(tmp_path / "heard.json")]
    assert main(heard) == 0
    assert sorted(read_alignments(tmp_path / "heard.json")) == ["other.wav", "said.wav"]
    words, sure = recognised_words(short)
    assert 0.5 < sure <= 1 and {"fellow", "country"} <= set(words.split())
    assert main([*heard, "--least-sure", "1"]) == 2 and "posterior" in capsys.readouterr().err
    silence = np.zeros(16000, np.float32)
    assert recognised_words(silence) == ("", 0.0)
    (tmp_path / "out.json").unlink()
    lines.write_text(f"other.wav|{other}\n")
    assert main(command) == 2
    assert not (tmp_path / "out.json").exists()
