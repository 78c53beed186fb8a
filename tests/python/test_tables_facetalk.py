"""FaceTalk's tables: every row trains, codes are scored by what they move and how they vary."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from mini_corpus import write_mini_corpus

from freetalk import metrics
from freetalk.evaluate.facetalk import SpeechToCodes
from freetalk.tables import main
from freetalk.tables.definitions import Recipes
from freetalk.tables.facetalk import TABLES
from freetalk.tables.scoring import encoder_folder
from freetalk.tables.sets import Catalogue
from freetalk.tables.sizes import SIZES, TINY

NEUTRAL = ("VOCASET", "BIWI", "Multiface")


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_mini_corpus(tmp_path_factory.mktemp("tables") / "corpus")


@pytest.mark.slow
def test_rows_are_trained_and_judged(corpus: Path, tmp_path: Path) -> None:
    arguments = ["--size=tiny", f"--work={tmp_path / 'work'}", f"--out={tmp_path / 'out'}"]
    arguments += [f"--data={name}={corpus}" for name in NEUTRAL]
    rows = ["full", "no diffusion", "still face"]
    assert main("facetalk_2", [*arguments, "--rows", *rows]) == 0
    result = json.loads((tmp_path / "out/facetalk_2.json").read_text())
    scores = {row["name"]: row["scores"]["all"] for row in result["rows"]}
    assert list(scores) == rows
    assert all(scores[name]["lve"]["mean"] > 0 for name in rows)
    assert scores["full"]["diversity"]["mean"] > 0
    assert scores["no diffusion"]["diversity"]["mean"] == 0
    assert "diversity" not in scores["still face"]
    assert {claim["metric"] for claim in result["claims"]} == {"lve", "diversity"}
    text = (tmp_path / "out/facetalk_2.md").read_text()
    assert "no diffusion: samples vary less than full" in text

    # A row's diversity is Eq. 20 of its weights' codes.
    catalogue = Catalogue([f"{name}={corpus}" for name in NEUTRAL], {})
    view = catalogue.view("BIWI", TINY.ats)
    run = next(row for row in result["rows"] if row["name"] == "full")["runs"][0]
    key = run["trainings"][0]["key"]
    weights = tmp_path / f"work/tiny/trainings/facetalk-{key}/facetalk"
    model = SpeechToCodes(encoder_folder(""), weights, TINY.sampler)
    clip = view.sequences("test")[0]
    codes = model.codes(model.heard(view, clip), range(4))
    expected = float(metrics.diversity(codes[None])[0])
    found = run["clips"]["BIWI"]["values"]["diversity"][clip.id]
    assert found == pytest.approx(expected, rel=1e-3)
    pairs = [torch.linalg.norm(codes[j] - codes[k]) for j in range(4) for k in range(4) if j != k]
    assert expected == pytest.approx(float(sum(pairs)) / 4, rel=1e-5)


def test_rows_are_the_papers() -> None:
    recipes = Recipes(SIZES["small"], 0)
    names = {
        table: [row.name for row in TABLES[table](recipes, ()).rows]
        for table in ("facetalk_2", "facetalk_3", "facetalk_5")
    }
    assert names["facetalk_2"][:2] == ["full", "no amplitude augmentation"]
    assert names["facetalk_3"] == ["weights", "weights, no diffusion", "still face"]
    assert names["facetalk_5"][-2:] == ["film", "still face"]
    both = TABLES["facetalk_3"](recipes, ("weights", "head"))
    assert [row.name for row in both.rows][2:4] == ["head", "head, no diffusion"]
    with pytest.raises(ValueError, match="weights and head"):
        TABLES["facetalk_3"](recipes, ("flame",))
    full = TABLES["facetalk_2"](recipes, ()).rows[0]
    film = TABLES["facetalk_5"](recipes, ()).rows[4]
    assert full.facetalk == film.facetalk  # one training serves both
