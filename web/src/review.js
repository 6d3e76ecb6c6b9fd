// Past answers: see their clips again, change one.

import { api, Refused } from "./api.js";
import { announce, find, make, renew, write } from "./dom.js";
import { early, film } from "./film.js";
import { judge } from "./judge.js";
import { level, Strip } from "./strip.js";
import { many, names, said, taken, whenStacked } from "./words.js";

export async function review(run) {
  early();
  const server = api(run);
  const strip = new Strip(find("strip"), { onAnswer: change });
  let scene = null, player = null, open = null, all = [];

  async function list() {
    all = await server.answers();
    const order = (a) => (a.agrees === false ? 0 : 1);
    all.sort((a, b) => order(a) - order(b) || String(b.at).localeCompare(String(a.at)) || b.k - a.k);
    write(find("summary"), `${all.length ? many(all.length, "answer") : "No answers yet"}. ${verdicts()}`.trim());
    const several = new Set(all.map((a) => a.judge)).size > 1;
    renew(find("list"), ...all.map((a) => make("li", {}, make("button.past", {
      type: "button", "data-key": `${a.k} ${a.judge}`, "aria-current": open && same(open, a) ? "true" : null, onclick: () => look(a),
    },
    make("span.past-number", {}, `${a.k}`),
    make("span.past-words", {}, said(a.answer), several ? make("span.past-judge", {}, a.judge === judge() ? "you" : a.judge) : null),
    a.agrees === false ? make("span.tag.differs", {}, "sees it differently")
      : a.agrees === true ? make("span.tag", {}, "agrees") : null))));
  }

  /** What it makes of the answers that say which is better, in words. */
  function verdicts() {
    const sided = all.filter((a) => a.sided);
    const known = sided.filter((a) => a.agrees !== null), differ = known.filter((a) => !a.agrees).length;
    const unknown = sided.length - known.length;
    if (!known.length) return unknown ? `It has not looked at ${unknown === 1 ? "it" : "them"} yet.` : "";
    const rest = unknown ? ` It has not looked at ${unknown === 1 ? "one" : unknown} yet.` : "";
    if (differ) return `It would answer ${differ} of them differently: look at ${differ === 1 ? "that" : "those"} first.${rest}`;
    return unknown ? `None of ${known.length} that it would answer differently.${rest}` : "None that it would answer differently.";
  }

  const same = (a, b) => a.k === b.k && a.judge === b.judge;

  async function look(past) {
    trouble("");
    try {
      scene ??= await server.scene();
      const { question } = await server.question(past.k);
      open = past;
      find("viewer").hidden = false;
      find("empty").hidden = true;
      const { clips } = question;
      player ??= await film(find("stage"), { scene, onPick: () => player.toggle() });
      player.load({ clips, titles: names() });
      player.goOn();
      paint();
      for (const button of find("list").querySelectorAll(".past")) button.removeAttribute("aria-current");
      find("list").children[all.findIndex((a) => same(a, past))]?.firstChild.setAttribute("aria-current", "true");
      if (matchMedia("(max-width: 900px)").matches) {
        find("viewer").scrollIntoView({ behavior: matchMedia("(prefers-reduced-motion: reduce)").matches ? "auto" : "smooth" });
      }
    } catch (error) {
      trouble(error, () => look(past));
    }
  }

  function paint() {
    if (!open) return;
    const mine = open.judge === judge();
    const words = said(open.answer);
    write(find("asked"), `Question ${open.k}`);
    write(find("said"), `${mine ? "You" : open.judge} said: ${words}.`
      + (open.agrees === false ? " It learned something else from all your answers together." : ""));
    find("change").hidden = !mine;
    find("others").hidden = mine;
    write(find("others"), `Only ${open.judge} can change this answer.`);
    strip.show(open.answer);
    strip.busy = false;
    find("unsure").setAttribute("aria-pressed", String(open.answer?.form === "unsure"));
  }

  async function change(answer) {
    if (!open) return;
    const past = open;
    trouble("");
    strip.busy = true;
    strip.mark(answer);
    try {
      const { progress } = await server.answer({ k: past.k, judge: past.judge, swapped: false, answer });
      past.answer = answer;
      past.agrees = null;
      announce(`Changed to: ${said(answer)}`);
      await list();
      const fresh = all.find((a) => same(a, past));
      if (open === past && fresh) open = fresh;
      paint();
      write(find("said"), `Changed to: ${said(answer)}. ${taken(progress)}`);
    } catch (error) {
      strip.busy = false;
      trouble(error, () => change(answer));
    }
  }

  function trouble(error, retry) {
    const box = find("trouble");
    box.hidden = !error;
    if (!error) return;
    write(find("trouble-text"), error instanceof Refused ? error.message : "This page cannot draw the clips or lost its way.");
    find("trouble-again").onclick = () => retry();
    if (!(error instanceof Refused)) console.error(error);
  }

  /** The answer that belongs to a key, as where one teaches; but arrows, by which a list is read, change nothing. */
  function keyed(key) {
    if (key === "u" || key === "?") return { form: "unsure" };
    if (/^[1-5]$/.test(key)) return level(Number(key));
    return key === "e" ? { form: "equal" } : null;
  }

  for (const id of ["list", "change"]) {
    find(id).addEventListener("click", (event) => {
      if (event.detail) event.target.closest("button")?.blur(); // keys are the page's again
    });
  }
  find("unsure").addEventListener("click", () => change({ form: "unsure" }));
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || !open) return;
    const { tagName, type } = event.target;
    if (tagName === "INPUT" && (type !== "range" || /^(Arrow|Home|End|Page)/.test(event.key))) return;
    const given = open.judge === judge() && !event.repeat ? keyed(event.key.toLowerCase()) : null;
    if (event.key === " " && tagName !== "BUTTON" && tagName !== "A") player?.toggle();
    else if (event.key === "[") player?.nudge(-1);
    else if (event.key === "]") player?.nudge(1);
    else if (event.key === "+" || event.key === "=") player?.faster();
    else if (event.key === "-") player?.slower();
    else if (given) change(given);
    else return;
    event.preventDefault();
  });
  whenStacked(() => {
    if (!open) return;
    player?.name(names());
    paint();
  });

  const begin = async () => {
    trouble("");
    try {
      await list();
      find("empty").hidden = all.length > 0 && Boolean(open);
      if (all.length && !matchMedia("(max-width: 900px)").matches) await look(all[0]);
      else if (all.length) write(find("empty"), "Choose an answer to see its clips again.");
    } catch (error) {
      trouble(error, begin);
    }
  };
  await begin();
}
