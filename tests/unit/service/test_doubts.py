"""Why a result is not to be trusted: by weight and code, in both languages, not the first warning."""

from pathlib import Path

import pytest
from service_doubles import Director, running, start, wait_for

from invid.wording.sentence import as_sentences, say

PLANNED = "A1: velocity could be 2.63 rad/s without its model; limits.velocity ends the run"
UNSEEN = {"code": "unseen", "text": "A1.damper.1: not seen by these data", "values": {}}
MISSED = {"code": "missed_torque", "text": "The model cannot be trusted: …", "values": {"share": 0.79}}


@pytest.mark.campaign
def test_the_weightiest_doubt_is_the_reason_and_stays_it_in_a_test_run(tmp_path: Path) -> None:
    director = Director()
    director.summary = {"trustworthy": False, "warnings": [PLANNED], "distrust": [UNSEEN, MISSED]}
    with running(tmp_path, director) as (client, _):
        for mode, codes in (
            ("full", ["missed_torque", "unseen"]),
            ("test", ["missed_torque", "unseen", "test"]),
        ):
            location = start(client, mode=mode)
            body = wait_for(client, location, "awaiting_accept")
            doubts = body["summary"]["doubts"]
            assert [d["code"] for d in doubts] == codes
            short = as_sentences(body)["summary"]["doubts"][0]["short"]
            assert say(short, "de") == "dem Modell fehlen 79 % des Moments"
            assert body["untrusted"] == "the model misses 79 % of the torque"
            refused = client.post(f"{location}/actions", json={"type": "accept"})
            assert refused.status_code == 409
            assert refused.json()["detail"].startswith("the model misses 79 % of the torque.")
