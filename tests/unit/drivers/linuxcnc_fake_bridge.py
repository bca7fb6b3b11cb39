"""Bridge without LinuxCNC that answers JSON lines from a script; it replaces the system's Python.

Run as `python linuxcnc_fake_bridge.py SCRIPT.json BRIDGE`; the script is an object: request name → list of answers,
used one after the other; the last one is repeated. An answer is an object (`ok` or `error`) or a word: `die`, `silent`,
`hang` (no reaction from then on), `garbage`, `late` (first an answer with another number).
"""

from __future__ import annotations

import json
import signal
import sys
from pathlib import Path

SCRIPT = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))


def say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def main() -> None:
    say(json.dumps({"id": 0, "ok": {}}))
    for line in sys.stdin:
        request = json.loads(line)
        answers = SCRIPT.get(request["do"], [{"ok": {}}])
        answer = answers.pop(0) if len(answers) > 1 else answers[0]
        if answer == "die":
            sys.exit("shot by the test")
        if answer == "hang":
            signal.pause()
        if answer == "garbage":
            say("Segmentation fault")
        elif answer == "late":
            say(json.dumps({"id": request["id"] - 1, "ok": {"stale": True}}))
            say(json.dumps({"id": request["id"], "ok": {"stale": False}}))
        elif answer != "silent":
            say(json.dumps({"id": request["id"], **answer}))


if __name__ == "__main__":
    main()
