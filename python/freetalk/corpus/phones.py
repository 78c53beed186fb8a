"""Phones of espeak-ng, flite and Emo-DB as ARPABET without stress (AX is schwa, sil a pause).

flite speaks ARPABET in lower case (`pau` is a pause). espeak-ng's mnemonics are mapped by the table below; a mnemonic that
stands for two ARPABET phones (a rhotic diphthong, a syllabic l) is divided in two at the middle. Emo-DB's narrow German labels are
mapped to the ARPABET phone whose lips look most alike (front rounded vowels to UW, UH and ER); a stop's release, `!p` or
`pasp`, is HH: the lips are no longer closed.
"""

from __future__ import annotations

from dataclasses import dataclass

ESPEAK_TO_ARPABET: dict[str, tuple[str, ...]] = {
    "i:": ("IY",), "i": ("IY",), "I": ("IH",), "I2": ("IH",), "I#": ("IH",), "E": ("EH",), "E2": ("EH",),
    "e": ("EH",), "a": ("AE",), "aa": ("AE",), "a2": ("AE",), "A:": ("AA",), "A": ("AA",), "0": ("AA",),
    "O:": ("AO",), "O": ("AO",), "O2": ("AO",), "o:": ("AO",), "U": ("UH",), "u:": ("UW",), "u": ("UW",), "V": ("AH",),
    "3": ("ER",), "3:": ("ER",), "@": ("AX",), "@2": ("AX",), "@5": ("AX",), "@-": ("AX",), "a#": ("AX",),
    "eI": ("EY",), "aI": ("AY",), "aI2": ("AY",), "aI3": ("AY",), "OI": ("OY",), "aU": ("AW",), "oU": ("OW",),
    "@L": ("AX", "L"), "A@": ("AA", "R"), "O@": ("AO", "R"), "o@": ("AO", "R"), "e@": ("EH", "R"), "i@": ("IH", "AX"),
    "i@3": ("IH", "ER"), "U@": ("UH", "ER"), "aI@": ("AY", "ER"), "aU@": ("AW", "ER"), "VR": ("AH", "R"), "IR": ("IH", "R"),
    "p": ("P",), "b": ("B",), "m": ("M",), "f": ("F",), "v": ("V",), "T": ("TH",), "D": ("DH",), "t": ("T",),
    "t#": ("T",), "t2": ("T",), "t[": ("T",), "d": ("D",), "n": ("N",), "n-": ("N",), "l": ("L",), "l#": ("L",),
    "s": ("S",), "z": ("Z",), "S": ("SH",), "Z": ("ZH",), "tS": ("CH",), "dZ": ("JH",), "k": ("K",), "g": ("G",),
    "N": ("NG",), "h": ("HH",), "x": ("HH",), "?": ("HH",), "r": ("R",), "r-": ("R",), "r#": ("R",), "j": ("Y",),
    ";": ("Y",), "w": ("W",), "w#": ("W",), "_": ("sil",), "_:": ("sil",), "_|": ("sil",), "_!": ("sil",), "": ("sil",),
}  # fmt: skip

EMODB_TO_ARPABET: dict[str, str] = {
    "i": "IY", "I": "IH", "e": "EY", "E": "EH", "a": "AA", "A": "AA", "o": "OW", "O": "AO", "u": "UW", "U": "UH", "y": "UW",
    "Y": "UH", "2": "UH", "9": "ER", "@": "AX", "6": "AX", "4": "AX", "aI": "AY", "aU": "AW", "AU": "AW", "aO": "AW",
    "ao": "AW", "AO": "AW", "OY": "OY", "OU": "OW", "i6": "IY", "I6": "IH", "E6": "EH", "a6": "AA", "Y6": "UH", "p": "P",
    "b": "B", "m": "M", "B": "W", "f": "F", "v": "V", "V": "V", "t": "T", "d": "D", "n": "N", "l": "L", "L": "L", "s": "S",
    "z": "Z", "S": "SH", "C": "Y", "j": "Y", "k": "K", "g": "G", "G": "G", "N": "NG", "NN": "NG", "x": "HH", "X": "HH",
    "h": "HH", "H": "HH", "R": "HH", "D": "DH", "?": "HH", ".": "sil", "(": "sil", "(gef": "sil", "": "sil",
}  # fmt: skip

ARPABET = frozenset(phone for phones in ESPEAK_TO_ARPABET.values() for phone in phones)
VOWELS = frozenset(
    ("IY", "IH", "EH", "AE", "AA", "AO", "UH", "UW", "AH", "ER", "AX", "EY", "AY", "OY", "AW", "OW")
)
BILABIALS = frozenset("PBM")
LABIODENTALS = frozenset("FV")


@dataclass(frozen=True)
class Phone:
    """A phone and its interval in seconds."""

    start_s: float
    end_s: float
    label: str


def espeak_label(mnemonic: str) -> tuple[str, ...]:
    """ARPABET of an espeak-ng mnemonic; an unknown one falls back to its longest known prefix, then to AX."""
    for length in range(len(mnemonic), 0, -1):
        if mnemonic[:length] in ESPEAK_TO_ARPABET:
            return ESPEAK_TO_ARPABET[mnemonic[:length]]
    return ("sil",) if not mnemonic else ("AX",)


def flite_label(name: str) -> str:
    """ARPABET of a flite segment name."""
    label = name.upper()
    return label if label in ARPABET else "sil"


def emodb_label(label: str) -> str:
    """ARPABET of an Emo-DB label: `_p` is the closure of p, `!p` and `pasp` its release."""
    if label.startswith("!") or label.endswith("asp"):
        return "HH"
    label = label.removeprefix("_")
    return EMODB_TO_ARPABET.get(label, EMODB_TO_ARPABET.get(label[:1], "AX"))


def merge(phones: list[Phone]) -> list[Phone]:
    """Drops empty intervals and joins adjacent pauses."""
    merged: list[Phone] = []
    for phone in phones:
        if phone.end_s - phone.start_s < 1e-4:
            continue
        if merged and phone.label == "sil" == merged[-1].label:
            merged[-1] = Phone(merged[-1].start_s, phone.end_s, "sil")
        else:
            merged.append(phone)
    return merged
