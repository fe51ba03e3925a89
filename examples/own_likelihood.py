"""A likelihood of your own: a function of three names, or a language model behind an OpenAI-compatible chat API.

`python examples/own_likelihood.py`, or with vLLM, llama.cpp, Ollama and the like
`python examples/own_likelihood.py http://localhost:8000/v1 my-model answers.json`.

A key for the API is taken from the environment, OPENAI_API_KEY. Answers are kept in the file given as a third argument.
"""

import json
import os
import re
import sys
from pathlib import Path

import requests

from mrtask import FunctionModel, InputError, generate_homes, run_experiment

TIMEOUT_S = 60
QUESTION = (
    "In a home with a {container} in the {room}: how likely is it that a {object} is in or on it? "
    "Answer with one number between 0 and 1 and nothing else."
)
PLACES = {"Kitchen": {"Apple", "Bread", "Egg", "Mug", "Pot"}, "Bathroom": {"SoapBar", "ToiletPaper", "Towel"}}


def by_room(obj: str, container: str, room: str) -> float:
    """A rule of thumb: some things belong to one room, the rest may be anywhere."""
    if obj in PLACES.get(room, ()):
        return 0.3
    return 0.01 if any(obj in names for names in PLACES.values()) else 0.05


class ChatLikelihood:
    """Asks a chat model for each (object, container, room) once and keeps the answers in a file."""

    def __init__(self, url: str, model: str, answers: Path | None = None) -> None:
        self.url, self.model, self.answers = url.rstrip("/") + "/chat/completions", model, answers
        self.known: dict[str, float] = json.loads(answers.read_text()) if answers and answers.is_file() else {}

    def __call__(self, obj: str, container: str, room: str) -> float:
        """The probability that the model answers with."""
        question = QUESTION.format(object=obj, container=container, room=room)
        if question not in self.known:
            self.known[question] = self._ask(question)
            if self.answers:
                self.answers.write_text(json.dumps(self.known, indent=1))
        return self.known[question]

    def _ask(self, question: str) -> float:
        key = os.environ.get("OPENAI_API_KEY")
        answer = requests.post(
            self.url,
            json={"model": self.model, "temperature": 0, "messages": [{"role": "user", "content": question}]},
            headers={"Authorization": f"Bearer {key}"} if key else {},
            timeout=TIMEOUT_S,
        )
        answer.raise_for_status()
        text = answer.json()["choices"][0]["message"]["content"]
        found = re.search(r"\d*\.?\d+", text)
        if found is None or not 0.0 <= float(found[0]) <= 1.0:
            raise InputError(f"{self.model} was to answer with a number between 0 and 1, it said {text!r}")
        return float(found[0])


def main(arguments: list[str]) -> None:
    """Compares planners under the likelihood."""
    answers = Path(arguments[2]) if len(arguments) > 2 else None
    function = ChatLikelihood(arguments[0], arguments[1], answers) if arguments else by_room
    episodes = run_experiment(
        list(generate_homes(count=2, seed=1000, size_classes=["small"])),
        ["nonlearned_myopic", "learned_myopic", "greedy"],
        FunctionModel(function),
        robots=[1],
        trials_per_cell=3,
    )
    print(episodes.groupby("planner").cost_s.agg(["count", "mean"]).round(1))


if __name__ == "__main__":
    main(sys.argv[1:])
