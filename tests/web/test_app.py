from __future__ import annotations

import base64
import json
import re
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from starlette.testclient import TestClient

from hiprl.data.answer import CANNOT_TELL, EQUALLY_GOOD, Answer, choice, level, number, ranking, rating
from hiprl.data.film import Film
from hiprl.store.rows import ClipRow
from hiprl.store.store import Store
from hiprl.web import app
from hiprl.web.access import Doors
from hiprl.web.app import app_of
from hiprl.web.shown import turned
from tests.web.made import SCENE, a_taught_run, poses


def asked(client: TestClient, run_id: str, judge: str = "ada") -> dict:
    return client.get(f"/api/runs/{run_id}/next", params={"judge": judge}).json()["question"]


def says(client: TestClient, run_id: str, question: dict, answer: Answer, judge: str = "ada"):
    told = {"k": question["k"], "judge": judge, "swapped": question["swapped"], "answer": answer.plain()}
    return client.post(f"/api/runs/{run_id}/answers", json=told)


def shown_poses(clip: dict) -> np.ndarray:
    return np.frombuffer(base64.b64decode(clip["poses"]), "<f4").reshape(-1, 3, 7)


def test_a_question_shows_its_clips_as_they_were(client, store: Store, run_id: str):
    assert client.get(f"/api/runs/{run_id}/scene").json() == SCENE
    question = asked(client, run_id)
    first, second = question["clips"][::-1] if question["swapped"] else question["clips"]
    assert (question["k"], first["trajectory"], first["start"], first["steps"]) == (1, 1, 5, 10)
    np.testing.assert_array_equal(shown_poses(first), poses(1, 33)[5:16])
    assert second["steps"] == 26 and len(shown_poses(second)) == 27  # a clip to its end
    assert (first["imagined"], second["imagined"]) == (True, False)


def test_sides_are_drawn(client, run_id: str):
    assert {asked(client, run_id)["swapped"] for _ in range(40)} == {True, False}


def test_an_answer_is_about_what_was_shown_and_kept_in_the_questions_order(client, store: Store, run_id: str):
    for k in (1, 2, 3):
        question = asked(client, run_id)
        assert question["k"] == k
        told = says(client, run_id, question, level(2, 5)).json()
        assert told["new"] and told["progress"]["answers"] == k
        (row,) = [row for row in store.answers(run_id) if row.k == k]
        assert row.answer == level(-2 if question["swapped"] else 2, 5)
        assert (row.swapped, row.judge) == (question["swapped"], "ada")
    assert asked(client, run_id) is None


@pytest.mark.parametrize(
    ("answer", "other"),
    [
        (choice(True), choice(False)),
        (level(-1, 5), level(1, 5)),
        (number(2.5), number(-2.5)),
        (EQUALLY_GOOD, EQUALLY_GOOD),
        (CANNOT_TELL, CANNOT_TELL),
        (ranking((2, 0, 1)), ranking((0, 2, 1))),
        (rating(1, 5), rating(1, 5)),
    ],
)
def test_an_answer_can_be_turned(answer: Answer, other: Answer):
    assert turned(answer, True) == other and turned(other, True) == answer and turned(answer, False) == answer


def test_two_judges_are_not_asked_the_same_at_once(client, run_id: str):
    assert [asked(client, run_id, judge)["k"] for judge in ("ada", "bo", "ada", "cy")] == [1, 2, 1, 3]
    assert asked(client, run_id, "dan") is None


def test_what_a_judge_has_answered_waits_for_another(client, store: Store, run_id: str):
    clips = store.questions(run_id)[0].clips
    store.answer(run_id, 1, choice(True), "ada")
    store.ask(run_id, 4, clips)
    asked = lambda judge: client.get(f"/api/runs/{run_id}/next", params={"judge": judge}).json()["question"]["k"]
    assert asked("ada") == 2
    store.answer(run_id, 2, choice(True), "ada")
    assert asked("ada") == 3 and asked("bo") == 4
    store.answer(run_id, 3, choice(True), "ada")
    store.answer(run_id, 4, choice(True), "bo")
    store.ask(run_id, 5, clips)
    assert asked("ada") == 5  # nothing else is left


def test_who_looks_for_long_is_told_that_another_one_answered(client, store: Store, run_id: str):
    question = asked(client, run_id, "ada")
    store.answer(run_id, question["k"], choice(True), "bo")  # ada's turn was over
    refused = says(client, run_id, question, choice(False))
    assert refused.status_code == 409 and "answered by bo" in refused.json()["error"]
    assert [row.judge for row in store.answers(run_id)] == ["bo"]


def test_pictures_of_a_run_are_drawn_when_looked_at(store: Store, run_id: str, doors: Doors):
    draw = {"learning-curve": lambda run: f"png of {run}".encode()}
    with TestClient(app_of(store, doors, hosts=["testserver"], pictures=draw)) as client:
        client.get("/enter", params={"token": doors.token})
        facts = lambda: client.get(f"/api/runs/{run_id}/facts").json()["pictures"]
        assert facts() == []  # nothing has been learned yet
        store.finish_episode(run_id, 1, {"k": 1, "weights": {}}, b"1")
        (linked,) = facts()
        found = client.get(linked["url"])
        assert found.content == f"png of {run_id}".encode() and found.headers["content-type"] == "image/png"
        for name in ("other", "..%2f..%2fetc%2fpasswd", "learning-curve.png"):
            assert client.get(f"/runs/{run_id}/pictures/{name}.png").status_code == 404


def test_the_run_page_is_told_who_answered(client, store: Store, run_id: str):
    judges = [{"judge": "<i>ada</i>", "answers": 3, "mistakes": 0.02}]
    store.finish_episode(run_id, 1, {"k": 1, "weights": {"x": 1.0}, "judges": judges, "agreement": 0.5}, b"1")
    found = client.get(f"/api/runs/{run_id}/facts").json()
    assert found["judges"] == judges and found["agreement"] == 0.5


def test_undo_brings_back_the_last_question_as_it_was_shown(client, store: Store, run_id: str):
    assert client.get(f"/api/runs/{run_id}/last?judge=ada").json() == {"question": None}
    question = asked(client, run_id)
    says(client, run_id, question, choice(True))
    again = client.get(f"/api/runs/{run_id}/last?judge=ada").json()["question"]
    assert again == question | {"answer": {"form": "choice", "value": 1}}
    says(client, run_id, again, EQUALLY_GOOD)
    assert store.answer_of(run_id, 1) == EQUALLY_GOOD and len(store.answers(run_id)) == 2


def test_the_same_sent_twice_is_kept_once(client, store: Store, run_id: str):
    question = asked(client, run_id)
    assert says(client, run_id, question, choice(True)).json()["new"]
    assert not says(client, run_id, question, choice(True)).json()["new"]
    assert len(store.answers(run_id)) == 1


def test_progress_follows_the_run(client, store: Store, run_id: str):
    told = lambda: client.get(f"/api/runs/{run_id}/next?judge=x").json()["progress"]
    assert (told()["state"], told()["planned"], told()["open"], told()["sure"]) == ("waiting", 30, 3, None)
    for k, right in enumerate((1.0, 0.0, None, 1.0), 1):
        assert told()["sure"] is None  # of one or two, nothing can be said
        assert not told()["enough"]  # nor by two answers, though there are three episodes
        facts = {
            "k": k,
            "comparisons": max(2, k),
            "foreseen": right,
            "worth": 0.001,
            "searched": True,
            "disagrees": [1],
        }
        store.finish_episode(run_id, k, facts, b"%d" % k)
    assert (told()["episodes"], told()["sure"], told()["enough"]) == (4, pytest.approx(2 / 3), True)
    store.finish(run_id, {}, b"")
    assert told()["state"] == "finished"


def test_after_enough_nothing_more_is_asked(client, store: Store, run_id: str):
    enough = lambda **told: client.post(f"/api/runs/{run_id}/enough", json=told)
    assert enough(judge="ada").status_code == 400 and enough().status_code == 400 and not store.enough(run_id)
    with store.lease(run_id):
        says(client, run_id, asked(client, run_id), choice(True))
        assert enough().status_code == 400 and not store.enough(run_id)
        told = enough(judge="ada").json()["progress"]
        assert (told["state"], told["open"], told["answers"]) == ("finishing", 0, 1) and store.enough(run_id)
        told = client.get(f"/api/runs/{run_id}/next?judge=ada").json()
        assert told["question"] is None and told["progress"]["state"] == "finishing"
        store.finish(run_id, {}, b"")
        assert enough(judge="bo").json()["progress"]["state"] == "finished"


def test_all_answers_given_it_practises_for_the_last_time(client, store: Store):
    run_id = a_taught_run(store, questions=30)
    with store.lease(run_id):
        for k in range(1, 31):
            assert client.get(f"/api/runs/{run_id}/next?judge=x").json()["progress"]["state"] == "waiting"
            store.answer(run_id, k, choice(True), "ada")
        assert client.get(f"/api/runs/{run_id}/next?judge=x").json()["progress"]["state"] == "finishing"


def test_where_no_trainer_is_it_is_stopped_and_what_is_open_is_asked(client, store: Store, run_id: str):
    state = lambda: client.get(f"/api/runs/{run_id}/next?judge=x").json()["progress"]["state"]
    for k in (1, 2, 3):
        assert state() == "waiting"
        store.answer(run_id, k, choice(True), "ada")
    assert state() == "stopped" and ">stopped<" in client.get("/").text
    with store.lease(run_id):
        assert state() == "learning" and ">busy<" in client.get("/").text
    store.say_enough(run_id, "ada")
    assert state() == "stopped"
    with store.lease(run_id):
        assert state() == "finishing"
    store.finish(run_id, {}, b"")
    assert state() == "finished" and ">finished<" in client.get("/").text


def test_a_run_that_a_script_judges_asks_nobody(client, store: Store):
    run_id = a_taught_run(store, judge="choice:mistake=0.1")
    page, listed = client.get(f"/runs/{run_id}").text, client.get("/").text
    for text in (page, listed):
        assert f"/runs/{run_id}/teach" not in text and f"/runs/{run_id}/review" not in text
        assert "asks you" not in text and "of yours" not in text and "from you" not in text
    assert f'href="/runs/{run_id}">Hopper-v5</a>' in listed and "judge choice:mistake=0.1" in listed
    for name in ("teach", "review"):
        assert client.get(f"/runs/{run_id}/{name}").headers["location"] == f"/runs/{run_id}"
    with store.lease(run_id):
        told = client.get(f"/api/runs/{run_id}/next?judge=x").json()["progress"]
    assert (told["people"], told["state"], told["open"]) == (False, "warming up", 0)


@pytest.mark.parametrize("finished", [False, True])
def test_a_finished_run_is_not_taught_on(client, store: Store, run_id: str, finished: bool):
    if finished:
        store.finish(run_id, {}, b"")
    assert ('id="go-on" hidden' in client.get(f"/runs/{run_id}").text) == finished


def test_review_marks_where_the_reward_disagrees(client, store: Store, run_id: str):
    for _ in range(3):
        says(client, run_id, asked(client, run_id), choice(True))
    store.finish_episode(run_id, 1, {"k": 1, "agrees": [1], "disagrees": [2]}, b"1")  # the third is newer
    rows = client.get(f"/api/runs/{run_id}/answers").json()
    assert [(row["k"], row["agrees"], row["judge"]) for row in rows] == [
        (1, True, "ada"),
        (2, False, "ada"),
        (3, None, "ada"),
    ]
    question = client.get(f"/api/runs/{run_id}/questions/2").json()["question"]
    assert (question["k"], question["swapped"]) == (2, False)
    assert question["answer"] == store.answer_of(run_id, 2).plain()


def test_a_changed_answer_has_no_verdict_until_it_is_heard(client, store: Store, run_id: str):
    for k in (1, 2):
        store.answer(run_id, k, choice(True), "ada")
    store.answer(run_id, 3, CANNOT_TELL, "ada")
    told = lambda: [(row["agrees"], row["sided"]) for row in client.get(f"/api/runs/{run_id}/answers").json()]
    assert told() == [(None, True), (None, True), (None, False)]
    facts = {"agrees": [2], "disagrees": [1], "heard": 3}
    store.finish_episode(run_id, 1, {"k": 1, **facts}, b"1")
    assert told() == [(False, True), (True, True), (None, False)]
    store.answer(run_id, 1, choice(False), "ada")
    assert told() == [(None, True), (True, True), (None, False)]
    store.finish_episode(run_id, 2, {"k": 2, "agrees": [1, 2], "disagrees": [], "heard": 4}, b"2")
    assert told() == [(True, True), (True, True), (None, False)]


def test_what_it_does_now_is_its_newest_policy(client, store: Store, run_id: str):
    found = client.get(f"/api/runs/{run_id}/now").json()
    assert (found["clip"]["trajectory"], found["clip"]["steps"]) == (2, 26)
    assert found["episode"] == 1  # of those that were executed, from 0
    assert client.get(f"/api/runs/{a_taught_run(store, trajectories=2)}/now").json() == {"clip": None, "episode": None}


@pytest.mark.parametrize(
    ("facts", "shown"), [({"trajectory": 2}, (2, 1)), ({}, (3, 2)), ({"trajectory": None}, (3, 2))]
)
def test_what_a_finished_run_does_is_what_it_reports(client, store: Store, facts: dict, shown: tuple[int, int]):
    run_id = a_taught_run(store, trajectories=4)
    now = lambda: client.get(f"/api/runs/{run_id}/now").json()
    assert (now()["clip"]["trajectory"], now()["episode"]) == (3, 2)  # 1 was imagined
    store.finish(run_id, facts, b"")
    assert (now()["clip"]["trajectory"], now()["episode"]) == shown


def test_a_world_of_which_nothing_is_seen_shows_its_states(client, store: Store):
    run_id = a_taught_run(store, filmed=False)
    clip = asked(client, run_id)["clips"][0]
    states = np.frombuffer(base64.b64decode(clip["states"]), "<f4").reshape(-1, 2)
    assert len(states) == clip["steps"] + 1 and (states[:, 1] == 1).all()


def test_pictures_come_as_they_are(client, store: Store):
    run_id = a_taught_run(store)
    tau = store.trajectory(run_id, 0)
    store.add_trajectory(run_id, 3, tau, "policy", film=Film(pictures=[b"a%d" % i for i in range(41)]).to_bytes())
    store.ask(run_id, 4, [ClipRow(3, 2, 3)])
    (clip,) = client.get(f"/api/runs/{run_id}/questions/4").json()["question"]["clips"]
    assert [base64.b64decode(one.split(",")[1]) for one in clip["frames"]] == [b"a2", b"a3", b"a4", b"a5"]


def test_a_goal_is_kept_in_the_judges_own_words(client, store: Store, run_id: str):
    words = "run <b>fast</b> & don't 'hop' ☃"
    assert client.post(f"/api/runs/{run_id}/goal", json={"goal": f"  {words} "}).json() == {"goal": words}
    assert store.goal(run_id) == words
    text = client.get(f"/runs/{run_id}/teach").text
    assert "<b>fast" not in text and "&lt;b&gt;fast" in text


@pytest.mark.parametrize(
    ("given", "kept"),
    [
        ("run\u00a0fast\u2028\n and \t far", "run fast and far"),  # as pasted from a page
        ("\u0645\u06cc\u200c\u062f\u0648\u062f", "\u0645\u06cc\u200c\u062f\u0648\u062f"),  # Persian: runs
        ("a \U0001f469\u200d\U0001f4bb", "a \U0001f469\u200d\U0001f4bb"),
    ],
)
def test_words_of_all_languages_are_taken(client, store: Store, run_id: str, given: str, kept: str):
    assert client.post(f"/api/runs/{run_id}/goal", json={"goal": given}).json() == {"goal": kept}
    says(client, run_id, asked(client, run_id, given), choice(True), given)
    assert store.goal(run_id) == kept and [row.judge for row in store.answers(run_id)] == [kept]


@pytest.mark.parametrize(
    ("given", "why"),
    [("run\u200bfast", r"what is wanted without the sign U\+200B"), ("a\x00b", r"U\+0000"), ("\ud800", r"U\+D800")]
    + [(given, "what is wanted in 1 to 500 letters") for given in ("", " \u00a0", "\u200d", "x" * 501)],
)
def test_why_words_are_refused_is_said(client, store: Store, run_id: str, given: str, why: str):
    sent = json.dumps({"goal": given})
    reply = client.post(f"/api/runs/{run_id}/goal", content=sent)
    assert reply.status_code == 400 and re.search(why, reply.json()["error"]) and store.goal(run_id) is None


@pytest.mark.parametrize("path", ["/", "/runs/{}", "/runs/{}/teach", "/runs/{}/review"])
def test_every_page_is_whole_and_allows_no_foreign_script(client, run_id: str, path: str):
    response = client.get(path.format(run_id))
    assert response.status_code == 200 and run_id in response.text
    assert "script-src 'self'" in response.headers["content-security-policy"]
    assert " style=" not in response.text and "<script>" not in response.text


# Safety


@pytest.mark.parametrize("path", ["/", "/runs/{}", "/api/runs/{}/next?judge=a", "/api/runs/{}/events"])
def test_who_has_not_come_in_sees_nothing(outside, run_id: str, path: str):
    response = outside.get(path.format(run_id))
    assert response.status_code in (303, 401) and run_id not in response.text
    told = {"k": 1, "judge": "a", "swapped": False, "answer": {"form": "equal"}}
    assert outside.post(f"/api/runs/{run_id}/answers", json=told, headers={"X-Hiprl": "1"}).status_code == 401


def test_a_token_is_good_once_and_a_password_always(outside, doors: Doors):
    token = doors.token
    assert outside.get(f"/enter?token={token}&next=/runs/x").headers["location"] == "/runs/x"
    assert outside.get(f"/enter?token={token}&next=/runs/x").headers["location"] == "/runs/x"  # who is in stays in
    outside.cookies.clear()
    assert outside.get(f"/enter?token={token}").status_code == 403
    assert outside.post("/enter", data={"token": "wrong"}).status_code == 403
    for _ in range(2):
        outside.cookies.clear()
        assert outside.post("/enter", data={"token": "open sesame"}).status_code == 303
    cookie = outside.post("/enter", data={"token": "open sesame"}).headers["set-cookie"].lower()
    assert "httponly" in cookie and "samesite=strict" in cookie


def test_wrong_guesses_wait_for_one_another_and_the_right_one_for_none(outside, doors: Doors, monkeypatch):
    waits: list[float] = []

    async def waited(seconds: float) -> None:
        waits.append(seconds)

    monkeypatch.setattr(app.anyio, "sleep", waited)
    for guess in ("wrong", "wronger"):
        assert outside.post("/enter", data={"token": guess}).status_code == 403
    assert waits == [app.PAUSE] * 2
    assert outside.post("/enter", data={"token": "open sesame"}).status_code == 303
    assert len(waits) == 2


def test_behind_a_proxy_the_browser_says_where_an_answer_comes_from(client, store: Store, run_id: str):
    told = {"k": 1, "judge": "a", "swapped": False, "answer": {"form": "equal"}}
    behind = {"Origin": "https://teach.example", "Sec-Fetch-Site": "same-origin"}
    assert client.post(f"/api/runs/{run_id}/answers", json=told, headers=behind).status_code == 200
    assert store.answers(run_id)


def test_the_player_is_kept_by_browsers_until_it_changes(outside):
    first = outside.get("/static/player.js")
    assert first.headers["cache-control"] == "no-cache"
    assert outside.get("/static/player.js", headers={"If-None-Match": first.headers["etag"]}).status_code == 304
    assert outside.get("/enter").headers["cache-control"] == "no-store"


def test_a_run_in_an_environment_of_a_long_name_has_its_page(client, store: Store):
    run_id = store.add_run("package_of_mine.module_of_mine:" + "make_" * 30, 3, {"judge": "exact"}, {})
    assert len(run_id) < 80
    assert run_id in client.get("/").text


def test_who_came_in_is_known_to_every_page_on_the_store(client, store: Store, run_id: str, doors: Doors):
    again = Doors(store.secret(), "open sesame")
    with TestClient(app_of(store, again, hosts=["testserver"]), follow_redirects=False) as later:
        assert later.get(f"/runs/{run_id}").status_code == 303
        later.cookies.update(client.cookies)  # as after a stop and a resume
        assert later.get(f"/runs/{run_id}").status_code == 200
    assert Doors(store.secret(), "another").cookie != Doors(store.secret()).cookie != doors.cookie  # a new lock
    other = Doors("of another store")
    assert other.cookie != doors.cookie and list(client.cookies) == [doors.cookie]
    with TestClient(app_of(store, other, hosts=["testserver"]), follow_redirects=False) as elsewhere:
        elsewhere.cookies.update(client.cookies)
        assert elsewhere.get(f"/runs/{run_id}").status_code == 303
        elsewhere.get("/enter", params={"token": other.token})
        assert len(elsewhere.cookies) == 2  # neither is thrown out


@pytest.mark.parametrize("path", ["/", "/runs/{}/teach", "/runs/{}/review"])
def test_the_door_leads_to_where_one_was(outside, run_id: str, doors: Doors, path: str):
    path = path.format(run_id)
    door = outside.get(path).headers["location"]
    assert f'name="next" value="{path}"' in outside.get(door).text
    assert outside.post(door, data={"token": doors.token, "next": path}).headers["location"] == path


@pytest.mark.parametrize("path", ["//evil.example/runs", "/%09/evil.example", "/%0d%0aSet-Cookie:a=b"])
def test_the_door_is_not_sent_elsewhere(outside, path: str):
    door = outside.get(f"http://testserver{path}").headers.get("location", "/enter?next=/")
    assert door == "/enter?next=/"


@pytest.mark.parametrize("to", ["//evil.example", "https://evil.example", "/\\evil.example", "javascript:1", "/enter"])
def test_the_door_leads_nowhere_else(outside, doors: Doors, to: str):
    assert outside.get("/enter", params={"token": doors.token, "next": to}).headers["location"] == "/"


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "https://evil.example"},
        {"Origin": "null"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
        {"X-Hiprl": ""},
    ],
)
def test_what_another_site_sends_is_refused(client, store: Store, run_id: str, headers: dict):
    told = {"k": 1, "judge": "a", "swapped": False, "answer": {"form": "equal"}}
    assert client.post(f"/api/runs/{run_id}/answers", json=told, headers=headers).status_code == 403
    assert not store.answers(run_id)


def test_what_is_too_large_is_refused_though_it_did_not_say_so(client, outside, run_id: str):
    for path in (f"/api/runs/{run_id}/answers", "/enter"):
        reply = client.post(path, content=(b" " * 8000 for _ in range(3)))
        assert reply.status_code == 413 and "large" in reply.text


def test_half_a_sign_is_told_of_in_whole_ones(client, store: Store, run_id: str):
    said = b'{"k": 1, "judge": "a", "answer": {"form": "equal", "\\ud800": 1}}'
    reply = client.post(f"/api/runs/{run_id}/answers", content=said)
    assert reply.status_code == 400 and "ud800" in reply.json()["error"] and not store.answers(run_id)


def test_another_name_for_this_machine_is_refused(client):
    assert client.get("/", headers={"Host": "evil.example"}).status_code == 400


BODIES = [
    *(b"", b"[]", b"{", b"nul", b"\xff\xfe", b"{}", b'{"k": 1}', b"[" * 9000, b'{"k": 1, "k": 2}', b" " * 20000),
    *(
        b'{"k": %s, "judge": "a", "answer": {"form": "equal"}}' % k
        for k in (b"0", b"99", b"-1", b"1e9", b'"1"', b"true")
    ),
    *(
        b'{"k": 99999999999999999999, "judge": "a", "answer": {"form": "equal"}}',
        b'{"k": 1, "judge": "a", "answer": 3}',
    ),
    *(
        b'{"k": 1, "judge": "a", "answer": %s}' % said
        for said in (
            *(b"null", b"{}", b'{"form": 3}', b'{"form": "number"}', b'{"form": "number", "value": NaN}'),
            *(b'{"form": "level", "value": 9, "levels": 5}', b'{"form": "level", "value": 1, "levels": 1e99}'),
            *(b'{"form": "ranking", "value": [0, 0]}', b'{"form": "ranking", "value": [0, 1, 2]}'),
            *(b'{"form": "choice", "value": 1, "more": 1}', b'{"form": "rating", "value": 1, "levels": 5}'),
            *(b'{"form": "choice", "value": {"a": 1}}', b'{"form": "choice", "value": "<script>"}'),
            *(b'{"form": "ranking", "value": [[[[1]]]]}', b'{"form": "number", "value": 1e400}'),
        )
    ),
    *(
        b'{"k": 1, "judge": %s, "answer": {"form": "equal"}}' % judge
        for judge in (b'""', b"3", b"null", b'"' + b"x" * 61 + b'"', b'"a\\u0000b"', b'"\\ud800"', b"[]")
    ),
    b'{"k": 1, "judge": "a", "swapped": 1, "answer": {"form": "equal"}}',
]
PATHS = [
    *("/api/runs/{}/answers", "/api/runs/{}/goal", "/enter", "/", "/api/runs/none/answers", "/static/../app.py"),
    *("/api/runs/{}/next", "/runs/{}/teach"),
]


@pytest.mark.slow
def test_nothing_hostile_gets_a_traceback_or_is_written(client, store: Store, run_id: str):
    def state():
        return store.answers(run_id), store.goal(run_id), store.questions(run_id), store.runs()

    before, tried = state(), 0
    for path in PATHS:
        for body in BODIES:
            response = client.post(path.format(run_id), content=body, headers={"Content-Type": "application/json"})
            tried += 1
            led_on = path == "/enter" and response.headers.get("location") == "/"  # who is in stays in
            assert led_on or response.status_code in (400, 403, 404, 405, 413), (path, body[:80], response.text)
            assert "Traceback" not in response.text
    judge = {"judge": "ada"}
    for path in (
        *("/api/runs/%2e%2e%2f%2e%2e%2fetc%2fpasswd/next", "/static/%2e%2e/app.py", "/static/..%2f..%2fapp.py"),
        *("/api/runs/' OR 1=1 --/next", "/runs/<script>alert(1)</script>/teach", "/api/runs/{}/questions/99999999999"),
        *(
            "/api/runs/{}/questions/-1",
            "/api/runs/{}/questions/x",
            "/static/",
            "/runs/%00/teach",
            "/" + "a" * 5000,
        ),
    ):
        response = client.get(path.format(run_id), params=judge)
        tried += 1
        assert response.status_code in (400, 403, 404, 405), (path, response.text)
        assert "Traceback" not in response.text and "<script>alert" not in response.text
    for name in ("", " ", "x" * 61, "a\x00b", "\x1b[31m"):
        tried += 1
        assert client.get(f"/api/runs/{run_id}/next", params={"judge": name}).status_code == 400
    assert tried >= 200 and state() == before


@pytest.mark.slow
def test_many_judges_lose_and_double_nothing(client, store: Store):
    run_id = a_taught_run(store, questions=60)

    def judge(name: str) -> list[int]:
        done = []
        while (question := asked(client, run_id, name)) is not None:
            assert says(client, run_id, question, choice(True), name).json()["new"]
            done.append(question["k"])
        return done

    with ThreadPoolExecutor(12) as pool:
        done = list(pool.map(judge, [f"judge {i}" for i in range(12)]))
    assert sorted([k for some in done for k in some]) == list(range(1, 61))
    assert sorted(row.k for row in store.answers(run_id)) == list(range(1, 61))
