// The row of answers under the clips: five steps for a pair, five marks for one clip, an order for more.

import { make, renew } from "./dom.js";
import { names, RATINGS } from "./words.js";

/** The answer that belongs to step 1 to 5, as shown. */
export function level(step, count) {
  return count === 1
    ? { form: "rating", value: step - 3, levels: 5 }
    : { form: "level", value: 3 - step, levels: 5 };
}

/** Which step an earlier answer is, or null. */
function stepOf(answer, count) {
  if (!answer) return null;
  if (answer.form === "rating") return answer.value + 3;
  if (answer.form === "equal") return 3;
  if (answer.form === "choice") return answer.value > 0 ? 2 : 4;
  if (answer.form === "level" && count === 2) return 3 - answer.value;
  return null;
}

export class Strip {
  /** onAnswer(answer, event) when one is given; onHover(-1 | 0 | 1) when a side is pointed at. */
  constructor(root, { onAnswer, onHover = () => {} }) {
    this.root = root;
    this.onAnswer = onAnswer;
    this.onHover = onHover;
    this.count = 0;
    this.order = [];
  }

  show(count, answer = null) {
    this.count = count;
    this.order = [];
    this.given = answer;
    const at = names(count);
    if (count > 2) return this.#ranking();
    const labels = count === 1
      ? RATINGS.map((word) => [word, word, ""])
      : [
        [`${at[0]} much better`, "much better", at[0]], [`${at[0]} better`, "better", at[0]], ["Equal", "equal", ""],
        [`${at[1]} better`, "better", at[1]], [`${at[1]} much better`, "much better", at[1]],
      ];
    const mark = stepOf(answer, count);
    const buttons = labels.map(([label, word, side], i) => make(
      "button.step", {
        type: "button", "aria-label": label, "aria-pressed": mark === null ? null : mark === i + 1,
        "data-step": i + 1, "data-key": i + 1, "data-side": count === 2 ? Math.sign(2 - i) : 0, "aria-keyshortcuts": i + 1,
        onclick: (event) => this.onAnswer(level(i + 1, count), event),
        onpointerenter: () => this.onHover(count === 2 ? Math.sign(2 - i) : 0),
        onpointerleave: () => this.onHover(0),
      },
      make("span.step-side", {}, side), make("span.step-word", {}, word), make("kbd", { "aria-hidden": "true" }, i + 1)));
    renew(this.root, make("div.steps", { "data-count": count }, buttons));
    return undefined;
  }

  /** One more clip in the order from best to worst; a clip twice takes it out again. */
  rank(index) {
    if (index >= this.count) return;
    this.order = this.order.includes(index) ? this.order.filter((i) => i !== index) : [...this.order, index];
    if (this.order.length === this.count - 1) {
      this.order.push([...Array(this.count).keys()].find((i) => !this.order.includes(i)));
    }
    this.#ranking();
  }

  #ranking() {
    const at = names(this.count);
    const full = this.order.length === this.count;
    this.root.replaceChildren(make("div.ranking", {},
      make("p", {}, full ? "Best to worst:" : this.order.length ? "And the next best?" : "Click the clips from best to worst."),
      make("div.ranks", {}, at.map((name, i) => make("button.rank", {
        type: "button", "aria-pressed": this.order.includes(i), onclick: () => this.rank(i),
      }, this.order.includes(i) ? `${this.order.indexOf(i) + 1}. ${name}` : name))),
      make("button.main", {
        type: "button", disabled: !full, onclick: (event) => this.onAnswer({ form: "ranking", value: this.order }, event),
      }, "That is the order")));
  }

  /** Shows what was chosen while it is being sent. */
  mark(answer) {
    const step = stepOf(answer, this.count);
    for (const button of this.root.querySelectorAll(".step")) {
      button.classList.toggle("chosen", Number(button.dataset.step) === step);
    }
  }

  set busy(busy) {
    this.root.classList.toggle("busy", busy);
  }
}
