"""Write a live process's log as MCAP, which robotics tools open: each message on its type's topic, with its schema.

    python -m pipeline.live.recording run/log.jsonl run/log.mcap

Topics are ``/live/in/<type>`` for events and ``/live/out/<type>`` for answers, orders and the task's state; a message's
time is that of the event, in the live team's clock. Needs mcap: pip install 'mrtask[ros]'.
"""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from mrtask.files import replacing
from mrtask.live.messages import schemas
from pipeline.app.tool import main
from pipeline.base.config import UserError

NS_PER_S = 1_000_000_000


def run(arguments: Sequence[str]) -> None:
    """Run the tool."""
    if len(arguments) != 2:
        raise UserError("give the log of a live process (log=run/log.jsonl) and the file to write, as run/log.mcap")
    log, recording = map(Path, arguments)
    if not log.is_file():
        raise UserError(f"{log}: no such file")
    with replacing(recording) as temporary:
        count = write(log, temporary)
    print(f"{count} messages -> {recording}")


def write(log: Path, recording: Path) -> int:
    """Write a log as MCAP; return the number of messages.

    Raises:
        UserError: the log is damaged, or mcap is not installed.
    """
    try:
        from mcap.writer import Writer
    except ImportError as error:
        raise UserError("MCAP needs mcap: pip install 'mrtask[ros]'") from error
    known = schemas()
    count = 0
    with recording.open("wb") as file:
        writer = Writer(file)
        writer.start(library="mrtask")
        registered: dict[str, int] = {}
        channels: dict[str, int] = {}
        for time_s, way, message in _messages(log):
            kind = message["type"]
            topic = f"/live/{way}/{kind}"
            if kind not in registered:
                schema = json.dumps(known[kind]).encode()
                registered[kind] = writer.register_schema(f"mrtask.{kind}", "jsonschema", schema)
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "json", registered[kind])
            time_ns = round(time_s * NS_PER_S)
            writer.add_message(channels[topic], time_ns, json.dumps(message).encode(), time_ns, sequence=count)
            count += 1
        writer.finish()  # type: ignore[no-untyped-call]
    return count


def _messages(log: Path) -> Iterator[tuple[float, str, dict[str, Any]]]:
    """Yield (time, "in" or "out", message) in order; a line that was not a message appears as its answer only."""
    time_s = 0.0
    for number, line in enumerate(log.read_text(encoding="utf-8").splitlines(), 1):
        try:
            entry = json.loads(line)
            said_in = [json.loads(one) for one in entry["lines"]] if entry["kind"] == "in" else []
            said_out = [json.loads(one) for one in (entry["out"] if entry["kind"] == "in" else entry["lines"])]
        except (ValueError, KeyError, TypeError) as error:
            raise UserError(f"{log}, line {number}: no entry of a live process's log ({error})") from error
        for message in said_in:
            for event in message["events"] if message["type"] == "batch" else [message]:
                time_s = max(time_s, float(event["time_s"]))
                yield time_s, "in", event
        for message in said_out:
            yield time_s, "out", message


if __name__ == "__main__":
    main(run, __doc__ or "")
