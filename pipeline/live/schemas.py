"""Write the JSON Schema of every message of `pipeline.live`: python -m pipeline.live.schemas [folder]."""

import json
from collections.abc import Sequence
from pathlib import Path

from mrtask.live import messages
from pipeline.app.tool import main

FOLDER = Path(messages.__file__).parent / "schemas"


def run(arguments: Sequence[str]) -> None:
    """Run the tool."""
    folder = Path(arguments[0]) if arguments else FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    for kind, schema in messages.schemas().items():
        (folder / f"{kind}.json").write_text(json.dumps(schema, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(run, __doc__ or "")
