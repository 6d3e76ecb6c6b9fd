// Plays one or several clips in step: play and pause, scrub, speed, and a view that can be turned.

import { unpack } from "./decode.js";
import { stageOf } from "./stages.js";
import { drop, keep } from "./ticker.js";
import sheet from "./player.css";

const SPEEDS = [0.25, 0.5, 1, 2, 4];
const HOLD = 0.7; // seconds on the last frame before clips start again
const FULL = 30, SPARING = 150; // milliseconds between pictures where drawing is slow: of a large player, of a small one
const TAP = 6; // pixels a pointer may move and still click
const still = matchMedia("(prefers-reduced-motion: reduce)");
const night = matchMedia("(prefers-color-scheme: dark)");

function make(tag, className, text) {
  const element = document.createElement(tag);
  if (className) element.className = className;
  if (text !== undefined) element.textContent = text;
  return element;
}

function button(className, label, text) {
  const element = make("button", className, text);
  element.type = "button";
  element.setAttribute("aria-label", label);
  element.title = label;
  return element;
}

class Player {
  /**
   * scene: as from the server. clips: what to show. titles: a name for each clip. title: of the whole.
   * nothing: what is said where there is no clip. bar: whether there are controls. onPick(index): a clip was clicked. onChange(): something about playing changed.
   */
  constructor(element, { scene, clips = [], titles = [], title = "", nothing = "", bar = true, onPick = null, onChange = null }) {
    this.scene = scene;
    this.nothing = nothing;
    this.onPick = onPick;
    this.onChange = onChange;
    this.stage = stageOf(scene);
    this.root = make("div", "hp");
    this.heading = make("p", "hp-title", title);
    this.heading.hidden = !title;
    this.cells = make("div", "hp-clips");
    this.root.append(this.heading, this.cells);
    this.chosen = null; // the speed somebody asked for
    this.speed = 1;
    this.time = 0;
    this.playing = this.moves = !still.matches;
    this.seen = true;
    if (bar) this.#bar();
    element.replaceChildren(this.root);

    this.sizes = new ResizeObserver(() => this.draw());
    this.sizes.observe(this.cells);
    this.sight = new IntersectionObserver(([entry]) => {
      this.seen = entry.isIntersecting;
      this.#run();
    });
    this.sight.observe(this.root);
    this.repaint = () => this.draw();
    night.addEventListener("change", this.repaint);
    this.beat = (now) => this.#beat(now);
    this.load({ clips, titles });
  }

  /** Shows other clips from their beginning; speed, view and playing stay. */
  load({ clips, titles = [], keepTime = false }) {
    this.clips = clips.map((clip) => unpack(clip, this.scene));
    if (!keepTime) this.time = 0;
    this.length = Math.max(0, ...this.clips.map((clip) => (clip.count - 1) * this.scene.dt));
    if (this.clips.length) this.stage.load(this.clips);
    this.stage.ready?.then(() => this.draw());
    if (this.figures?.length !== this.clips.length) this.#figures();
    this.name(titles);
    if (this.chosen === null) this.speed = this.length >= 1.6 ? 1 : this.length >= 0.8 ? 0.5 : 0.25;
    if (this.scrub) {
      this.scrub.max = String(this.length || 1);
      this.scrub.step = String(Math.max(this.scene.dt, 1e-3));
    }
    this.draw();
    this.#run();
    this.#say();
  }

  name(titles) {
    this.figures.forEach(({ caption, canvas }, i) => {
      const imagined = Boolean(this.clips[i].imagined);
      const words = [titles[i], imagined && "imagined"].filter(Boolean).join(", ");
      caption.textContent = words;
      caption.hidden = !words;
      canvas.setAttribute("aria-label", words ? `Clip: ${words}` : "Clip of the body moving");
    });
  }

  #figures() {
    this.cells.replaceChildren();
    this.cells.dataset.count = String(this.clips.length);
    this.figures = this.clips.map((_, i) => {
      const figure = make("figure", "hp-clip");
      const canvas = make("canvas");
      canvas.setAttribute("role", "img");
      const caption = make("figcaption", "hp-name");
      const ended = make("span", "hp-ended", "ended here");
      ended.hidden = true;
      figure.append(canvas, caption, ended);
      figure.classList.toggle("hp-picks", Boolean(this.onPick));
      figure.classList.toggle("hp-turns", this.stage.turns);
      this.#pointer(canvas, i);
      this.cells.append(figure);
      return { figure, canvas, caption, ended };
    });
    if (!this.clips.length && this.nothing) this.cells.append(make("p", "hp-none", this.nothing));
  }

  #pointer(canvas, index) {
    const down = new Map();
    let moved = 0, gap = 0, many = false;
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button) return;
      if (!down.size) {
        moved = 0;
        many = false;
      }
      down.set(event.pointerId, [event.clientX, event.clientY]);
      many ||= down.size > 1;
      gap = 0;
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      const last = down.get(event.pointerId);
      if (!last) return;
      const dx = event.clientX - last[0], dy = event.clientY - last[1];
      down.set(event.pointerId, [event.clientX, event.clientY]);
      moved += Math.hypot(dx, dy);
      if (!this.stage.turns) return;
      if (down.size > 1) {
        const [a, b] = [...down.values()];
        const now = Math.hypot(a[0] - b[0], a[1] - b[1]);
        if (gap) this.stage.zoom(now / gap);
        gap = now;
      } else if (moved > TAP) {
        this.stage.turn(-dx * 0.4, dy * 0.3);
      } else return;
      this.#turned();
    });
    const up = (event) => {
      if (!down.delete(event.pointerId) || down.size) return;
      if (event.type === "pointerup" && !many && moved <= TAP) this.onPick?.(index, event);
    };
    canvas.addEventListener("pointerup", up);
    canvas.addEventListener("pointercancel", up);
    canvas.addEventListener("wheel", (event) => {
      if (!this.stage.turns || !event.ctrlKey) return;
      event.preventDefault();
      this.stage.zoom(Math.exp(-event.deltaY * 0.004));
      this.#turned();
    }, { passive: false });
  }

  #bar() {
    const bar = make("div", "hp-bar");
    bar.addEventListener("click", (event) => {
      if (event.detail) event.target.closest("button")?.blur(); // keys are the page's again
    });
    this.button = button("hp-play", "Pause");
    this.button.addEventListener("click", () => this.toggle());
    this.scrub = make("input", "hp-scrub");
    this.scrub.type = "range";
    this.scrub.min = "0";
    this.scrub.value = "0";
    this.scrub.setAttribute("aria-label", "Time in the clip");
    this.scrub.addEventListener("input", () => {
      this.pause();
      this.seek(Number(this.scrub.value));
    });
    let held = false;
    const release = () => {
      if (held) this.scrub.blur();
      held = false;
    };
    this.scrub.addEventListener("pointerdown", () => {
      this.pause(); // also where it is taken just where it is
      held = true;
      addEventListener("pointerup", () => setTimeout(release), { once: true });
    });
    this.scrub.addEventListener("change", release);
    this.clock = make("span", "hp-clock");
    const pace = make("div", "hp-pace");
    this.less = button("hp-step", "Slower", "−");
    this.more = button("hp-step", "Faster", "+");
    this.pace = make("span", "hp-speed");
    this.less.addEventListener("click", () => this.slower());
    this.more.addEventListener("click", () => this.faster());
    pace.append(this.less, this.pace, this.more);
    this.view = button("hp-view", "Turn the view back", "Reset view");
    this.view.hidden = true;
    this.view.addEventListener("click", () => this.resetView());
    bar.append(this.button, this.scrub, this.clock, pace, this.view);
    this.root.append(bar);
  }

  #turned() {
    if (this.view) this.view.hidden = !this.stage.turned;
    this.draw();
  }

  resetView() {
    this.stage.reset?.();
    this.#turned();
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  /** Plays on, unless nothing is to move here and nobody has pressed play. */
  goOn() {
    if (this.moves && !this.playing) this.play();
  }

  play() {
    this.playing = this.moves = true;
    this.#run();
    this.#say();
  }

  pause() {
    this.playing = false;
    this.#run();
    this.#say();
  }

  seek(time) {
    this.time = Math.min(this.length, Math.max(0, time));
    this.draw();
  }

  /** Goes some frames on or back and holds there. */
  nudge(by) {
    this.pause();
    this.seek(this.time + by * Math.max(this.scene.dt, this.length / 40));
  }

  slower() {
    this.#pace(-1);
  }

  faster() {
    this.#pace(1);
  }

  #pace(by) {
    const at = SPEEDS.indexOf(this.speed) + by;
    this.chosen = this.speed = SPEEDS[Math.min(SPEEDS.length - 1, Math.max(0, at))];
    this.#say();
  }

  #say() {
    if (this.button) {
      this.button.classList.toggle("hp-paused", !this.playing);
      const label = this.playing ? "Pause" : "Play";
      this.button.setAttribute("aria-label", label);
      this.button.title = label;
      this.pace.textContent = `${this.speed}×`;
      this.less.disabled = this.speed === SPEEDS[0];
      this.more.disabled = this.speed === SPEEDS.at(-1);
    }
    this.onChange?.(this);
  }

  #run() {
    this.last = null;
    if (this.playing && this.seen && this.length > 0) keep(this.beat);
    else drop(this.beat);
  }

  #beat(now) {
    if (this.last === null) this.last = now;
    const passed = now - this.last;
    if (this.stage.slow && passed < (this.scrub ? FULL : SPARING)) return;
    this.last = now;
    this.time += Math.min(0.25, passed / 1000) * this.speed;
    if (this.time > this.length + HOLD * this.speed) this.time = 0;
    this.draw();
  }

  draw() {
    if (!this.clips?.length) return;
    const ratio = this.stage.ratio;
    this.figures.forEach(({ figure, canvas, ended }, i) => {
      const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
      if (!width || !height) return;
      if (canvas.width !== width) canvas.width = width;
      if (canvas.height !== height) canvas.height = height;
      this.stage.draw(canvas, i, Math.min(this.time, this.length));
      const end = (this.clips[i].count - 1) * this.scene.dt;
      const over = end < this.length - 1e-6 && this.time >= end;
      if (ended.hidden === over) ended.hidden = !over;
      figure.classList.toggle("hp-over", over);
    });
    this.stage.flush?.();
    if (this.scrub) {
      const time = Math.min(this.time, this.length);
      this.scrub.value = String(time);
      this.clock.textContent = `${time.toFixed(1)} s`;
    }
  }

  destroy() {
    drop(this.beat);
    this.sizes.disconnect();
    this.sight.disconnect();
    night.removeEventListener("change", this.repaint);
    this.root.remove();
  }
}

let dressed = false;

/** The look comes along, so that one script is enough in a file of its own. */
function dress() {
  if (dressed) return;
  dressed = true;
  const style = new CSSStyleSheet();
  style.replaceSync(sheet);
  document.adoptedStyleSheets = [...document.adoptedStyleSheets, style];
}

window.hiprlPlayer = function hiprlPlayer(element, options) {
  dress();
  try {
    return new Player(element, options);
  } catch (error) {
    const note = make("p", "hp-none", "These clips cannot be drawn here: this browser has no 3-D graphics (WebGL).");
    note.setAttribute("role", "alert");
    element.replaceChildren(note);
    throw error;
  }
};
