"""A server of rosbridge's protocol (https://github.com/RobotWebTools/rosbridge_suite) with robots of Nav2 behind it."""

import json
import threading
import time
from contextlib import suppress
from math import dist

from websockets.exceptions import ConnectionClosed
from websockets.sync.server import serve

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
NEAR_M = 0.3


class _Server:
    """A WebSocket server on a free port, while its context is open; subclasses answer in ``_talk``."""

    def _listen(self):
        self.server = serve(self._talk, "127.0.0.1", 0)
        self.port = self.server.socket.getsockname()[1]
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.server.shutdown()


class Rosbridge(_Server):
    """Robots drive ``drive_s`` long, detect what lies near them, and abort the first goals of those in ``lame``.

    Args:
        contents: place in metres -> the objects there.
    """

    def __init__(self, contents, drive_s=0.02, lame=()):
        self.contents, self.drive_s, self.lame = contents, drive_s, set(lame)
        self.received, self.results = [], []
        self.places, self.topics, self.cancelled = {}, set(), set()
        self._listen()

    def goals(self):
        return [message for message in self.received if message["op"] == "send_action_goal"]

    def _talk(self, connection):
        threading.Thread(target=self._detect, args=(connection,), daemon=True).start()
        with suppress(ConnectionClosed):
            for text in connection:
                message = json.loads(text)
                self.received.append(message)
                if message["op"] == "subscribe":
                    self.topics.add(message["topic"])
                elif message["op"] == "cancel_action_goal":
                    self.cancelled.add(message["id"])
                elif message["op"] == "send_action_goal":
                    threading.Thread(target=self._drive, args=(connection, message), daemon=True).start()

    def _drive(self, connection, message):
        robot = message["action"].split("/")[1]
        pose = message["args"]["pose"]["pose"]
        about = {"id": message["id"], "action": message["action"]}
        with suppress(ConnectionClosed):
            feedback = {"current_pose": {"pose": pose}, "distance_remaining": 0.1}
            connection.send(json.dumps({"op": "action_feedback", "values": feedback, **about}))
            time.sleep(self.drive_s)
            values, status = {"error_code": 0, "error_msg": ""}, SUCCEEDED
            if message["id"] in self.cancelled:
                status = CANCELED
            elif robot in self.lame:
                self.lame.remove(robot)
                values, status = {"error_code": 103, "error_msg": "no valid path"}, ABORTED
            else:
                self.places[robot] = (pose["position"]["x"], pose["position"]["y"])
            self.results.append(status)
            result = {"op": "action_result", "values": values, "status": status, "result": True, **about}
            connection.send(json.dumps(result))

    def _detect(self, connection):
        with suppress(ConnectionClosed):
            while True:
                time.sleep(0.01)
                for robot, place in list(self.places.items()):
                    near = [names for spot, names in self.contents.items() if dist(spot, place) < NEAR_M]
                    scores = {"Teapot": 0.02} | {name: 0.9 for names in near for name in names}
                    results = [{"hypothesis": {"class_id": name, "score": score}} for name, score in scores.items()]
                    topic = f"/{robot}/detections"
                    if topic in self.topics:
                        message = {"header": {}, "detections": [{"results": results}]}
                        connection.send(json.dumps({"op": "publish", "topic": topic, "msg": message}))


class Answers(_Server):
    """A server that answers with these messages, once, after an operation was asked for so many times."""

    def __init__(self, answers, after="send_action_goal", times=1):
        self.answers, self.after, self.times = answers, after, times
        self.received = []
        self._listen()

    def _talk(self, connection):
        with suppress(ConnectionClosed):
            for text in connection:
                message = json.loads(text)
                self.received.append(message)
                if [one["op"] for one in self.received].count(self.after) == self.times and message["op"] == self.after:
                    for answer in self.answers:
                        connection.send(self._filled(answer, message["id"]))

    def _filled(self, answer, name):
        if not isinstance(answer, dict):
            return answer if isinstance(answer, str) else json.dumps(answer)
        return json.dumps({"id": name, "action": "/r1/go", **answer}).replace("{id}", name)
