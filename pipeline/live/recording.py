"""Write a live process's log as MCAP, which robotics tools open: each message on its type's topic, with its schema.

    python -m pipeline.live.recording run/log.jsonl run/log.mcap

Topics are ``/live/in/<type>`` for events and ``/live/out/<type>`` for answers, orders and the task's state; a message's
time is that of the event, in the live team's clock. Needs mcap: pip install 'mrtask[ros]'.
"""

import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from mrtask.files import replacing
from mrtask.live.log_file import entries
from mrtask.live.messages import schemas
from pipeline.app.tool import main
from pipeline.base.config import UserError

NS_PER_S = 1_000_000_000
LINES_SHOWN = 10


def run(arguments: Sequence[str]) -> None:
    """Run the tool."""
    if len(arguments) != 2:
        raise UserError("give the log of a live process (log=run/log.jsonl) and the file to write, as run/log.mcap")
    log, recording = map(Path, arguments)
    if not log.is_file():
        raise UserError(f"{log}: no such file")
    with replacing(recording) as temporary:
        count, unread = write(log, temporary)
        if not count:
            raise UserError(f"{log}: no line of it is an entry of a live process's log")
    if unread:
        numbers = ", ".join(map(str, unread[:LINES_SHOWN])) + (", ..." if len(unread) > LINES_SHOWN else "")
        print(f"{log}: left out what is no whole entry, line {numbers}", file=sys.stderr)
    print(f"{count} messages -> {recording}")


def write(log: Path, recording: Path) -> tuple[int, list[int]]:
    """Write a log as MCAP; return the number of messages, and the lines that are no entries and were left out.

    Raises:
        InputError: the log cannot be read, or mcap is not installed.
    """
    try:
        from mcap.writer import Writer
    except ImportError as error:
        raise UserError("MCAP needs mcap: pip install 'mrtask[ros]'") from error
    known = schemas()
    count = 0
    unread: list[int] = []
    with recording.open("wb") as file:
        writer = Writer(file)
        writer.start(library="mrtask")
        registered: dict[str, int] = {}
        channels: dict[str, int] = {}
        for time_s, way, message in _messages(log, unread):
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
    return count, unread


def _messages(log: Path, unread: list[int]) -> Iterator[tuple[float, str, dict[str, Any]]]:
    """Yield (time, "in" or "out", message) in order; a line that was not a message appears as its answer only.

    The numbers of lines that are no entries are added to ``unread``.
    """
    time_s = 0.0
    for number, entry in entries(log):
        try:
            said_in = [json.loads(one) for one in entry["lines"]] if entry and entry["kind"] == "in" else []
            said_out = [json.loads(one) for one in (entry["out"] if said_in else entry["lines"])] if entry else []
            stamped = [
                (max(time_s, float(event["time_s"])), event)
                for message in said_in
                for event in (message["events"] if message["type"] == "batch" else [message])
            ]
        except (ValueError, KeyError, TypeError):
            entry = None
        if entry is None:
            unread.append(number)
            continue
        for at_s, event in stamped:
            time_s = max(time_s, at_s)
            yield time_s, "in", event
        for message in said_out:
            yield time_s, "out", message


if __name__ == "__main__":
    main(run, __doc__ or "")
