"""The pages in a real Chromium, before a server in a process of its own."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import expect

from benchmarks.clicker import CHROMIUM, Started, chromium, started
from hiprl.data.answer import CANNOT_TELL, EQUALLY_GOOD, choice, level
from hiprl.store.store import Store, open_store
from hiprl.web.shown import turned
from tests.web.made import IMAGINED, a_taught_run
from tests.web.trainer import CONFIG, begun

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is here (Debian: apt-get install chromium)")
ANY_STORE = pytest.mark.parametrize("made", ["sqlite"], indirect=True)
"""What a browser shows of the same answers does not depend on where they are kept."""
POSTGRESQL_SLOW = pytest.mark.parametrize(
    "made", ["sqlite", pytest.param("postgresql", marks=pytest.mark.slow)], indirect=True
)
"""The same once more on a server, with those of the other slow tests."""
PATIENCE = 60_000  # milliseconds, on a machine that does other things too
expect.set_options(timeout=PATIENCE)  # what a page shows is waited for: its parts change one after the other


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as found:
        yield found


class Served:
    """A store with a page before it, and tabs that look at it."""

    def __init__(self, browser: Any, page: Started, store: Store, run_id: str):
        self.browser, self.store, self.run_id = browser, store, run_id
        self.process, address, self.said = page
        self.home = re.match(r"http://[^/]+", address)[0]
        self.contexts: list[Any] = []
        self.troubles: list[str] = []
        self.sizes: list[int] = []
        self._addresses = iter([address])

    def tab(self, where: str = "", judge: str | None = "ada") -> Any:
        """A browser of its own, which comes in by the newest address."""
        address = next(self._addresses, None) or self.said[-1].split(": ", 1)[1].strip()
        context = self.browser.new_context()
        self.contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(PATIENCE)
        page.on("console", lambda m: self.troubles.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda e: self.troubles.append(str(e)))
        page.on("response", lambda r: self.sizes.append(len(r.body())) if "/next?" in r.url else None)
        page.goto(address)
        if judge is not None:
            page.evaluate("name => localStorage.setItem('hiprl.judge', name)", judge)
        page.goto(f"{self.home}/runs/{self.run_id}{where}")
        return page

    def shown(self, page: Any) -> int:
        """Number of the question on the page."""
        page.wait_for_selector("#teach[data-mode=asking]")
        return int(page.get_attribute("#teach", "data-question"))

    def press(self, page: Any, key: str) -> int:
        """Answers the shown question with a key; gives its number when the next one is there, or none is left."""
        k = self.shown(page)
        page.keyboard.press(key)
        page.wait_for_function(
            "k => { const t = document.getElementById('teach').dataset; return t.question != k || t.mode != 'asking' }",
            arg=str(k),
        )
        return k


def test_a_password_lets_in_by_the_form(made: str, store: Store, browser: Any, monkeypatch: pytest.MonkeyPatch):
    a_taught_run(store, questions=1)
    monkeypatch.setenv("HIPRL_PASSWORD", "open sesame")
    with started("serve", "--store", made, "--port", "8700") as page:
        home = re.match(r"http://[^/]+", page.address)[0]
        context = browser.new_context()
        tab = context.new_page()
        tab.set_default_timeout(PATIENCE)
        tab.goto(home)
        tab.fill("input[type=password]", "open sesame")
        tab.keyboard.press("Enter")
        tab.wait_for_url(f"{home}/")
        expect(tab.locator("body")).not_to_contain_text("Come in")
        context.close()


def test_pages_of_two_stores_know_their_own_browsers_and_a_tab_outlives_its_page(tmp_path: Path, browser: Any):
    paths = [str(tmp_path / f"{name}.db") for name in ("one", "other")]
    with ExitStack() as opened:
        stores = [opened.enter_context(open_store(path)) for path in paths]
        runs = [a_taught_run(store) for store in stores]
        pages = [opened.enter_context(started("serve", "--store", path, "--port", "8700")) for path in paths[1:]]
        context = browser.new_context()
        with started("serve", "--store", paths[0], "--port", "8740") as page:
            home, elsewhere = (re.match(r"http://[^/]+", one.address)[0] for one in (page, pages[0]))
            tab, another = context.new_page(), context.new_page()
            tab.goto(page.address)
            another.goto(pages[0].address)
            for one, where in ((tab, f"{home}/runs/{runs[0]}"), (another, f"{elsewhere}/runs/{runs[1]}")):
                assert one.goto(where).status == 200 and one.url == where  # neither threw the other out
        with started("serve", "--store", paths[0], "--port", "8740"):
            assert tab.reload().status == 200 and tab.url == f"{home}/runs/{runs[0]}"
        context.close()


@pytest.fixture
def served(made: str, store: Store, browser: Any) -> Iterator[Served]:
    run_id = a_taught_run(store, questions=6)
    store.set_goal(run_id, "go along")
    with started("serve", "--store", made, "--port", "8700") as page:
        found = Served(browser, page, store, run_id)
        yield found
        for context in found.contexts:
            context.close()
        assert not found.troubles


def as_shown(store: Store, run_id: str, k: int):
    """The newest answer to a question, the way round in which it was shown."""
    row = [row for row in store.answers(run_id) if row.k == k][-1]
    return turned(row.answer, row.swapped)


@POSTGRESQL_SLOW
def test_a_person_answers_with_keys(served: Served):
    page = served.tab("/teach")
    wanted = {"ArrowLeft": choice(True), "5": level(-2, 5), "2": level(1, 5), "e": EQUALLY_GOOD, "u": CANNOT_TELL}
    for key, answer in wanted.items():
        k = served.press(page, key)
        assert as_shown(served.store, served.run_id, k) == answer, key
    assert {row.judge for row in served.store.answers(served.run_id)} == {"ada"}
    assert served.sizes and max(served.sizes) < 300_000


@ANY_STORE
def test_what_was_only_imagined_is_marked_so(served: Served):
    page = served.tab("/teach")
    for _ in range(3):
        k = served.shown(page)
        shown = [clip.of == IMAGINED for clip in served.store.questions(served.run_id)[k - 1].clips]
        names = page.locator("#stage figcaption")
        expect(names).to_have_text([re.compile(rf"^{side}(, |$)") for side in ("Left", "Right")])
        expect(names.filter(has_text="imagined")).to_have_count(sum(shown))
        served.press(page, "e")


def test_undo_and_reload_lose_nothing(served: Served):
    page = served.tab("/teach")
    first = served.press(page, "1")
    page.keyboard.press("z")
    page.wait_for_function("k => document.getElementById('teach').dataset.question == k", arg=str(first))
    assert served.press(page, "5") == first
    assert as_shown(served.store, served.run_id, first) == level(-2, 5)
    second = served.shown(page)
    page.reload()
    assert served.shown(page) == second  # it is still this judge's
    served.press(page, "e")
    assert len(served.store.answers(served.run_id)) == 3


@ANY_STORE
def test_who_answers_and_goes_at_once_has_answered(served: Served):
    page = served.tab("/teach")
    k = served.shown(page)
    served.process.send_signal(signal.SIGSTOP)  # as one that is busy with others
    page.keyboard.press("2")
    page.close()
    served.process.send_signal(signal.SIGCONT)
    until = time.monotonic() + PATIENCE / 1000
    while not served.store.answers(served.run_id):
        assert time.monotonic() < until
        time.sleep(0.05)
    assert as_shown(served.store, served.run_id, k) == level(1, 5)


@POSTGRESQL_SLOW
def test_a_person_has_had_enough(served: Served):
    with served.store.lease(served.run_id):
        page = served.tab("/teach")
        served.shown(page)
        expect(page.locator("#finish")).to_be_hidden()  # nothing was learned yet
        served.press(page, "1")
        page.click("#finish")
        page.click("#finish-no")
        served.press(page, "1")
        assert not served.store.enough(served.run_id)
        page.click("#finish")
        expect(page.locator("#finishing")).to_contain_text("2 answers")
        page.click("#finish-yes")
        page.wait_for_selector("#teach[data-mode=waiting][data-state=finishing]")
        assert served.store.enough(served.run_id)
        expect(page.locator("#finish")).to_be_hidden()
        served.store.finish(served.run_id, {}, b"")
        page.wait_for_selector("#teach[data-mode=finished]")


@ANY_STORE
def test_a_page_tells_that_nobody_trains(served: Served):
    page = served.tab("/teach")
    for _ in range(6):
        served.press(page, "1")
    page.wait_for_selector("#teach[data-mode=waiting][data-state=stopped]")
    expect(page.locator("#meanwhile-title")).to_contain_text("not running")
    expect(page.locator("#meanwhile-text")).to_contain_text(f"hiprl resume {served.run_id}")
    progress = served.tab("")
    progress.wait_for_selector("#state[data-state=stopped]")
    expect(progress.locator("#helping")).to_contain_text(f"hiprl resume {served.run_id}")
    with served.store.lease(served.run_id):
        page.wait_for_selector("#teach[data-mode=waiting][data-state=learning]")
        expect(page.locator("#meanwhile-title")).to_contain_text("Practising")


def test_two_judges_answer_at_once(served: Served):
    ada, bo = served.tab("/teach", "ada"), served.tab("/teach", "bo")
    assert served.shown(ada) != served.shown(bo)
    for page in (ada, bo, ada, bo):
        served.press(page, "ArrowLeft")
    rows = served.store.answers(served.run_id)
    assert sorted(row.k for row in rows) == [1, 2, 3, 4] and {row.judge for row in rows} == {"ada", "bo"}


@POSTGRESQL_SLOW
def test_the_first_visit_asks_what_is_wanted(made: str, store: Store, browser: Any):
    run_id = a_taught_run(store)
    with started("serve", run_id, "--store", made, "--port", "8700") as page:
        served = Served(browser, page, store, run_id)
        tab = served.tab("/teach", judge=None)
        tab.wait_for_selector("#setup[open]")
        tab.fill("#setup-goal", "<b>hop</b> & run")
        tab.fill("#setup-judge", "zoë")
        tab.click("#setup-save")
        served.press(tab, "ArrowRight")
        expect(tab.locator("#goal")).to_have_text("<b>hop</b> & run")
        assert store.goal(run_id) == "<b>hop</b> & run"
        assert [row.judge for row in store.answers(run_id)] == ["zoë"]
        served.contexts[0].close()
        assert not served.troubles


@ANY_STORE
def test_each_judge_says_a_name_though_the_goal_is_set(served: Served):
    page = served.tab("/teach", judge=None)
    page.wait_for_selector("#setup[open]")
    expect(page.locator("#setup-goal")).to_have_value("go along")
    expect(page.locator("#setup-judge")).to_have_value("")
    expect(page.locator("#setup-judge")).to_be_focused()  # the name is what is missing
    page.keyboard.type("bo")
    page.keyboard.press("Enter")
    served.press(page, "1")
    page.reload()
    served.press(page, "1")
    expect(page.locator("#setup[open]")).to_have_count(0)
    other = served.tab("/teach", judge=None)
    other.wait_for_selector("#setup[open]")
    other.keyboard.press("Escape")
    other.wait_for_selector("#setup:not([open])", state="attached")
    served.press(other, "1")
    expect(other.locator("#who-name")).to_have_text("me")
    third = served.tab("/teach", judge=None)
    third.wait_for_selector("#setup[open]")
    third.click("#setup-save")
    served.press(third, "1")
    judges = [row.judge for row in served.store.answers(served.run_id)]
    assert judges[:2] == ["bo", "bo"] and judges[2] != judges[3]  # two who say no name are two
    assert all(re.fullmatch("me-[0-9a-z]{1,4}", judge) for judge in judges[2:])
    assert served.store.goal(served.run_id) == "go along"


AGAIN = """where => new MutationObserver((_, observer) => {
  observer.disconnect();
  const element = document.querySelector(where);
  Element.prototype.setPointerCapture = () => {};  // of a pointer that is made up
  for (const type of ["pointerdown", "pointerup"]) element.dispatchEvent(new PointerEvent(type, { pointerId: 1 }));
  element.dispatchEvent(new MouseEvent("click", { bubbles: true, detail: 2 }));
}).observe(document.getElementById("teach"), { attributeFilter: ["data-question"] })"""
"""Clicks again as soon as another question is there."""


@ANY_STORE
def test_a_double_click_answers_once(served: Served):
    page = served.tab("/teach")
    for done, where in enumerate(("#stage canvas", "#strip [data-step='2']", "#unsure")):
        k = served.shown(page)
        page.evaluate(AGAIN, where)
        page.click(where)
        page.wait_for_function("k => document.getElementById('teach').dataset.question != k", arg=str(k))
        page.wait_for_timeout(600)  # in which a second answer would come
        assert len(served.store.answers(served.run_id)) == done + 1, where


CLOSE_AND_PRESS = """() => {
  document.getElementById("help").close();  // its button has the focus still, until the page is drawn again
  const press = new KeyboardEvent("keydown", { key: " ", bubbles: true, cancelable: true });
  document.activeElement.dispatchEvent(press);
  return press.defaultPrevented;
}"""


@ANY_STORE
def test_a_key_right_after_a_dialog_is_the_pages(served: Served):
    page = served.tab("/teach")
    served.shown(page)
    button = page.locator("#stage .hp-play")
    expect(button).to_have_attribute("aria-label", "Pause")
    page.click("#help-open")
    assert page.evaluate(CLOSE_AND_PRESS)
    expect(button).to_have_attribute("aria-label", "Play")
    expect(page.locator("dialog[open]")).to_have_count(0)


@ANY_STORE
def test_keys_are_the_pages_again_after_the_mouse(served: Served):
    page = served.tab("/teach")
    k = served.shown(page)
    now = lambda label: expect(page.locator("#stage .hp-play")).to_have_attribute("aria-label", label)
    now("Pause")  # it plays
    for where, label in ((".hp-step", "Play"), (".hp-play", "Play"), ("#help-open", "Pause")):
        page.click(where)
        if where == "#help-open":
            page.keyboard.press("Escape")
            expect(page.locator("dialog[open]")).to_have_count(0)
        page.keyboard.press(" ")
        now(label)
        expect(page.locator("dialog[open]")).to_have_count(0)
    page.click(".hp-scrub")
    page.wait_for_function("() => document.activeElement === document.body")
    now("Play")
    assert served.press(page, "ArrowLeft") == k
    assert as_shown(served.store, served.run_id, k) == choice(True)
    served.shown(page)
    now("Pause")  # the next pair is not held
    page.keyboard.press(" ")
    page.focus(".hp-scrub")
    page.keyboard.press("ArrowRight")  # who comes by keys stays there
    assert page.evaluate("document.activeElement.className") == "hp-scrub"


@ANY_STORE
def test_nothing_moves_where_nobody_wants_it(served: Served):
    page = served.tab("/review")
    page.emulate_media(reduced_motion="reduce")
    page.goto(f"{served.home}/runs/{served.run_id}/teach")
    for label in ("Play", "Pause", "Pause"):
        served.shown(page)
        expect(page.locator("#stage .hp-play")).to_have_attribute("aria-label", label)
        if label == "Play":
            served.press(page, "1")
            expect(page.locator("#stage .hp-play")).to_have_attribute("aria-label", label)
            page.keyboard.press(" ")  # who has pressed play wants it
        served.press(page, "1")


@POSTGRESQL_SLOW
def test_an_answer_is_changed_in_review(served: Served):
    page = served.tab("/teach")
    k = served.press(page, "1")
    served.store.finish_episode(served.run_id, 1, {"k": 1, "disagrees": [k]}, b"1")
    page.goto(f"{served.home}/runs/{served.run_id}/review")
    page.click("#list button")
    page.click("#change [data-step='3']")
    until(lambda: len(served.store.answers(served.run_id)) == 2)
    assert [row.answer for row in served.store.answers(served.run_id)][1:] == [level(0, 5)]


@ANY_STORE
def test_review_takes_the_same_keys_and_says_what_is_known(served: Served):
    served.store.answer(served.run_id, 1, choice(True), "ada")
    page = served.tab("/review")
    expect(page.locator("#summary")).to_have_text("1 answer. It has not looked at it yet.")
    page.click("#list button")
    page.wait_for_selector("#viewer:not([hidden])")
    changed = "words => document.getElementById('said').textContent.endsWith(words)"
    page.keyboard.press("u")
    page.wait_for_function(changed, arg="when it goes on.")
    with served.store.lease(served.run_id):
        for key in ("ArrowDown", "ArrowRight"):  # by which one reads on
            page.keyboard.press(key)
        page.keyboard.press("4")
        page.wait_for_function(changed, arg="learns from this now.")
    page.keyboard.press(" ")  # the list has not kept it
    expect(page.locator(".hp-play")).to_have_attribute("aria-label", "Play")
    served.store.finish(served.run_id, {}, b"")
    page.keyboard.press("e")
    page.wait_for_function(changed, arg="changes nothing.")
    said = [row.answer for row in served.store.answers(served.run_id)]
    assert said == [choice(True), CANNOT_TELL, level(-1, 5), EQUALLY_GOOD]


@contextmanager
def trained(path: str, run_id: str) -> Iterator[subprocess.Popen]:
    """A trainer in a process of its own, which is killed at the end if not before."""
    process = subprocess.Popen([sys.executable, "-m", "tests.web.trainer", path, run_id])
    try:
        yield process
    finally:
        process.kill()
        process.wait()


@pytest.mark.slow
def test_a_trainer_that_is_killed_loses_nothing_and_the_page_goes_on(made: str, store: Store, browser: Any):
    run_id = begun(store)
    store.set_goal(run_id, "go to the middle")
    with started("serve", "--store", made, "--port", "8700") as page:
        served = Served(browser, page, store, run_id)
        with trained(made, run_id) as trainer:
            until(lambda: store.scene(run_id) is not None)
            tab = served.tab("/teach")
            for key in ("1", "5"):
                served.press(tab, key)
            served.shown(tab)
            trainer.kill()  # as by kill -9: it can do nothing about it
            trainer.wait()
        served.press(tab, "2")  # what is open can be answered without it
        before = store.answers(run_id)
        tab.reload()
        with trained(made, run_id) as trainer:
            until(lambda: answered(served, tab) or trainer.poll() is not None)
            assert trainer.wait(PATIENCE) == 0
        after = store.answers(run_id)
        assert len(before) == 3 and after[:3] == before
        assert {row.k for row in after} == set(range(1, CONFIG.comparisons + 1)) and {row.judge for row in after} == {
            "ada"
        }
        assert store.final(run_id)["comparisons"] == CONFIG.comparisons
        tab.wait_for_selector("#teach[data-mode=finished]")
        expect(tab.locator("#count")).to_contain_text(f"{CONFIG.comparisons} of {CONFIG.comparisons} answers")
        served.contexts[0].close()
        assert not served.troubles


def answered(served: Served, tab: Any) -> bool:
    """Whether a run has all its answers, after what is shown was looked at and answered."""
    shown = tab.get_attribute("#teach", "data-question")
    tab.wait_for_timeout(1000)  # what has just come by itself takes no answer yet
    if shown is not None and tab.get_attribute("#teach", "data-question") == shown:
        served.press(tab, "4")
    return served.store.asked(served.run_id) == (CONFIG.comparisons, CONFIG.comparisons)


def until(holds: Callable[[], bool]) -> None:
    """Waits for something to hold."""
    end = time.monotonic() + 5 * PATIENCE / 1000
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.1)


@ANY_STORE
def test_while_there_is_nothing_new_a_doubtful_answer_is_looked_at_again(served: Served):
    with served.store.lease(served.run_id):
        page = served.tab("/teach")
        done = [served.press(page, "1") for _ in range(6)]
        page.wait_for_selector("#teach[data-mode=waiting]")
        expect(page.locator("#to-review a")).to_be_visible()
        served.store.finish_episode(served.run_id, 1, {"k": 1, "disagrees": [done[2]]}, b"1")
        page.wait_for_function("k => document.getElementById('teach').dataset.question == k", arg=str(done[2]))
        expect(page.locator("#again-text")).to_contain_text("would say otherwise")
        served.store.ask(served.run_id, 7, served.store.questions(served.run_id)[0].clips[::-1])
        arrived = "k => document.getElementById('teach').dataset.question == k"
        page.wait_for_function(arrived, arg="7")  # what is new comes by itself
        expect(page.locator("#again")).to_be_hidden()
        page.wait_for_timeout(1000)  # a key that was meant for the other pair does not count
        assert served.press(page, "5") == 7
        assert as_shown(served.store, served.run_id, 7) == level(-2, 5)
        assert len(served.store.answers(served.run_id)) == 7


@ANY_STORE
def test_what_it_does_now_is_told_where_there_is_nothing_to_see(served: Served):
    run_id = a_taught_run(served.store, trajectories=1, questions=0)
    words = "It has tried nothing yet by what you taught it."
    page = served.tab("/teach")
    page.goto(f"{served.home}/runs/{run_id}/teach")
    page.keyboard.press("Escape")
    page.wait_for_selector("#teach[data-mode=waiting]")
    expect(page.locator("#stage")).to_have_text(words, use_inner_text=True)
    page.goto(f"{served.home}/runs/{run_id}")
    page.wait_for_selector("#now-nothing:not([hidden])")
    expect(page.locator("#now-nothing")).to_have_text(words)
    page.goto(f"{served.home}/runs/{served.run_id}")
    page.wait_for_selector("#now canvas")
    expect(page.locator("#now-nothing")).to_be_hidden()


@ANY_STORE
def test_nothing_is_nothing_on_an_axis(served: Served):
    for k, told in enumerate((-0.6, 0.2), 1):
        served.store.finish_episode(served.run_id, k, {"k": k, "true_return": told}, b"%d" % k)
    page = served.tab("")
    ticks = page.locator("#truth-chart .tick")
    expect(ticks.filter(has_text=re.compile("^0$"))).not_to_have_count(0)
    assert not any("e-" in tick for tick in ticks.all_text_contents())


@ANY_STORE
def test_a_long_goal_leaves_room_on_a_phone(served: Served):
    served.store.set_goal(served.run_id, "go along " * 22)
    page = served.tab("/teach")
    page.set_viewport_size({"width": 390, "height": 844})
    served.shown(page)
    expect(page.locator("#goal")).to_contain_text("go along")
    goal = page.evaluate("() => document.getElementById('goal').getBoundingClientRect().height")
    line = page.evaluate("() => parseFloat(getComputedStyle(document.getElementById('goal')).lineHeight)")
    assert goal < 3.5 * line


@ANY_STORE
def test_a_chosen_step_is_told_from_one_that_is_pointed_at(served: Served):
    page = served.tab("/teach")
    served.press(page, "2")
    page.keyboard.press("z")
    page.wait_for_selector("#strip [aria-pressed=true]")
    page.hover("#strip [data-step='1']")
    look = lambda step: page.evaluate(
        "step => { const look = getComputedStyle(document.querySelector(step)); return look.boxShadow }", step
    )
    width = lambda step: max(float(x) for x in re.findall(r"([\d.]+)px inset", look(step)))
    page.wait_for_selector("#strip [data-step='1']:hover")
    page.evaluate(
        "() => Promise.all(document.getElementById('strip').getAnimations({ subtree: true }).map(one => one.finished))"
    )
    assert width("#strip [data-step='2']") > width("#strip [data-step='1']")


def test_progress_and_the_list_of_runs_are_there(served: Served):
    page = served.tab("")
    page.wait_for_selector("main")
    page.goto(served.home)
    expect(page.locator(f"main a[href*='{served.run_id}']").first).to_be_visible()


def serious(page: Any) -> list[str]:
    """What axe-core finds that would keep somebody out."""
    found = Axe().run(page).response["violations"]
    return [f"{one['id']}: {one['help']}" for one in found if one["impact"] in ("serious", "critical")]


@ANY_STORE
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nobody_is_kept_out(served: Served, scheme: str):
    page = served.tab("/teach")
    page.emulate_media(color_scheme=scheme, reduced_motion="reduce")  # contrast is not that of half a fade
    served.press(page, "1")
    served.shown(page)
    found = {"teach": serious(page)}
    for where in ("/review", ""):
        page.goto(f"{served.home}/runs/{served.run_id}{where}")
        page.wait_for_load_state("networkidle" if where else "load")
        page.wait_for_selector("main")
        found[where or "run"] = serious(page)
    page.goto(served.home)
    found["runs"] = serious(page)
    assert not any(found.values()), found
