"""The examples run and show what they say."""

import json
import runpy
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import ModuleType

import pytest

from mrtask import InputError, fit_on_homes, generate_homes, run_experiment
from mrtask.homes.generator.house import generate_house, write_houses

pytestmark = pytest.mark.usefixtures("homes_made_once")
EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def example(name: str) -> ModuleType:
    """An example as a module, not run."""
    module = ModuleType(name)
    module.__dict__.update(runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name=name))
    return module


def test_first_episode(capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(str(EXAMPLES / "first_episode.py"), run_name="__main__")
    first, *letters = capsys.readouterr().out.splitlines()
    assert first.startswith("accepted after ")
    assert sorted(line.split()[5] for line in letters) == ["Apple", "Cup"]


def test_quickstart(capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(str(EXAMPLES / "quickstart.py"), run_name="__main__")
    said = capsys.readouterr().out
    assert "36/36" in said
    rows = [line.split() for line in said.splitlines() if line.split()[:1] in (["small"], ["medium"], ["large"])]
    assert len(rows) == 3 and all(float(value) > 0 for row in rows for value in row[-3:])


def test_own_planner_and_its_option(capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(str(EXAMPLES / "own_planner.py"), run_name="__main__")
    means = {line.rsplit(None, 2)[0]: float(line.split()[-1]) for line in capsys.readouterr().out.splitlines()[2:]}
    assert set(means) == {"nonlearned_myopic", "cautious, 2 %", "cautious, 20 %", "greedy"}
    assert means["cautious, 2 %"] != means["cautious, 20 %"]
    assert means["cautious, 20 %"] < means["nonlearned_myopic"]


class Chat(BaseHTTPRequestHandler):
    """Stands in for a chat model's server."""

    answer = "0.25"
    asked: list[dict[str, object]]

    def do_POST(self) -> None:
        body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        self.asked.append(body | {"path": self.path, "key": self.headers.get("Authorization")})
        content = json.dumps({"choices": [{"message": {"role": "assistant", "content": self.answer}}]}).encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *arguments: object) -> None:
        """Quiet."""


@pytest.fixture
def chat(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    monkeypatch.setenv("OPENAI_API_KEY", "secret")
    monkeypatch.setattr(Chat, "asked", [], raising=False)
    with ThreadingHTTPServer(("127.0.0.1", 0), Chat) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/v1/"
        server.shutdown()


def test_own_likelihood_as_a_function(capsys: pytest.CaptureFixture[str]) -> None:
    example("own_likelihood").main([])
    assert "learned_myopic" in capsys.readouterr().out


def test_own_likelihood_from_a_chat_model(chat: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answers = tmp_path / "answers.json"
    ask = example("own_likelihood").ChatLikelihood(chat, "a-model", answers)
    assert [ask("Mug", "Fridge", "Kitchen"), ask("Mug", "Bed", "Bedroom"), ask("Mug", "Fridge", "Kitchen")] == [
        0.25
    ] * 3
    assert [(one["path"], one["model"], one["key"]) for one in Chat.asked] == [
        ("/v1/chat/completions", "a-model", "Bearer secret")
    ] * 2
    assert "Fridge in the Kitchen" in Chat.asked[0]["messages"][0]["content"]  # type: ignore[index]
    again = example("own_likelihood").ChatLikelihood(chat, "a-model", answers)
    assert again("Mug", "Bed", "Bedroom") == 0.25 and len(Chat.asked) == 2
    monkeypatch.setattr(Chat, "answer", "quite likely")
    with pytest.raises(
        InputError, match=r"a-model was to answer with a number between 0 and 1, it said 'quite likely'"
    ):
        ask("Egg", "Bed", "Bedroom")


def test_own_homes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    module = example("own_homes")
    module.main([])
    said = capsys.readouterr().out
    assert "my flat: 24 m2, 4 containers, 4 of them reachable" in said and "failed" not in said
    write_houses(tmp_path / "houses.jsonl.gz", [generate_house(seed, "small") for seed in range(2)])
    module.main([str(tmp_path / "houses.jsonl.gz")])
    assert "houses.jsonl.gz:" in capsys.readouterr().out


def test_ros_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    example("ros_map").main(tmp_path)
    said = capsys.readouterr().out
    assert "28 m2, 6 containers, 10 worlds" in said
    assert "greedy" in said


def test_sweep_results(tmp_path: Path) -> None:
    likelihood = fit_on_homes(generate_homes(4))
    homes = list(generate_homes(3, seed=50, size_classes=["small"]))
    for number in range(2):
        rows = run_experiment(homes, ["nonlearned_myopic"], likelihood, robots=[1], trials_per_cell=2, seed=number)
        cell = tmp_path / "cells" / f"{number:03d}"
        (cell / "episodes").mkdir(parents=True)
        rows.drop(columns="trace").to_parquet(cell / "episodes" / "part-0.parquet")
        (cell / "evaluation.json").write_text(json.dumps({"sweep": f"seed={number}"}))
    module = example("sweep_results")
    frame, by_sql = module.with_pandas(tmp_path), module.with_duckdb(tmp_path)
    assert set(frame["sweep"]) == {"seed=0", "seed=1"} and len(frame) == 4
    assert by_sql["episodes"].tolist() == [4]
    assert by_sql["mean_cost_cells"][0] == pytest.approx(frame["cost_cells"].mean())


def test_the_notebook_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MPLBACKEND", "Agg")
    cells = json.loads((EXAMPLES / "pictures.ipynb").read_text())["cells"]
    names: dict[str, object] = {"__name__": "notebook"}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), "pictures.ipynb", "exec"), names)
    import matplotlib.pyplot as plt

    plt.close("all")
    assert names["picture"] is not None


def test_every_example_is_tested() -> None:
    text = Path(__file__).read_text()
    for path in EXAMPLES.iterdir():
        if path.suffix in (".py", ".ipynb"):
            assert f'"{path.stem}"' in text or path.name in text
