"""Every kind of model behind the one seam: stored and loaded alike, defined for any names, damage noticed."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from mrtask.likelihood.kinds import KINDS, load_model
from mrtask.likelihood.model import PROB_FLOOR, ModelError
from mrtask.likelihood.options import NetworkOptions, TrainingOptions
from mrtask.likelihood.training import train_model

WEIRD = ["", " ", "遥控器", "télécommande", "🛋️", "\ud800", "NA", "x" * 10_000, 'a,b\n"c"', "RemoteControl", "null\0"]


@pytest.fixture(scope="module")
def models(made_up_dataset, embedding_cache):
    network = NetworkOptions(layers=(16, 8), max_epochs=10, device="cpu", threads=1)
    return {
        kind: train_model(made_up_dataset, TrainingOptions(kind, network=network, cache_dir=embedding_cache)).model
        for kind in KINDS
    }


@pytest.fixture(params=KINDS)
def model(models, request):
    return models[request.param]


def names(objects, container="Bed", room="Bedroom"):
    return pd.DataFrame({"object": objects, "container": container, "room": room}, dtype="str")


def test_stored_and_loaded_it_says_the_same(model, made_up_dataset, tmp_path, embedding_cache):
    model.save(tmp_path / "model")
    again = load_model(tmp_path / "model", embedding_cache)
    asked = pd.concat([made_up_dataset.triples("test"), names(["Duvet", "Carrot"])])
    assert again.kind == model.kind
    assert np.array_equal(again.predict(asked), model.predict(asked))
    assert {path.suffix for path in (tmp_path / "model").iterdir()} <= {".json", ".safetensors", ".csv"}


def test_any_string_is_a_name(model):
    for column in ("object", "container", "room"):
        asked = pd.DataFrame({"object": "Mug", "container": "Bed", "room": "Bedroom"} | {column: WEIRD}, dtype=object)
        probs = model.predict(asked)
        assert probs.shape == (len(WEIRD),) and probs.dtype == np.float64
        assert ((probs >= PROB_FLOOR) & (probs <= 1 - PROB_FLOOR)).all()


def test_each_row_is_judged_by_itself(model, made_up_dataset):
    asked = made_up_dataset.triples("test").iloc[[3, 8, 3, 0]]
    assert model.predict(asked) == pytest.approx(
        np.concatenate([model.predict(asked.iloc[[i]]) for i in range(4)]), rel=1e-5
    )


def test_no_rows(model):
    assert model.predict(names([])).shape == (0,)


def test_what_are_no_names_is_refused(model):
    with pytest.raises(ValueError, match=r"columns \['room'\] are missing; a likelihood model needs"):
        model.predict(pd.DataFrame({"object": ["Mug"], "container": ["Bed"]}))
    with pytest.raises(ValueError, match=r"column 'object' must hold strings, got None"):
        model.predict(pd.DataFrame({"object": [None], "container": ["Bed"], "room": ["Bedroom"]}, dtype=object))


def test_names_that_look_like_nothing_survive_storage(models, tmp_path, home_of):
    from mrtask.likelihood.frequency import FrequencyModel

    triples = pd.DataFrame(
        {"object": ["NA", "null", "1.0"], "container": "None", "room": 'a,"b', "positives": [1, 5, 9], "count": 10}
    )
    model = FrequencyModel(triples)
    model.save(tmp_path / "model")
    assert np.array_equal(load_model(tmp_path / "model").predict(triples), model.predict(triples))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("damage", ["truncated", "one byte", "missing"])
def test_damaged_files_are_refused(models, tmp_path, kind, damage):
    models[kind].save(tmp_path / "model")
    [data] = [path for path in (tmp_path / "model").iterdir() if path.name != "model.json"]
    content = data.read_bytes()
    if damage == "missing":
        data.unlink()
    else:
        flipped = content[:-5] + bytes([content[-5] ^ 1]) + content[-4:]
        data.write_bytes(content[: len(content) // 2] if damage == "truncated" else flipped)
    with pytest.raises(ModelError, match=rf"{data.name} is missing or damaged .* roll back to another version"):
        load_model(tmp_path / "model")


def edit(folder: Path, **changes: object) -> None:
    path = folder / "model.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


def test_descriptions_that_cannot_be_used(models, tmp_path):
    folder = tmp_path / "model"
    with pytest.raises(ModelError, match=r"no likelihood model in .*model: model.json is missing; train one first"):
        load_model(folder)
    models["frequency"].save(folder)
    edit(folder, kind="oracle")
    with pytest.raises(ModelError, match="unknown kind of model 'oracle'"):
        load_model(folder)
    edit(folder, format_version=2)
    with pytest.raises(ModelError, match="format version 2, this code reads 1"):
        load_model(folder)
    (folder / "model.json").write_text('{"kind": ')
    with pytest.raises(ModelError, match=r"model.json is damaged"):
        load_model(folder)
