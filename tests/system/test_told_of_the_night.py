"""The service tells of a whole run, though the receiver was away and the service was killed in between."""

from __future__ import annotations

import hashlib
import hmac
import json
import re
import signal
from pathlib import Path
from typing import Any

from receivers import PASSWORD, port_of_nobody, secret_file, web_receiver
from service_process import AT_ONCE, Service, service, short_settings, simulator
from simulated import wait_for

from agent.notifications.notice import StoredNotice


def failing(running: Service) -> dict[str, Any] | None:
    return next((one for one in running.status()["receivers"] if one["problem"]), None)


def test_the_end_of_a_run_is_told_after_a_kill_and_an_absent_receiver(tmp_path: Path) -> None:
    key = secret_file(tmp_path)
    with port_of_nobody() as port, simulator(tmp_path) as (_, ready):
        told = f'\n[notifications]\nlanguage = "de"\n[notifications.webhook]\nurl = "http://127.0.0.1:{port}/volcal"\n'
        config = short_settings(ready, tmp_path, f'{AT_ONCE}{told}key_file = "{key}"\n')
        with service(config) as first:
            run_id = first.start()
            first.reached("complete")
            shown = wait_for(lambda: failing(first), "a receiver that fails")
            assert (shown["channel"], shown["waiting"]) == ("webhook", 1)
            assert "connection refused" in shown["problem"]
            assert "webhook fails" in first.command("status").stdout
            with first.client() as client:
                assert re.search(r"volcal_receivers_failing\{.*\} 1\.0", client.get("/metrics").text)
            figures = first.get(f"/api/runs/{run_id}")
            first.end(signal.SIGKILL)
        with web_receiver(port=port) as receiver, service(config) as second:
            posted = receiver.next()
            wait_for(lambda: [one["waiting"] for one in second.status()["receivers"]] == [0], "the delivery")
            assert second.end() == 0
            assert receiver.posts.empty()
    signed = posted.headers["X-Volcal-Timestamp"].encode() + b"." + posted.body
    expected = hmac.new(PASSWORD.encode(), signed, hashlib.sha256).hexdigest()
    assert posted.headers["X-Volcal-Signature"] == f"sha256={expected}"
    notice = StoredNotice.model_validate_json(posted.body).notice()
    assert (notice.occasion, notice.severity, notice.alarms) == ("end", "info", ())
    assert notice.subject.endswith("Kalibrierung: Angenommen")
    document = json.loads(posted.body)["run"]
    for name in ("run_id", "ended", "machine_minutes", "ve_um", "vce_um", "held_out_before_um", "held_out_after_um"):
        assert document[name] == figures[name] is not None
    assert PASSWORD not in (tmp_path / "log").read_text()
    assert PASSWORD not in (tmp_path / "state" / "notifications" / "outbox.json").read_text()
