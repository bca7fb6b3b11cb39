"""Simulated ACME controller with a wall across Y, for the driver's own tests; it moves with the time passed to it."""

from __future__ import annotations

import math
import socket
import threading

WALL_Y, RAPID, TRAVEL, BRAKES_MM = 400.0, 200.0, 2000.0, 0.05


class AcmeController:
    def __init__(self) -> None:
        self.now_s = self.since_s = 0.0
        self.here = [0.0, 0.0, 0.0]
        self.latch = [0.0, 0.0, 0.0]
        self.outcome = "reached"
        self.fault = False
        self.motion: tuple[str, list[float], list[float], float] | None = None
        self.held: tuple[str, list[float], float] | None = None
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        threading.Thread(target=self._serve, daemon=True).start()

    def close(self) -> None:
        self._listener.close()

    def advance_to(self, now_s: float) -> None:
        self.now_s = now_s
        if self.motion is None:
            return
        kind, start, target, feed = self.motion
        length = math.dist(start, target)
        share = 1.0 if length == 0.0 else min(1.0, feed * (now_s - self.since_s) / length)
        wall = (WALL_Y - start[1]) / (target[1] - start[1]) if kind != "move" and target[1] > WALL_Y else math.inf
        if start[1] <= WALL_Y and wall <= share:
            self.latch = self._along(wall)
            self.here = self._along(min(1.0, wall + BRAKES_MM / length))
            self._end("tripped", fault=kind == "guarded")
        else:
            self.here = self._along(share)
            if share == 1.0:
                self.latch = list(target)
                self._end("reached")

    def _along(self, share: float) -> list[float]:
        _, start, target, _ = self.motion
        return [a + share * (b - a) for a, b in zip(start, target, strict=True)]

    def _end(self, outcome: str, *, fault: bool = False) -> None:
        self.motion, self.held, self.outcome, self.fault = None, None, outcome, fault

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            with connection, connection.makefile("r") as lines:
                for line in lines:
                    connection.sendall(self._answer(line.split()).encode() + b"\n")

    def _answer(self, words: list[str]) -> str:
        name, arguments = words[0], words[1:]
        if name in ("move", "guarded", "touch"):
            return self._start(name, [float(word) for word in arguments[:3]], arguments[3])
        if name == "stop" and (self.motion is not None or self.held is not None):
            self._end("stopped")
        if name == "hold" and self.motion is not None:
            kind, _, target, feed = self.motion
            self.motion, self.held = None, (kind, target, feed)
        if name == "resume" and self.held is not None:
            kind, target, feed = self.held
            self.motion, self.held, self.since_s = (kind, list(self.here), target, feed), None, self.now_s
        if name == "reset":
            self.fault = False
        moving = "moving" if self.motion is not None else "held" if self.held is not None else "idle"
        state = "fault" if self.fault else moving
        answers = {
            "status": f"{state} {'not-ready' if self.fault else 'ready'}",
            "position": " ".join(map(repr, self.here)),
            "latch": " ".join(map(repr, self.latch)),
            "limits": " ".join(map(str, [0.0] * 3 + [TRAVEL] * 3 + [RAPID] * 3 + [1000.0] * 3)),
            "outcome": self.outcome if moving == "idle" else "moving",
            "probe": "deflected" if self.here[1] > WALL_Y else "free",
        }
        return f"ok {answers.get(name, '')}"

    def _start(self, kind: str, target: list[float], feed: str) -> str:
        speed = RAPID if feed == "rapid" else float(feed)
        if self.motion is not None or self.fault:
            return "no not in this state"
        if not all(0.0 <= value <= TRAVEL for value in target) or not 0.0 < speed < math.inf:
            return "no target or feed out of range"
        if kind == "touch" and self.here[1] > WALL_Y:
            return "no probe deflected"
        self.motion = (kind, list(self.here), target, speed)
        self.since_s = self.now_s
        return "ok"
