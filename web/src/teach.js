// The page where a person teaches: a pair of clips, an answer, the next pair.

import { api, Refused } from "./api.js";
import { announce, find, write } from "./dom.js";
import { early, film } from "./film.js";
import { call, judge, myself, named } from "./judge.js";
import { level, Strip } from "./strip.js";
import { foreseen, helping, many, meanwhile, names, NOTHING, said, taken, whenStacked } from "./words.js";

const POLL = 1000; // milliseconds between looks for a question
const LINGER = 600; // the old pair stays so long before the page says that it waits
const SECOND = 400; // a second click that comes so soon after an answer was meant for the pair before
const SETTLE = 800; // a pair that came by itself takes no answer for so long: it was meant for the one before

export async function teach(run) {
  early();
  await new Teaching(run).start();
}

class Teaching {
  constructor(run) {
    this.run = run;
    this.api = api(run);
    this.question = null; // as the server gave it
    this.flipped = false; // sides swapped here, on top of the server's
    this.again = false; // an earlier answer is being changed
    this.second = false; // one that it would give otherwise, shown while there is nothing new
    this.looked = new Set(); // numbers of those that were shown so
    this.settled = 0; // when answers count again
    this.clickable = 0; // when clicks do
    this.busy = false;
    this.answered = null; // number of the question answered last
    this.asking = 0; // counts looks for a question: only the newest counts
    this.goal = document.body.dataset.goal || "";
    this.strip = new Strip(find("strip"), {
      onAnswer: (a, event) => this.#meant(event) && this.answer(a), onHover: (side) => this.hint(side),
    });
    this.nowOf = null; // which state of the run is shown as what it does now
  }

  async start() {
    this.#wire();
    this.#who();
    try {
      this.scene = await this.api.scene();
      this.player = await film(find("stage"), {
        scene: this.scene,
        nothing: NOTHING,
        onPick: (i, event) => this.#meant(event) && this.pick(i),
        onChange: (player) => this.#follow(player),
      });
    } catch (error) {
      this.trouble(error, () => location.reload());
      return;
    }
    this.api.events((progress) => {
      this.progress(progress);
      if ((this.question && !this.second) || this.busy) return;
      if (this.#wake) this.#wake();
      else if (find("teach").dataset.mode === "finished" && progress.state !== "finished") this.next();
    });
    if (!this.goal || !named()) this.setup(true);
    await this.next();
  }

  // questions

  /** Looks for the next question until there is one. */
  async next({ announceIt = true } = {}) {
    const mine = ++this.asking;
    const began = performance.now();
    this.again = this.second = false;
    find("again").hidden = true;
    let waited = false;
    while (mine === this.asking) {
      let got;
      try {
        got = await this.api.next(judge());
      } catch (error) {
        if (mine !== this.asking) return;
        this.trouble(error, () => this.next());
        return;
      }
      if (mine !== this.asking) return;
      this.calm();
      this.progress(got.progress);
      const question = got.question;
      if (question && question.k !== this.answered && !(this.second && this.busy)) {
        if (this.second) this.settled = performance.now() + SETTLE;
        this.again = this.second = false;
        find("again").hidden = true;
        if (this.answered !== null) this.clickable = performance.now() + SECOND;
        this.show(question);
        if (announceIt) {
          const { answers, planned } = got.progress;
          announce(`Next pair: ${answers + 1}${planned ? ` of ${planned}` : ""}`);
        }
        return;
      }
      if (this.second && got.progress.state === "finished" && !this.busy) {
        this.again = this.second = false;
        this.question = null;
        find("again").hidden = true;
      }
      if (!this.second && (performance.now() - began > LINGER || !this.player.clips.length || got.progress.state === "finished")) {
        this.wait(got.progress);
        waited = true;
      }
      if (got.progress.state === "finished") return;
      if (waited && !this.second) await this.#lookAgain(mine);
      await this.#sleep(waited ? POLL : 150);
    }
  }

  /** While there is nothing new: shows a pair about which it is of another opinion. */
  async #lookAgain(mine) {
    if (!this.state?.answers || this.state.state === "stopped") return;
    let question;
    try {
      const past = await this.api.answers();
      const found = past.find((a) => a.judge === judge() && a.agrees === false && !this.looked.has(a.k));
      if (!found) return;
      ({ question } = await this.api.question(found.k));
    } catch {
      return; // the next look for a question tells of it
    }
    if (mine !== this.asking || this.busy) return;
    this.looked.add(question.k);
    this.again = this.second = true;
    this.show(question);
    announce(this.#said());
  }

  /** Tells what was said of what is shown, as it is shown now; gives the words. */
  #said() {
    const words = `You said: ${said(this.shown(this.question.answer))}. `
      + (this.second ? "It would say otherwise: look again, while it tries something new?" : "What is right?");
    write(find("again-text"), words);
    find("again").hidden = false;
    return words;
  }

  #wake = null;

  /** Sleeps until time is over or something happened. */
  #sleep(ms) {
    return new Promise((done) => {
      const clock = setTimeout(() => done(), ms);
      this.#wake = () => {
        clearTimeout(clock);
        this.#wake = null;
        setTimeout(done, 60);
      };
    });
  }

  show(question) {
    this.question = question;
    this.flipped = false;
    this.mode("asking");
    const main = find("teach");
    main.dataset.question = String(question.k);
    this.busy = this.strip.busy = false;
    this.#dim(false);
    this.player.load({ clips: this.clips(), titles: names() });
    this.player.goOn();
    this.strip.show(this.shown(question.answer));
    this.hint(0);
  }

  /** Clips in the order of this screen. */
  clips() {
    return this.flipped ? [...this.question.clips].reverse() : this.question.clips;
  }

  /** An answer in the server's order turned to what is shown here, or back. */
  shown(answer) {
    return this.flipped && typeof answer?.value === "number" ? { ...answer, value: -answer.value } : answer;
  }

  async answer(answer) {
    if (!this.question || this.busy || !this.player || performance.now() < this.settled) return;
    const { k, swapped } = this.question;
    this.busy = this.strip.busy = true;
    this.strip.mark(answer);
    this.#dim(true);
    let words = `You said: ${said(answer)}`;
    try {
      const { progress } = await this.api.answer({
        k, judge: judge(), swapped: swapped !== this.flipped, answer,
      });
      this.progress(progress);
      if (progress.state.startsWith("finish")) words += `. ${taken(progress)}`;
    } catch (error) {
      this.busy = this.strip.busy = false;
      this.#dim(false);
      const gone = error instanceof Refused && [404, 409, 410].includes(error.status);
      this.trouble(error, gone ? () => this.next() : () => this.answer(answer), gone ? "Go on" : "Try again");
      return;
    }
    this.answered = k;
    this.question = null;
    this.told(words, true);
    await this.next();
  }

  /** Whether an answer by this event is one to the pair that is shown; keys do not come twice. */
  #meant(event) {
    const clicked = event?.detail > 0 || event?.type === "pointerup";
    return !clicked || performance.now() >= this.clickable;
  }

  pick(index) {
    if (this.question) this.answer({ form: "choice", value: index ? -1 : 1 });
    else this.player.toggle();
  }

  async undo() {
    if (this.busy || (this.again && !this.second)) return;
    let question;
    try {
      ({ question } = await this.api.last(judge()));
    } catch (error) {
      this.trouble(error, () => this.undo());
      return;
    }
    if (!question) {
      this.told("There is nothing to undo yet", false);
      return;
    }
    this.asking++; // whoever looks for the next question stops
    this.again = true;
    this.second = false;
    this.answered = null;
    this.told("", false);
    this.show(question);
    announce(`Changing your last answer. ${this.#said()}`);
  }

  back() {
    if (!this.again) return;
    this.answered = this.question?.k ?? null;
    this.question = null;
    this.next();
  }

  swap() {
    if (!this.question || this.busy) return;
    this.flipped = !this.flipped;
    this.player.load({ clips: this.clips(), titles: names(), keepTime: true });
    this.strip.show(this.shown(this.question.answer));
    if (this.again) this.#said();
    announce("Sides swapped");
  }

  // what is on the screen

  /** One of "loading", "asking", "waiting", "finished". */
  mode(mode) {
    const main = find("teach");
    if (main.dataset.mode === mode) return;
    main.dataset.mode = mode;
    find("answers").hidden = mode !== "asking";
    find("meanwhile").hidden = mode !== "waiting" && mode !== "finished";
    find("to-progress").hidden = mode !== "finished";
    find("to-review").hidden = mode !== "waiting" || !this.state?.answers;
    find("small").hidden = mode !== "asking";
    if (mode !== "asking") delete main.dataset.question;
  }

  async wait(progress) {
    const [title, text] = meanwhile(progress, this.run);
    const fresh = find("teach").dataset.mode === "asking" || find("teach").dataset.mode === "loading";
    this.mode(progress.state === "finished" ? "finished" : "waiting");
    this.question = null;
    this.busy = this.strip.busy = false;
    this.#dim(false);
    const other = find("meanwhile-title").textContent !== title;
    write(find("meanwhile-title"), title);
    write(find("meanwhile-text"), text);
    if (fresh || other) announce(`${title} ${text}`);
    if (fresh) {
      this.nowShown = null;
      this.player.goOn();
    }
    await this.#now();
  }

  progress(progress) {
    if (!progress) return;
    const { answers, planned } = progress;
    this.state = progress;
    if (progress.goal && progress.goal !== this.goal) this.#goal(progress.goal);
    const bar = find("bar");
    bar.max = Math.max(planned || 0, answers, 1);
    bar.value = answers;
    write(find("count"), planned ? `${answers} of ${many(planned, "answer")}` : many(answers, "answer"));
    write(find("sure"), foreseen(progress));
    write(find("worth"), helping(progress));
    find("finish").hidden = !answers || ["finishing", "finished", "stopped"].includes(progress.state);
    find("teach").dataset.state = progress.state;
    if (this.#newest() !== this.nowOf) this.#now();
  }

  /** Names what it does now: another one after each episode, and at the end. */
  #newest() {
    return `${this.state.episodes}${this.state.state === "finished" ? " at the end" : ""}`;
  }

  #fetching = false;

  /** Brings what it does now up to date, small beside the pair or large while there is none. */
  async #now() {
    if (!this.player || !this.state) return;
    if (this.#newest() !== this.nowOf && !this.#fetching) {
      this.#fetching = true;
      const newest = this.#newest();
      try {
        const got = await this.api.now();
        this.nowClip = got.clip;
        this.nowLabel = `Episode ${got.episode}`;
      } catch {
        // asked again at the next episode
      }
      this.nowOf = newest;
      this.#fetching = false;
    }
    if (!this.nowClip) {
      const bare = find("teach").dataset.mode !== "asking";
      if (bare && this.player.clips.length) this.player.load({ clips: [] });
      return;
    }
    const large = ["waiting", "finished"].includes(find("teach").dataset.mode);
    if (large) {
      if (this.nowShown === this.nowClip) return;
      this.nowShown = this.nowClip;
      this.player.load({ clips: [this.nowClip], titles: ["What I do now"] });
    } else if (this.smallShown !== this.nowClip) {
      this.smallShown = this.nowClip;
      find("now").hidden = false;
      write(find("now-label"), this.nowLabel);
      if (this.small) this.small.load({ clips: [this.nowClip], titles: [] });
      else {
        this.small = await film(find("now-stage"), {
          scene: this.scene, clips: [this.nowClip], bar: false, onPick: () => this.small.toggle(),
        });
        if (!this.player.playing) this.small.pause();
      }
    }
  }

  #follow(player) {
    if (!this.small || this.small.playing === player.playing) return;
    if (player.playing) this.small.play();
    else this.small.pause();
  }

  #dim(dim) {
    find("stage").classList.toggle("dim", dim);
  }

  /** Marks the side that an answer would prefer. */
  hint(side) {
    const figures = find("stage").querySelectorAll(".hp-clip");
    figures.forEach((figure, i) => figure.classList.toggle("liked", side !== 0 && figures.length === 2 && i === (side > 0 ? 0 : 1)));
  }

  told(text, undoable) {
    write(find("told-text"), text);
    find("told").classList.toggle("shown", Boolean(text));
    find("undo-told").hidden = !undoable;
  }

  trouble(error, retry, label = "Try again") {
    const box = find("trouble");
    write(find("trouble-text"), error instanceof Refused ? error.message : "This page cannot draw the clips or lost its way.");
    const again = find("trouble-again");
    again.textContent = label;
    again.onclick = () => {
      box.hidden = true;
      retry();
    };
    box.hidden = false;
    if (!(error instanceof Refused)) console.error(error);
  }

  calm() {
    find("trouble").hidden = true;
  }

  #goal(goal) {
    this.goal = goal;
    write(find("goal"), goal);
    find("goal").classList.remove("unset");
  }

  /** Asks whether that was all. */
  #offer() {
    const { answers } = this.state;
    write(find("finish-count"), answers === 1 ? "one answer" : `${answers} answers`);
    find("finishing").showModal();
  }

  async #finish() {
    find("finishing").close();
    try {
      this.progress((await this.api.enough(judge())).progress);
    } catch (error) {
      this.trouble(error, () => this.#finish());
      return;
    }
    this.question = null;
    await this.next();
  }

  #who() {
    write(find("who-name"), myself());
  }

  /** Asks what it should learn, and who is asking. */
  setup(first = false) {
    const dialog = find("setup");
    find("setup-goal").value = this.goal;
    find("setup-judge").value = named() && myself() !== "me" ? judge() : "";
    find("setup-trouble").hidden = true;
    find("setup-close").hidden = first;
    if (!dialog.open) dialog.showModal();
    if (this.goal && !named()) find("setup-judge").focus();
  }

  async #save(event) {
    event.preventDefault();
    const goal = find("setup-goal").value.trim();
    const before = judge();
    const now = call(find("setup-judge").value);
    this.#who();
    if (goal && goal !== this.goal) {
      find("setup-save").disabled = true;
      try {
        await this.api.goal(goal);
        this.#goal(goal);
      } catch (error) {
        write(find("setup-trouble"), error.message);
        find("setup-trouble").hidden = false;
        return;
      } finally {
        find("setup-save").disabled = false;
      }
    }
    find("setup").close();
    if (now !== before) {
      this.answered = null;
      this.next({ announceIt: false });
    }
  }

  // hands

  #wire() {
    const on = (id, each) => find(id)?.addEventListener("click", (event) => {
      if (event.detail) event.currentTarget?.blur?.(); // so that the space bar pauses afterwards, a dialog's too
      each(event);
    });
    find("strip").addEventListener("click", (event) => {
      if (event.detail) document.activeElement?.blur?.();
    });
    on("unsure", (event) => this.#meant(event) && this.answer({ form: "unsure" }));
    on("undo", () => this.undo());
    on("undo-told", () => this.undo());
    on("swap", () => this.swap());
    on("help-open", () => this.help());
    on("edit", () => this.setup());
    on("who", () => this.setup());
    on("again-back", () => this.back());
    on("finish", () => this.#offer());
    find("finish-no").addEventListener("click", () => find("finishing").close());
    find("finish-yes").addEventListener("click", () => this.#finish());
    find("setup-form").addEventListener("submit", (event) => this.#save(event));
    find("setup-close").addEventListener("click", () => find("setup").close());
    find("help-close").addEventListener("click", () => find("help").close());
    whenStacked(() => {
      if (!this.question) return;
      this.player.name(names());
      this.strip.show(this.shown(this.question.answer));
      if (this.again) this.#said();
    });
    document.addEventListener("keydown", (event) => this.key(event));
  }

  help() {
    const dialog = find("help");
    if (dialog.open) dialog.close();
    else dialog.showModal();
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const inHelp = find("help").open;
    if (document.querySelector("dialog[open]") && !(inHelp && event.key === "h")) return;
    const { target, key } = event;
    const tag = inHelp || !target.closest("dialog") ? target.tagName : ""; // a closed one has the focus for a frame
    if (tag === "TEXTAREA" || tag === "SELECT" || (tag === "INPUT" && target.type !== "range")) return;
    if (tag === "INPUT" && /^(Arrow|Home|End|Page)/.test(key)) return;
    if ((tag === "BUTTON" || tag === "A" || tag === "SUMMARY") && (key === " " || key === "Enter")) {
      if (event.repeat) event.preventDefault(); // a key that is held answers once
      return;
    }
    const once = (each) => (event.repeat ? null : each());
    const asked = Boolean(this.question);
    const act = {
      ArrowLeft: () => asked && once(() => this.answer({ form: "choice", value: 1 })),
      ArrowRight: () => asked && once(() => this.answer({ form: "choice", value: -1 })),
      e: () => asked && once(() => this.answer({ form: "equal" })),
      u: () => once(() => this.answer({ form: "unsure" })),
      "?": () => once(() => this.answer({ form: "unsure" })),
      z: () => once(() => this.undo()),
      Backspace: () => once(() => this.undo()),
      Escape: () => this.back(),
      s: () => once(() => this.swap()),
      h: () => once(() => this.help()),
      " ": () => once(() => this.player?.toggle()),
      "+": () => this.player?.faster(),
      "=": () => this.player?.faster(),
      "-": () => this.player?.slower(),
      "[": () => this.player?.nudge(-1),
      "]": () => this.player?.nudge(1),
      r: () => this.player?.resetView(),
    }[key.length === 1 ? key.toLowerCase() : key];
    if (act) {
      if (act() !== false) event.preventDefault();
    } else if (/^[1-5]$/.test(key) && asked) {
      once(() => this.answer(level(Number(key))));
    }
  }
}
