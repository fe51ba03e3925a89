"""The registered model's code, stored beside its weights (MLflow's "models from code"): names in, probabilities out.

MLflow runs this file when the model is loaded, so nothing is unpickled; weights are plain data, their sha256 checked.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from mlflow.models import set_model
from mlflow.pyfunc import PythonModel  # type: ignore[attr-defined]
from numpy.typing import NDArray

from mrtask.likelihood.kinds import load_model
from mrtask.likelihood.model import LikelihoodModel


class LikelihoodPyfunc(PythonModel):
    """``predict(DataFrame[object, container, room])`` -> probabilities ``[N]``."""

    model: LikelihoodModel

    def load_context(self, context: Any) -> None:
        """Read the model from the artifact of that name."""
        self.model = load_model(Path(context.artifacts["model"]))

    def predict(
        self, context: Any, model_input: pd.DataFrame, params: dict[str, Any] | None = None
    ) -> NDArray[np.float64]:
        """Probability of each row's object being in its container."""
        return self.model.predict(model_input)


set_model(LikelihoodPyfunc())
