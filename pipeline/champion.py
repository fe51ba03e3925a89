"""Lists the versions of the likelihood model, or makes one champion: mrtask champion [VERSION] [tracking.uri=...]

Evaluations use the champion. Without a version, this lists all of them: what each was trained on, its figures, and why
it became champion or did not. With one, it rolls back to that version, or forward to it.
"""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from omegaconf import OmegaConf

from pipeline.app import tool
from pipeline.base.config import CONF_DIR, UserError
from pipeline.base.sections import Tracking

if TYPE_CHECKING:
    from pipeline.backends import registry

FIGURES = ("log_loss", "brier", "roc_auc")
"""Those that are listed, where a training logged them."""


def main(arguments: Sequence[str]) -> None:
    """List the versions, or make the one on the command line champion."""
    numbers = [one for one in arguments if "=" not in one]
    given = tool.overrides([one for one in arguments if "=" in one])
    if len(numbers) > 1 or not all(one.isdecimal() for one in numbers):
        raise UserError(f"{' '.join(numbers)}: give one version, as in mrtask champion 3, or none to list them")
    if unknown := given.keys() - {f"tracking.{name}" for name in Tracking.model_fields}:
        raise UserError(f"{', '.join(sorted(unknown))}: no such key; allowed: tracking.uri, tracking.experiment_name")
    configured = OmegaConf.to_container(OmegaConf.load(CONF_DIR / "tracking" / "local.yaml"), resolve=True)
    assert isinstance(configured, dict)
    wanted = {str(key): value for key, value in configured.items()}
    tracking = Tracking(**wanted | {key.partition(".")[2]: value for key, value in given.items()})

    from pipeline.backends import registry, runs  # MLflow takes seconds to import

    store = runs.open_tracking(tracking.uri, tracking.experiment_name)
    if numbers:
        registry.set_champion(store, numbers[0])
        print(f"version {numbers[0]} is champion now")
    for line in _lines(registry.versions(store)):
        print(line)


def _lines(versions: Sequence["registry.Version"]) -> Iterator[str]:
    if not versions:
        raise UserError("no model is registered yet; python -m pipeline.train trains one")
    for one in versions:
        known = {name: one.metrics[f"test_{name}"] for name in FIGURES if f"test_{name}" in one.metrics}
        figures = ", ".join(f"{name} {value:.4f}" for name, value in known.items())
        mark = "champion" if one.champion else ""
        yield f"{one.number:>4} {mark:8} {one.kind:12} rows {one.dataset[:12]}  {figures}"
        yield f"     {one.promotion}"


if __name__ == "__main__":
    tool.main(main, __doc__)
