// How a run goes: curves, what it understood, what it does now; renewed as it learns.

import { api, Refused } from "./api.js";
import { chart } from "./chart.js";
import { find, make, write } from "./dom.js";
import { early, film } from "./film.js";
import { foreseen, helping, many, short, stopped } from "./words.js";

const BARS = 12; // parts of the reward that are shown at first

const known = (x) => typeof x === "number" && Number.isFinite(x);
const number = (x) => (typeof x === "boolean" ? Number(x) : x);

export async function progress(run) {
  early();
  const server = api(run);
  let scene = null, player = null, shown = null, busy = false, due = false;

  function curve(id, episodes, key, title, options = {}) {
    const points = episodes.filter((e) => known(number(e[key]))).map((e) => [e.k, number(e[key])]);
    find(id).hidden = points.length < 2;
    if (points.length < 2) return false;
    find(`${id}-chart`).replaceChildren(chart({
      series: [{ name: title, points }], across: "episodes", title: `${title}: ${short(points[0][1])} at first, ${short(points.at(-1)[1])} now`, ...options,
    }));
    return true;
  }

  /** Share of the last ten answers that were foreseen, where each one is told. */
  function share(episodes) {
    const each = episodes.filter((e) => e.foreseen !== null && e.foreseen !== undefined);
    if (each.every((e) => typeof e.foreseen === "boolean" || e.foreseen === 0 || e.foreseen === 1)) {
      return each.map((e, i) => {
        const last = each.slice(Math.max(0, i - 9), i + 1);
        return { ...e, foreseen: last.reduce((sum, x) => sum + Number(x.foreseen), 0) / last.length };
      });
    }
    return each;
  }

  function bars(weights) {
    const parts = Object.entries(weights ?? {}).filter(([, v]) => known(v)).sort((a, b) => Math.abs(b[1]) - Math.abs(a[1]));
    find("weights").hidden = !parts.length;
    const most = Math.max(...parts.map(([, v]) => Math.abs(v)), 1e-9);
    const total = parts.reduce((sum, [, v]) => sum + Math.abs(v), 0) || 1;
    find("weights-list").replaceChildren(...parts.slice(0, BARS).map(([name, v]) => {
      const bar = make("span.weight-bar", { "data-sign": v < 0 ? "minus" : "plus" });
      bar.style.width = `${(100 * Math.abs(v)) / most}%`;
      return make("li.weight", {},
        make("span.weight-name", {}, name),
        make("span.weight-track", { "aria-hidden": "true" }, bar),
        make("span.weight-share", {}, `${v < 0 ? "−" : ""}${Math.round((100 * Math.abs(v)) / total)} %`));
    }));
  }

  function judges(each, agreement) {
    find("judges").hidden = !each.length;
    find("judges-list").replaceChildren(...each.map(({ judge, answers, mistakes }) =>
      make("li", {}, `${judge}: ${many(answers, "answer")}${known(mistakes) ? `, wrong in about ${Math.round(100 * mistakes)} %` : ""}`)));
    find("agreement").hidden = !known(agreement);
    write(find("agreement"), `Asked the same, two of you say the same in ${Math.round(100 * (agreement ?? 0))} %.`);
  }

  function table(episodes) {
    const row = (cells, tag) => make("tr", {}, cells.map((c) => make(tag, tag === "th" ? { scope: "col" } : {}, c)));
    find("table-head").replaceChildren(row(["Episode", "Answers", "By what it learned", "True return"], "th"));
    find("table-body").replaceChildren(...episodes.map((e) =>
      row([`${e.k}`, `${e.comparisons ?? "–"}`, short(e.return_by_reward), short(e.true_return)], "td")));
  }

  async function facts() {
    const got = await server.facts();
    const { episodes } = got;
    const any = curve("learned", episodes, "return_by_reward", "Return by what it learned");
    const truth = curve("truth", episodes, "true_return", "True return");
    curve("foreseen", share(episodes), "foreseen", "Answers it foresaw", { floor: 0, ceiling: 1, percent: true });
    curve("worth-of", episodes, "worth", "Worth of the next answer", { floor: 0 });
    curve("coverage", episodes, "coverage", "Coverage", { floor: 0, ceiling: 1, percent: true });
    judges(got.judges ?? [], got.agreement);
    bars(got.weights);
    table(episodes);
    find("numbers").hidden = !episodes.length;
    find("nothing").hidden = any || truth;
    const list = got.pictures ?? [];
    find("pictures").hidden = !list.length;
    find("pictures-list").replaceChildren(...list.map((it) => {
      const safe = new URL(it.url, location.href);
      return make("li", {}, make("a", { href: safe.origin === location.origin ? safe.href : "#" }, it.title));
    }));
  }

  function told(it) {
    write(find("count"), `${it.answers}`);
    write(find("planned"), it.planned ? `of ${many(it.planned, "answer")}` : it.answers === 1 ? "answer" : "answers");
    write(find("sure"), foreseen(it));
    const gone = it.state === "stopped";
    write(find("helping"), gone ? stopped(run, it.people) : helping(it));
    for (const id of ["sure", "helping"]) find(id).hidden = !find(id).textContent;
    if (find("go-on")) find("go-on").hidden = ["finished", "stopped"].includes(it.state);
    write(find("state"), { stopped: "Not running", "warming up": "Trying out movements", waiting: "Waiting for your answers", learning: "Practising", finishing: "Practising for the last time", finished: "Finished" }[it.state] ?? it.state);
    find("state").dataset.state = it.state;
    if (it.goal) write(find("goal"), it.goal);
  }

  async function now() {
    const got = await server.now();
    find("now-nothing").hidden = Boolean(got.clip);
    if (!got.clip || got.clip.trajectory === shown) return;
    shown = got.clip.trajectory;
    scene ??= await server.scene();
    find("now").hidden = false;
    write(find("now-label"), `Episode ${got.episode}`);
    if (player) player.load({ clips: [got.clip] });
    else player = await film(find("now-stage"), { scene, clips: [got.clip], onPick: () => player.toggle() });
  }

  async function renew() {
    if (busy) {
      due = true;
      return;
    }
    busy = true;
    find("trouble").hidden = true;
    try {
      do {
        due = false;
        await facts();
        await now();
      } while (due);
    } catch (error) {
      write(find("trouble-text"), error instanceof Refused ? error.message : "This page cannot draw this run.");
      find("trouble").hidden = false;
      if (!(error instanceof Refused)) console.error(error);
    }
    busy = false;
  }

  find("trouble-again").addEventListener("click", renew);
  let seen = "";
  server.events((it) => {
    told(it);
    const mark = `${it.answers} ${it.episodes} ${it.state}`;
    if (mark !== seen) {
      const first = seen === "";
      seen = mark;
      if (!first) renew();
    }
  });
  await renew();
}
